"""The project's commands as a user can type them here, for hints and usage lines."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

_ROOT = Path(__file__).parents[1]
# The folder of the project's sources; None where it is installed as a package.
CHECKOUT = _ROOT if (_ROOT / "wbc").is_file() else None


def wbc(arguments: str = "") -> str:
    """Return `wbc` and its arguments: its name if PATH has it, otherwise its relative path."""
    script = (CHECKOUT or Path(sys.prefix) / "bin") / "wbc"
    return f"{_typed('wbc', script)} {arguments}".rstrip()


def python_module(module: str, arguments: str = "") -> str:
    """Return the command line that runs a module of the project: `.venv/bin/python -m netem`."""
    return f"{_typed('python', Path(sys.executable))} -m {module} {arguments}".rstrip()


def _typed(name: str, program: Path) -> str:
    """Return the shortest way to type a program. `name` is its name without a path."""
    found = shutil.which(name)
    if not program.exists() or (found is not None and os.path.samefile(found, program)):
        return name
    here = os.path.relpath(program)
    if here.startswith(".."):
        return str(program)
    return here if "/" in here else f"./{here}"
