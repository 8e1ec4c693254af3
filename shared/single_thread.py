"""Importing this first keeps the linear algebra of a process on one thread.

BLAS worker threads cost more than they give on matrices this small, and ruin a 1 kHz loop. The
variables must be set before numpy is imported, so every entry point imports this module first.
"""

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"
