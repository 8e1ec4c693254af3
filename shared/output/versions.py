"""The versions of Python, machine and packages, which accompany every result."""

from __future__ import annotations

import importlib.metadata
import platform
from pathlib import Path

from shared.process.native_libraries import instruction_set

_PACKAGES = (
    "eclipse-zenoh",
    "pin",
    "example-robot-data",
    "proxsuite",
    "daqp",
    "numpy",
    "scipy",
    "msgpack",
    "mujoco",
    "rerun-sdk",
)


def versions() -> dict[str, str]:
    """Return the versions of Python, platform, rounding, and packages that results depend on."""
    found = {"python": platform.python_version(), "platform": platform.platform()}
    found |= {"instructions": instruction_set(), "blas": blas_kernels()}
    found.update({name: importlib.metadata.version(name) for name in _PACKAGES})
    return found


def blas_kernels() -> str:
    """Return the kernels of numpy's and scipy's BLAS libraries."""
    # Imported here: a service needs them for its report only, not at its start.
    import scipy.linalg  # noqa: F401
    import threadpoolctl

    loaded = threadpoolctl.threadpool_info()
    kernels = {
        each.get("architecture", each["internal_api"])
        for each in loaded
        if each["user_api"] == "blas"
    }
    return ", ".join(sorted(kernels))


def cpu_name() -> str:
    """Return the processor's name, which accompanies every measured time."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
