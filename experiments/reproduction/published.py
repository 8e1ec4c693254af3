"""The numbers that the paper prints in Tables II to VI: `published.toml`."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

from shared.toml_file import read_toml


@functools.cache
def published() -> dict[str, Any]:
    """The tables by name, `table2` to `table6`, as in the file; inf stands for a fall."""
    return read_toml(Path(__file__).with_name("published.toml"), what="the paper's numbers")
