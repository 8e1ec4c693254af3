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

    [bisect]                        # each cell and seed looks for its own limit of a setting
    setting = "link.network"
    value = "constant:{}ms"         # {} is an integer; a number would be multiplied with it
    low = 0                         # taken to stand, not played
    high = 400                      # played first: who stands there has no limit below it
    resolution = 1                  # until what stood and what fell are that close
    also = { "switch.compute_ns" = 1_000_000 }      # follows it, like `value`

    [quick]                         # what --quick changes: a smaller study of the same kind
    seeds = 1
    cells = ["0.2 m"]               # of the named cells only these
    "link.network" = ["constant:3ms"]               # instead of the grid's
    bisect.resolution = 50

Cells, grid, draws and the bisection go over the base, and share no setting; under it is what the
task presets. A setting that is a list is one in the base, and in the grid a list of lists, as in
`push = [["100N@1.0s:0.2s:+y"], []]`. For `profiles:factory`, seed k gets the k-th shipped profile
of that scenario, and after the last the first again; for `generated:factory` the one generated from
seed k; `capacity:` before them is the capacity behind it. A number of a push that is a pair is
drawn from between the two. With `all_active_sets = true`, states that the edge did not solve are
solved after the trial, so that the discrepancy of the active set is known at every tick.
"""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

from experiments.studies.study import Cell, Study
from experiments.studies.study_tables import (
    bisection_of,
    check_random,
    flattened,
    is_integer,
    quickened,
    variants_of,
)
from shared.config.toml_file import read_toml
from shared.errors import ConfigError
from shared.telemetry.schema import Source

SHIPPED = Path(__file__).parents[1] / "configs"
DEFAULT_SEEDS = 20
# No times of this machine among them: a study played twice has equal tables.
DEFAULT_COLUMNS = (
    *("network", "fell", "task_seconds", "com_error_m", "contact_violation_m_s2"),
    *("foot_slip_mm.max", "projector_age_ms.p50", "projector_age_ms.max"),
    *(f"commands.{each.label}" for each in Source),
    *("on_board_qps", "switch_to_fresh_ms.max", "switch_to_fresh_ms.never"),
    *("link.uplink.sent", "link.downlink.sent", "link.downlink.bytes_per_second", "log_hash"),
)
_KEYS = (
    *("name", "description", "seeds", "columns", "all_active_sets"),
    *("base", "grid", "cells", "random", "bisect", "quick"),
)


def read_study(source: str | Path, *, seeds: int | None = None, quick: bool = False) -> Study:
    """A shipped study by name, a TOML file, or what a sweep left in its folder.

    With `quick`, changed as its table [quick] says; `seeds` replaces the study's. Raises
    ConfigError, also for a setting no run could have.
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
    table = read_toml(path, what="study")
    table.setdefault("name", path.stem)
    return make_study(table, seeds=seeds, quick=quick)


def make_study(table: dict[str, Any], *, seeds: int | None = None, quick: bool = False) -> Study:
    """The study of a TOML table, which has its `name`; see `read_study`."""
    asked = {} if seeds is None else {"seeds": seeds}
    where = f"study {table['name']}: "
    try:
        study = _study(table | asked)
        if quick or "quick" in table:
            where += "quick: "
            small = _study(quickened(table) | asked)
            study = small if quick else study
    except ConfigError as error:
        raise ConfigError(f"{where}{error}") from None
    _ = study.trials  # a setting that no run can have is an error now, not in a worker
    return study


def _study(table: dict[str, Any]) -> Study:
    for key in table:
        if key not in _KEYS:
            raise ConfigError(f"{key}: unknown; valid here: {', '.join(_KEYS)}")
    seeds = table.get("seeds", DEFAULT_SEEDS)
    if not is_integer(seeds) or seeds < 1:
        raise ConfigError(f"seeds: expected how many, at least 1, got {seeds!r}")
    columns = table.get("columns", list(DEFAULT_COLUMNS))
    if not isinstance(columns, list) or not all(isinstance(name, str) for name in columns):
        raise ConfigError(f"columns: expected a list of fields of a summary, got {columns!r}")
    all_active_sets = table.get("all_active_sets", False)
    if not isinstance(all_active_sets, bool):
        raise ConfigError(f"all_active_sets: expected true or false, got {all_active_sets!r}")
    base, grid, random = (
        flattened(table.get(name, {}), name) for name in ("base", "grid", "random")
    )
    if "grid" in table and not grid:
        raise ConfigError("grid: expected lists of values, got an empty table; leave out [grid]")
    for key, values in grid.items():
        different = isinstance(values, list) and len(set(map(repr, values))) == len(values) > 0
        if not different:
            raise ConfigError(f"grid.{key}: expected a list of different values, got {values!r}")
    variants = variants_of(table.get("cells", []))
    bisection = bisection_of(table["bisect"]) if "bisect" in table else None
    bisected = bisection.values if bisection is not None else {}
    in_cells = {key for settings in variants.values() for key in settings}
    for key in [*base, *grid, *in_cells, *random, *bisected]:
        if key == "seed":
            raise ConfigError("seed: not a setting of a study; say how many with seeds")
        if sum(key in settings for settings in (grid, in_cells, random, bisected)) > 1:
            raise ConfigError(
                f"{key}: expected in one of grid, cells, random and bisect, got it in two"
            )
    for key, spec in random.items():
        check_random(key, spec)
    cells = [
        Cell({**name, **(point := dict(zip(grid, values, strict=True)))}, base | settings | point)
        for name, settings in [({"cell": name}, s) for name, s in variants.items()] or [({}, {})]
        for values in itertools.product(*grid.values())
    ]
    varied = dict.fromkeys([*grid, *(key for s in variants.values() for key in s), *random])
    if bisection is not None:
        varied[bisection.setting] = None
    columns = tuple(dict.fromkeys(["fell", *columns]))
    # Dotted, so that the order of the grid survives being written.
    table = table | {name: flat for name, flat in (("base", base), ("grid", grid)) if flat}
    return Study(
        name=table["name"],
        seeds=seeds,
        columns=columns,
        cells=tuple(cells),
        varied=tuple(varied),
        random=random,
        table=table,
        all_active_sets=all_active_sets,
        bisection=bisection,
    )
