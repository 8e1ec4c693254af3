"""Start-up time of a service: user and system time of a Python that imports it."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

from shared.commands import CHECKOUT
from shared.errors import UserError
from shared.process.entry import python

SERVICES = ("robot_node", "edge_node", "netem", "viewer")
_IMPORT = """
import sys
sys.path[:] = [sys.argv[1], *(each for each in sys.path if each != sys.argv[2])]
import {}
"""


def import_ns(module: str, folder: Path | None = CHECKOUT) -> int:
    """Processor time of a new Python that imports a module of the project in `folder` [ns]."""
    command = python("-c", _IMPORT.format(module), str(folder), str(CHECKOUT))
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise UserError(f"{module} of {folder}: cannot be imported; see above")
    return round(1e9 * (usage.ru_utime + usage.ru_stime))
