"""Importing this module sets the variables that native libraries read when they are loaded.

Threads: BLAS worker threads cost more than they give on matrices this small, and ruin a 1 kHz loop.
Zenoh's default of six runtime threads costs a fifth more processor time than one, in wake-ups.

Rounding: OpenBLAS has a kernel for each family of processors, and each rounds in its own way. One
kernel on every x86-64 processor with AVX2 makes a simulated trial the same to the last bit on all
of them. No cost was measured (`docs/reproduction.md`).

Drawing: figures go into files, and MuJoCo draws nothing. So neither depends on a screen, nor on the
caller's settings for drawing.

Every entry point imports this before numpy, zenoh, mujoco and matplotlib.
"""

import os
import platform
from pathlib import Path

AVX2, KERNEL = "x86-64 with AVX2", "Haswell"
# Kernels that OpenBLAS picks on newer processors, or that a machine sets for all programs. KERNEL
# replaces them. An older kernel is kept: a user sets it to try another rounding.
_NEWER = ("zen", "skylakex", "cooperlake", "sapphirerapids")


def instruction_set(cpuinfo: Path = Path("/proc/cpuinfo")) -> str:
    """Return the processor's instruction set, as far as rounding depends on it.

    AVX2 is known on Linux only.
    """
    if platform.machine() not in ("x86_64", "AMD64"):
        return platform.machine()
    try:
        with cpuinfo.open(encoding="utf-8", errors="replace") as lines:
            flags = next((line.split() for line in lines if line.startswith("flags")), [])
    except OSError:
        flags = []
    return AVX2 if {"avx2", "fma"} <= set(flags) else "x86-64"


for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"
if os.environ.get("OPENBLAS_CORETYPE", "").lower() in ("", *_NEWER) and instruction_set() == AVX2:
    os.environ["OPENBLAS_CORETYPE"] = KERNEL
os.environ |= {"MPLBACKEND": "agg", "MUJOCO_GL": "disable"}
os.environ.setdefault(
    "ZENOH_RUNTIME",
    "(rx: (worker_threads: 1), tx: (handover: rx), net: (handover: rx), "
    "app: (handover: rx), acc: (handover: rx))",
)
