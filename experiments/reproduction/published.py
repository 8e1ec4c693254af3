"""What the paper prints in Tables II to VI: `published.toml`."""

from __future__ import annotations

import functools
import sys
from pathlib import Path
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:  # pragma: no cover
    import tomli as tomllib


@functools.cache
def published() -> dict[str, Any]:
    """The tables by name, `table2` to `table6`, as in the file; inf where the robot fell."""
    path = Path(__file__).with_name("published.toml")
    return tomllib.loads(path.read_text(encoding="utf-8"))
