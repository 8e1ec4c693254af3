"""What a sweep plays: the cells of a study, each with the same seeds, as complete configurations.

A study is a TOML file; those in `configs/` are known by name. Every key may be left out:

    description = "one line"
    seeds = 50                      # every cell is played with the seeds 0 … 49
    columns = ["fell", "link.downlink.sent"]    # fields of a run's summary, dotted where nested

    [base]                          # settings as in a run's file, as tables or dotted keys
    task = "walk"
    "link.network" = "constant:25ms"

    [grid]                          # a list of values per setting; every combination is a cell
    controller = ["la", "lc"]
    "link.network" = ["constant:3ms", "profiles:factory"]

    [[cells]]                       # variants with a name, each combined with the grid
    name = "0.2 m"
    "walk.step_length" = 0.2

    [random]                        # drawn from the seed alone: all cells of a seed get the same
    push = { kind = "push", force = 40.0, duration = 0.2, start = [1.0, 6.0], directions = ["+x"] }
    "plant.friction" = { kind = "uniform", low = 0.4, high = 1.0 }

Cells, grid and draws go over the base, and share no setting; under it is what the task presets. A
setting that is a list is one in the base, and in the grid a list of lists, as in
`push = [["100N@1.0s:0.2s:+y"], []]`. For `profiles:factory`, seed k gets the k-th shipped profile
of that scenario, and after the last the first again; `capacity:profiles:factory` is the capacity
behind it. A number of a push that is a pair is drawn from between the two.
"""

from __future__ import annotations

import functools
import hashlib
import itertools
import sys
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from netem.networks import CAPACITY, load_profile, shipped_names
from shared.config import RunConfig
from shared.config_file import dump_config, load_config
from shared.errors import ConfigError, UserError
from shared.report import SOURCES

if sys.version_info >= (3, 11):
    import tomllib
else:  # pragma: no cover
    import tomli as tomllib

SHIPPED = Path(__file__).parent / "configs"
PROFILES = "profiles:"
DEFAULT_SEEDS = 20
# No times of this machine among them: a study played twice has equal tables.
DEFAULT_COLUMNS = (
    *("network", "fell", "task_seconds", "com_error_m", "contact_violation_m_s2"),
    *("foot_slip_mm.max", "projector_age_ms.p50", "projector_age_ms.max"),
    *(f"commands.{name}" for name in SOURCES),
    *("on_board_qps", "switch_to_fresh_ms.max", "switch_to_fresh_ms.never"),
    *("link.uplink.sent", "link.downlink.sent", "link.downlink.bytes_per_second", "log_hash"),
)
_KEYS = ("name", "description", "seeds", "columns", "base", "grid", "cells", "random")
_RANDOM = {
    "push": '{ kind = "push", force = 40.0, duration = 0.2, start = [1.0, 6.0], '
    'directions = ["+x", "-y"] }',
    "uniform": '{ kind = "uniform", low = 0.4, high = 1.0 }',
}


@dataclass(frozen=True)
class Cell:
    """A variant: what tells it from the others, and its dotted settings with those of the base."""

    shown: dict[str, Any]
    settings: dict[str, Any]

    @property
    def names(self) -> list[str]:
        """What `--only` may call it: its name, and each value of the grid."""
        named = self.shown.items()
        return [v if k == "cell" else f"{k}={value_in_words(v)}" for k, v in named]

    def __str__(self) -> str:
        return ", ".join(self.names) or "the only cell"


@dataclass(frozen=True)
class Trial:
    """One seed of a cell. `label` is what varies; `identity` a hash of all that it depends on.

    The code is left out of the identity: it has a version of its own.
    """

    cell: int
    label: dict[str, Any]
    config: RunConfig
    identity: str


