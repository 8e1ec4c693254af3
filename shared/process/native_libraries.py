"""Importing this first sets what native libraries read once, when they are loaded.

Threads: BLAS worker threads cost more than they give on matrices this small, and ruin a 1 kHz loop.
Zenoh's default of six runtime threads costs a fifth more processor time than one, in wake-ups.

Rounding: OpenBLAS has a kernel for each family of processors, and each rounds in its own way. One
kernel on every x86-64 processor with AVX2 makes a simulated trial the same to the last bit on all
of them, at no cost that was measured (`docs/reproduction.md`).

Drawing: figures go into files, and MuJoCo draws nothing, so that neither depends on a screen, nor
on what the caller draws with.

Every entry point imports this before numpy, zenoh, mujoco and matplotlib.
"""

import os
import platform
from pathlib import Path

AVX2, KERNEL = "x86-64 with AVX2", "Haswell"
# What OpenBLAS picks on a processor newer than that, or what is set for all programs of a machine.
# An older kernel that somebody asks for is a trial of other rounding, and is left alone.
_NEWER = ("zen", "skylakex", "cooperlake", "sapphirerapids")


def instruction_set(cpuinfo: Path = Path("/proc/cpuinfo")) -> str:
    """The processor's instructions as far as rounding depends on them; AVX2 as Linux tells it."""
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
