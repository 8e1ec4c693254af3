"""Whether this Python has what a lock file names: `python -m deploy.installed requirements.lock`.

pip may have been told, by a file of the user's own, to put packages elsewhere.
"""

from __future__ import annotations

import importlib.metadata
import re
import sys
import sysconfig
from pathlib import Path

from pip._vendor.packaging.markers import Marker

# A line of `uv pip compile`: NAME[EXTRAS]==VERSION ; MARKER \
_PIN = re.compile(r"^([A-Za-z0-9._-]+)(?:\[[^]]*\])?==([^ ;\\]+)(?: *; *([^\\]*))?", re.M)


def missing(lock: str) -> list[str]:
    """What of a lock file's text is not installed in this environment, in words."""
    folder = sysconfig.get_path("purelib")
    found = {
        _normal(each.metadata["Name"]): each.version
        for each in importlib.metadata.distributions(path=[folder])
    }
    return [
        f"{name} {version} ({found.get(_normal(name), 'none')})"
        for name, version, marker in _PIN.findall(lock)
        if (not marker or Marker(marker).evaluate()) and found.get(_normal(name)) != version
    ]


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def main() -> int:
    wrong = missing(Path(sys.argv[1]).read_text(encoding="utf-8"))
    if not wrong:
        return 0
    shown = ", ".join(wrong[:3]) + (f" and {len(wrong) - 3} more" if len(wrong) > 3 else "")
    print(
        f"setup: expected in {sys.prefix} what {sys.argv[1]} names, got others: {shown}; does a "
        "pip.conf send packages elsewhere (pip config list)? Remove .venv and run it again",
        file=sys.stderr,
    )
    return 2


if __name__ == "__main__":
    sys.exit(main())
