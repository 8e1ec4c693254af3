"""Read a TOML file."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from shared.errors import ConfigError

if sys.version_info >= (3, 11):
    import tomllib
else:  # pragma: no cover
    import tomli as tomllib


def read_toml(path: Path, *, what: str) -> dict[str, Any]:
    """Return the table in a file; raise `ConfigError`, which begins with `what`, if it has none."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise ConfigError(f"{what}: cannot read {path}: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{what}: {path} is not valid TOML: {error}") from None
