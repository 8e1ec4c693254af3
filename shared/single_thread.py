"""Importing this first keeps a process to the threads it needs.

BLAS worker threads cost more than they give on matrices this small, and ruin a 1 kHz loop. Zenoh's
default of six runtime threads costs a fifth more processor time than one, in wake-ups. The
variables must be set before numpy and zenoh are imported, so every entry point imports this first.
"""

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"
os.environ.setdefault(
    "ZENOH_RUNTIME",
    "(rx: (worker_threads: 1), tx: (handover: rx), net: (handover: rx), "
    "app: (handover: rx), acc: (handover: rx))",
)
