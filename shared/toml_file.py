"""Read a TOML file."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from shared.errors import ConfigError
from shared.regular_file import read_regular

_MAX_BYTES = 1_000_000
# More levels than any file of this project has, and far fewer than Python's recursion limit.
_MAX_DEPTH = 30
# The parser's time grows with the square of the number of dots in a key.
_MAX_DOTS = 500


def read_toml(path: Path, *, what: str) -> dict[str, Any]:
    """Return the table in a file; raise `ConfigError`, which begins with `what`, if it has none."""
    # Imported here: commands to a running stack read no file.
    if sys.version_info >= (3, 11):
        import tomllib
    else:  # pragma: no cover
        import tomli as tomllib

    try:
        text = read_regular(path, at_most=_MAX_BYTES).decode("utf-8-sig")
        table = None if _has_long_key(text) else tomllib.loads(text)
    except OSError as error:
        raise ConfigError(f"{what}: cannot read {path}: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{what}: {path} is not valid TOML: {error}") from None
    except RecursionError:
        table = None
    if table is None or _depth(table) > _MAX_DEPTH:
        raise ConfigError(
            f"{what}: expected tables and lists of at most {_MAX_DEPTH} levels, got more in "
            f"{path}; is it the right file?"
        )
    return table


def _has_long_key(text: str) -> bool:
    """Return whether a line may have a key with very many parts."""
    keys = (line.partition("=")[0].partition("#")[0] for line in text.splitlines())
    return any(key.count(".") > _MAX_DOTS for key in keys)


def _depth(table: dict[str, Any]) -> int:
    """Return the number of levels of tables and lists."""
    depth = 0
    level: list[Any] = [table]
    while level and depth <= _MAX_DEPTH:
        depth += 1
        below = [each.values() if isinstance(each, dict) else each for each in level]
        level = [value for each in below for value in each if isinstance(value, dict | list)]
    return depth