@dataclass(frozen=True)
class Study:
    """A study as read; `table` is its TOML."""

    name: str
    seeds: int
    columns: tuple[str, ...]
    cells: tuple[Cell, ...]
    varied: tuple[str, ...]
    random: dict[str, dict[str, Any]]
    table: dict[str, Any]

    @functools.cached_property
    def trials(self) -> list[Trial]:
        """Every cell with seed 0, then every cell with seed 1, …: a part of it is a fair sample."""
        shipped = shipped_names()
        return [
            self._trial(index, seed, shipped)
            for seed in range(self.seeds)
            for index in range(len(self.cells))
        ]

    def only(self, names: Iterable[str]) -> set[int]:
        """Indices of the cells that have one of these names."""
        valid = [name for cell in self.cells for name in cell.names]
        for name in names:
            if name not in valid:
                known = ", ".join(dict.fromkeys(valid)) or "none, there is a single cell"
                raise ConfigError(f"--only: expected one of {known}; got {name!r}")
        return {k for k, cell in enumerate(self.cells) if set(names) & set(cell.names)}

    def _trial(self, index: int, seed: int, shipped: list[str]) -> Trial:
        cell = self.cells[index]
        drawn = {key: draw(key, spec, seed=seed) for key, spec in self.random.items()}
        given = {**cell.settings, **drawn, "seed": seed}
        network = given.get("link.network")
        try:
            if isinstance(network, str) and PROFILES in network:
                given["link.network"] = _profile_of(network, seed, shipped)
            config = load_config(None, given)
            identity = _identity(config)
        except UserError as error:
            raise ConfigError(f"study {self.name}, {cell}: {error}") from None
        asked = {**cell.settings, **drawn}
        varied = {key: asked[key] if key in asked else _get(config, key) for key in self.varied}
        name = {"cell": cell.shown["cell"]} if "cell" in cell.shown else {}
        return Trial(index, {**name, **varied, "seed": seed}, config, identity)


def read_study(source: str | Path, *, seeds: int | None = None) -> Study:
    """A shipped study by name, a TOML file, or what a sweep left in its folder.

    `seeds` replaces the study's. Raises ConfigError, also for a setting no run could have.
    """
    path = SHIPPED / f"{source}.toml"
    if not path.is_file():
        path = Path(source) / "study.toml" if Path(source).is_dir() else Path(source)
    if not path.is_file():
        shipped = ", ".join(sorted(file.stem for file in SHIPPED.glob("*.toml")))
        raise ConfigError(
            f"study: expected a shipped study ({shipped}) or a TOML file, got {str(source)!r}: "
            "no such study or file"
        )
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"study: cannot read {path}: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"study: {path} is not valid TOML: {error}") from None
    table.setdefault("name", path.stem)
    if seeds is not None:
        table["seeds"] = seeds
    try:
        study = _study(table)
    except ConfigError as error:
        raise ConfigError(f"study {path.stem}: {error}") from None
    _ = study.trials  # a setting that no run can have is an error now, not in a worker
    return study


def draw(key: str, spec: dict[str, Any], *, seed: int) -> Any:
    """The value of a random setting for a seed, whatever other settings are drawn."""
    rng = np.random.default_rng([seed, 11, zlib.crc32(key.encode())])
    if spec["kind"] == "uniform":
        return float(rng.uniform(spec["low"], spec["high"]))
    force, start, duration = (
        rng.uniform(*value) if isinstance(value := spec[name], list) else value
        for name in ("force", "start", "duration")
    )
    direction = spec["directions"][rng.integers(len(spec["directions"]))]
    return [f"{force:.3f}N@{start:.3f}s:{duration:.3f}s:{direction}"]


