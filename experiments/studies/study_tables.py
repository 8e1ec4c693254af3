"""Checks and readers of the tables of a study's TOML. Each fault raises one clear error."""

from __future__ import annotations

import sys
from typing import Any

from experiments.studies.study import draw
from experiments.studies.trial_sequence import Bisection
from shared.errors import ConfigError, one_of

if sys.version_info >= (3, 11):
    import tomllib
else:  # pragma: no cover
    import tomli as tomllib

# The bounds of a bisection, with their defaults.
_BOUNDS: dict[str, Any] = {"low": 0, "high": None, "resolution": 1}
_RANDOM = {
    "push": '{ kind = "push", force = 40.0, duration = 0.2, start = [1.0, 6.0], '
    'directions = ["+x", "-y"] }',
    "uniform": '{ kind = "uniform", low = 0.4, high = 1.0 }',
    "cut": '{ kind = "cut", start = [1.0, 6.0] }',
}


def quickened(table: dict[str, Any]) -> dict[str, Any]:
    """The table of the quick study: the changes of [quick] applied, and [quick] removed."""
    if "quick" not in table:
        raise ConfigError("expected a table [quick] in the study, got none; leave out --quick")
    small = {name: value for name, value in table.items() if name != "quick"}
    grid, bisect = flattened(table.get("grid", {}), "grid"), table.get("bisect")
    for key, value in flattened(table["quick"], "quick").items():
        bound = key.removeprefix("bisect.")
        if key == "seeds":
            small["seeds"] = value
        elif key == "cells":
            small["cells"] = _chosen(table.get("cells", []), value)
        elif key in grid:
            small["grid"] = grid = grid | {key: value}
        elif bound != key and bound in _BOUNDS and isinstance(bisect, dict):
            small["bisect"] = bisect = bisect | {bound: value}
        else:
            known = ["seeds", "cells", *(f"bisect.{name}" for name in _BOUNDS), *grid]
            raise ConfigError(f"{key}: {one_of(known, key)}")
    return small


def _chosen(cells: Any, names: Any) -> list[dict[str, Any]]:
    """The cells with these names."""
    valid = list(variants_of(cells))
    if not isinstance(names, list) or not names or any(name not in valid for name in names):
        raise ConfigError(
            f"cells: expected names among {', '.join(valid) or 'none'}, got {names!r}"
        )
    return [cell for cell in cells if cell["name"] in names]


def bisection_of(table: Any) -> Bisection:
    """The bisection of a table [bisect]."""
    if not isinstance(table, dict):
        raise ConfigError(f"bisect: expected a table, got {table!r}")
    keys = ("setting", "value", *_BOUNDS, "also")
    for key in table:
        if key not in keys:
            raise ConfigError(f"bisect: {one_of(keys, key)}")
    setting = table.get("setting")
    if not isinstance(setting, str):
        raise ConfigError(f"bisect.setting: expected the name of a setting, got {setting!r}")
    also = flattened(table.get("also", {}), "bisect.also")
    if setting in also:
        raise ConfigError(
            f"bisect.also: expected settings other than the bisected one, got {setting}; leave it "
            "out"
        )
    values = {setting: table.get("value"), **also}
    for key, value in values.items():
        number = isinstance(value, int | float) and not isinstance(value, bool) and value != 0
        texts = value if isinstance(value, list) else [value]
        if not number and not (
            all(isinstance(text, str) for text in texts) and any("{}" in text for text in texts)
        ):
            where = "value" if key == setting else f"also.{key}"
            raise ConfigError(
                f'bisect.{where}: expected text with {{}} for the integer, as "constant:{{}}ms", '
                f"or a number to multiply by it, got {value!r}"
            )
    low, high, resolution = bounds = [table.get(name, k) for name, k in _BOUNDS.items()]
    if not all(map(is_integer, bounds)) or not 1 <= resolution <= high - low:
        raise ConfigError(
            f"bisect: expected integers low < high and a resolution from 1 to high − low, got "
            f"low = {low!r}, high = {high!r}, resolution = {resolution!r}"
        )
    return Bisection(values, low, high, resolution)


def variants_of(cells: Any) -> dict[str, dict[str, Any]]:
    """Settings of the named cells, by name."""
    if not isinstance(cells, list) or not all(isinstance(cell, dict) for cell in cells):
        raise ConfigError(f"cells: expected tables [[cells]], got {cells!r}")
    variants: dict[str, dict[str, Any]] = {}
    for cell in cells:
        name = cell.get("name")
        if not isinstance(name, str) or name in variants:
            raise ConfigError(f"cells: expected a different name in each, got {name!r} in {cell}")
        settings = {key: value for key, value in cell.items() if key != "name"}
        variants[name] = flattened(settings, f"cells {name!r}")
    return variants


def check_random(key: str, spec: Any) -> None:
    """Raise `ConfigError` for a setting of [random] that cannot be drawn."""
    try:
        expected = _RANDOM[spec["kind"]]
        if set(spec) != set(tomllib.loads(f"x = {expected}")["x"]):
            raise ValueError
        draw(key, spec, seed=0)
    except (LookupError, TypeError, ValueError, OverflowError):
        raise ConfigError(
            f"random.{key}: expected {' or '.join(_RANDOM.values())}, got {spec!r}"
        ) from None


def flattened(table: Any, where: str) -> dict[str, Any]:
    """Nested tables as dotted keys. In [random] a table with a `kind` stays a table."""
    if not isinstance(table, dict):
        raise ConfigError(f"{where}: expected a table of settings, got {table!r}")
    flat: dict[str, Any] = {}
    for key, value in table.items():
        drawn = where.startswith("random") and isinstance(value, dict) and "kind" in value
        nested = isinstance(value, dict) and not drawn
        below = flattened(value, f"{where}.{key}") if nested else {"": value}
        for rest, leaf in below.items():
            dotted = f"{key}.{rest}" if rest else key
            if dotted in flat:
                raise ConfigError(f"{where}.{dotted}: expected once, got it twice")
            flat[dotted] = leaf
    return flat


def is_integer(value: Any) -> bool:
    """Return whether a value is a TOML integer and not a boolean."""
    return isinstance(value, int) and not isinstance(value, bool)
