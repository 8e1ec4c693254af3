"""Run in place of Python: sleeps, then becomes it, in the same process. Imports nothing of ours.

`late_start.py PYTHON STAND_IN SECONDS ARGUMENTS…`. A module of `deploy` has the stand-in as its
`sys.executable`, so that the services that it starts are late as well. What a service itself starts
is not: imports start processes too, and a service that is to be ready in time would have to wait
for all of them.
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
    # The first -m, unless there is code before it, whose own it is.
    k = arguments.index("-m") if "-m" in arguments else len(arguments)
    if "-c" not in arguments[:k] and "".join(arguments[k + 1 : k + 2]).startswith("deploy."):
        arguments[k:k] = ["-c", _RUN_MODULE, stand_in]
    os.execv(python, [python, *arguments])


if __name__ == "__main__":
    main()
