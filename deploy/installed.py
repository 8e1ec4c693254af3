"""Check that this Python has the packages of a lock file.

`python -m deploy.installed requirements.lock`. A pip.conf of the user may have made pip install
packages elsewhere.
"""

from __future__ import annotations

import importlib.metadata
import re
import sys
import sysconfig
from pathlib import Path

from pip._vendor.packaging.markers import Marker
from pip._vendor.packaging.utils import canonicalize_name

# A line of `uv pip compile`: NAME[EXTRAS]==VERSION ; MARKER \
_PIN = re.compile(r"^([A-Za-z0-9._-]+)(?:\[[^]]*\])?==([^ ;\\]+)(?: *; *([^\\]*))?", re.M)


def missing(lock: str) -> list[str]:
    """Return the packages of a lock file's text that this environment lacks.

    Each is `NAME VERSION (VERSION FOUND)`.
    """
    folder = sysconfig.get_path("purelib")
    found = {
        canonicalize_name(each.metadata["Name"]): each.version
        for each in importlib.metadata.distributions(path=[folder])
    }
    return [
        f"{name} {version} ({found.get(canonicalize_name(name), 'none')})"
        for name, version, marker in _PIN.findall(lock)
        if (not marker or Marker(marker).evaluate())
        and found.get(canonicalize_name(name)) != version
    ]


def main() -> int:
    wrong = missing(Path(sys.argv[1]).read_text(encoding="utf-8"))
    if not wrong:
        return 0
    shown = ", ".join(wrong[:3]) + (f" and {len(wrong) - 3} more" if len(wrong) > 3 else "")
    print(
        f"setup: expected the packages of {sys.argv[1]} in {sys.prefix}, got others: {shown}; "
        "check that no pip.conf sends packages elsewhere (pip config list), remove .venv and run "
        "./deploy/setup again",
        file=sys.stderr,
    )
    return 2


if __name__ == "__main__":
    sys.exit(main())