def value_in_words(value: Any) -> str:
    """A setting's value as on the command line."""
    if isinstance(value, list | tuple):
        return " and ".join(map(str, value)) or "none"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _study(table: dict[str, Any]) -> Study:
    for key in table:
        if key not in _KEYS:
            raise ConfigError(f"{key}: unknown; valid here: {', '.join(_KEYS)}")
    seeds = table.get("seeds", DEFAULT_SEEDS)
    if not isinstance(seeds, int) or isinstance(seeds, bool) or seeds < 1:
        raise ConfigError(f"seeds: expected how many, at least 1, got {seeds!r}")
    columns = table.get("columns", list(DEFAULT_COLUMNS))
    if not isinstance(columns, list) or not all(isinstance(name, str) for name in columns):
        raise ConfigError(f"columns: expected a list of fields of a summary, got {columns!r}")
    base, grid, random = (_flat(table.get(name, {}), name) for name in ("base", "grid", "random"))
    if "grid" in table and not grid:
        raise ConfigError("grid: expected lists of values, got an empty table; leave out [grid]")
    for key, values in grid.items():
        different = isinstance(values, list) and len(set(map(repr, values))) == len(values) > 0
        if not different:
            raise ConfigError(f"grid.{key}: expected a list of different values, got {values!r}")
    variants = _variants(table.get("cells", []))
    in_cells = {key for settings in variants.values() for key in settings}
    for key in [*base, *grid, *in_cells, *random]:
        if key == "seed":
            raise ConfigError("seed: not a setting of a study; say how many with seeds")
        if (key in grid) + (key in in_cells) + (key in random) > 1:
            raise ConfigError(f"{key}: expected in one of grid, cells and random, got it in two")
    for key, spec in random.items():
        _check_random(key, spec)
    cells = [
        Cell({**name, **(point := dict(zip(grid, values, strict=True)))}, base | settings | point)
        for name, settings in [({"cell": name}, s) for name, s in variants.items()] or [({}, {})]
        for values in itertools.product(*grid.values())
    ]
    varied = dict.fromkeys([*grid, *(key for s in variants.values() for key in s), *random])
    columns = tuple(dict.fromkeys(["fell", *columns]))
    # Dotted, so that the order of the grid survives being written.
    table = table | {name: flat for name, flat in (("base", base), ("grid", grid)) if flat}
    return Study(table["name"], seeds, columns, tuple(cells), tuple(varied), random, table)


def _variants(cells: Any) -> dict[str, dict[str, Any]]:
    """Settings of the named cells, by name."""
    if not isinstance(cells, list) or not all(isinstance(cell, dict) for cell in cells):
        raise ConfigError(f"cells: expected tables [[cells]], got {cells!r}")
    variants: dict[str, dict[str, Any]] = {}
    for cell in cells:
        name = cell.get("name")
        if not isinstance(name, str) or name in variants:
            raise ConfigError(f"cells: expected a name of its own in each, got {name!r} in {cell}")
        variants[name] = _flat({k: v for k, v in cell.items() if k != "name"}, f"cells {name!r}")
    return variants


def _check_random(key: str, spec: Any) -> None:
    try:
        expected = _RANDOM[spec["kind"]]
        if set(spec) != set(tomllib.loads(f"x = {expected}")["x"]):
            raise ValueError
        draw(key, spec, seed=0)
    except (LookupError, TypeError, ValueError, OverflowError):
        raise ConfigError(
            f"random.{key}: expected {' or '.join(_RANDOM.values())}, got {spec!r}"
        ) from None


def _flat(table: Any, where: str) -> dict[str, Any]:
    """Tables in tables as dotted keys; one with a `kind` is a value."""
    if not isinstance(table, dict):
        raise ConfigError(f"{where}: expected a table of settings, got {table!r}")
    flat: dict[str, Any] = {}
    for key, value in table.items():
        nested = isinstance(value, dict) and "kind" not in value
        below = _flat(value, f"{where}.{key}") if nested else {"": value}
        for rest, leaf in below.items():
            dotted = f"{key}.{rest}" if rest else key
            if dotted in flat:
                raise ConfigError(f"{where}.{dotted}: expected once, got it twice")
            flat[dotted] = leaf
    return flat


def _profile_of(network: str, seed: int, shipped: list[str]) -> str:
    """The profile of a seed of `profiles:SCENARIO`, or of `capacity:profiles:SCENARIO`."""
    capacity = CAPACITY if network.startswith(CAPACITY) else ""
    wanted = network.removeprefix(capacity)
    names = [name for name in shipped if PROFILES + name.rpartition("/")[0] == wanted]
    if not names:
        valid = ", ".join(sorted({PROFILES + name.rpartition("/")[0] for name in shipped}))
        raise ConfigError(
            f"link.network: expected one of {valid}, or {CAPACITY} before it, got {network!r}"
        )
    return capacity + names[seed % len(names)]


def _identity(config: RunConfig) -> str:
    digest = hashlib.sha256(dump_config(config, versions={}).encode())
    if config.link.network != "direct":
        digest.update(load_profile(config.link.network.removeprefix(CAPACITY)).delays_ns.tobytes())
    return digest.hexdigest()[:16]


def _get(config: RunConfig, key: str) -> Any:
    value: Any = config
    for name in key.split("."):
        value = getattr(value, name, None)  # an unknown setting is reported where it is given
    return list(value) if isinstance(value, tuple) else value
