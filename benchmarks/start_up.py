"""Start-up time of a service: user and system time of a process that prints its --help."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

from shared.commands import CHECKOUT
from shared.errors import UserError
from shared.process.entry import python

SERVICES = ("robot_node", "edge_node", "netem", "viewer")
# The module is `__main__`: its first line prepares the process, as it does in a run.
_START = """
import runpy, sys
folder, checkout, module = sys.argv[1:]
sys.path[:] = [folder, *(each for each in sys.path if each != checkout)]
sys.argv[1:] = ["--help"]
runpy.run_module(module, run_name="__main__", alter_sys=True)
"""


def start_up_ns(module: str, folder: Path | None = CHECKOUT) -> int:
    """Return the processor time of `python -m module --help` in the checkout at `folder` [ns].

    A service loads all its modules before it reads its arguments.
    """
    command = python("-c", _START, str(folder), str(CHECKOUT), module)
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise UserError(f"{module} of {folder}: does not start; see above")
    return round(1e9 * (usage.ru_utime + usage.ru_stime))
