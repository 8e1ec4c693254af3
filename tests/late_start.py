"""Run in place of Python: sleeps, then becomes it, in the same process. Imports nothing of ours.

`late_start.py PYTHON STAND_IN SECONDS ARGUMENTS…`. A module that is run has the stand-in as its
`sys.executable`, so that the processes that it starts are late as well.
"""

import os
import sys
import time

_RUN_MODULE = (
    "import runpy, sys; sys.executable = sys.argv[1]; module = sys.argv[3]; del sys.argv[1:4]; "
    "runpy.run_module(module, run_name='__main__', alter_sys=True)"
)


def main() -> None:
    python, stand_in, seconds, *arguments = sys.argv[1:]
    time.sleep(float(seconds))
    module = arguments.index("-m") if "-m" in arguments else len(arguments)
    if "-c" not in arguments[:module] and module < len(arguments):
        arguments[module:module] = ["-c", _RUN_MODULE, stand_in]
    os.execv(python, [python, *arguments])


if __name__ == "__main__":
    main()
