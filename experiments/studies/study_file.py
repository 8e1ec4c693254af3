"""Reader of studies: TOML files. A study in `configs/` has a name. Every key is optional:

    description = "one line"
    seeds = 50                      # every cell is played with the seeds 0 … 49
    columns = ["fell", "link.downlink.sent"]    # fields of a run's summary, dotted if nested

    [base]                          # settings of all trials, as tables or dotted keys
    task = "walk"
    "link.network" = "constant:25ms"

    [grid]                          # a list of values per setting; every combination is a cell
    controller = ["la", "lc"]
    "link.network" = ["constant:3ms", "profiles:factory"]

    [[cells]]                       # variants with a name, each combined with the grid
    name = "0.2 m"
    "walk.step_length" = 0.2

    [random]                        # drawn from the seed alone: equal in all cells of a seed.
    push = {kind = "push", force = 40.0, duration = 0.2, start = [1.0, 6.0], directions = ["+x"]}
    "plant.friction" = {kind = "uniform", low = 0.4, high = 1.0}

    [bisect]                        # finds the limit of a setting for each cell and seed
    setting = "link.network"
    value = "constant:{}ms"         # {} is an integer; a number is multiplied by the integer
    low = 0                         # assumed to stand, not played
    high = 400                      # played first: a robot that stands here has no limit below.
    resolution = 1                  # ends when a standing and a falling integer are this close.
    also = { "switch.compute_ns" = 1_000_000 }      # more settings, written like `value`

    [quick]                         # changes by --quick: a smaller study of the same kind.
    seeds = 1
    cells = ["0.2 m"]               # the named cells to keep.
    "link.network" = ["constant:3ms"]               # replaces the values of the grid
    bisect.resolution = 50

Cells, grid, random settings and the bisection replace settings of the base. No setting is in two of
them. The base replaces the defaults of the task. A setting that is a list is a list in the base,
and a list of lists in the grid: `push = [["100N@1.0s:0.2s:+y"], []]`. For `profiles:factory`, seed
k gets the k-th shipped profile of that scenario; after the last profile the first follows. For
`generated:factory`, seed k gets the profile generated from seed k. The prefix `capacity:` gives the
capacity behind that profile. A pair of numbers in a push stands for a draw between the two. The
random `"link.outage" = {kind = "cut", start = [1.0, 6.0]}` cuts the link for ever at a time between
the two. With `all_active_sets = true`, states that the edge did not solve are solved after the
trial, so that the discrepancy of the active set is known at every tick.
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
from shared.errors import ConfigError, one_of
from shared.telemetry.schema import Source
from shared.toml_file import read_toml

SHIPPED = Path(__file__).parents[1] / "configs"
DEFAULT_SEEDS = 20
# The default columns have no measured times, so a study played twice has equal tables.
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
    """Read a shipped study by name, a TOML file, or the study in the folder of a sweep.

    `quick` applies the table [quick]. `seeds` replaces the study's number of seeds. Raise
    ConfigError for a faulty study, also for a setting that no run can have.
    """
    path = SHIPPED / f"{source}.toml"
    if not path.is_file():
        path = Path(source) / "study.toml" if Path(source).is_dir() else Path(source)
    if not path.is_file():
        shipped = ", ".join(sorted(file.stem for file in SHIPPED.glob("*.toml")))
        raise ConfigError(
            f"study: expected a shipped study ({shipped}) or a TOML file, got {str(source)!r}, "
            "which does not exist"
        )
    table = read_toml(path, what="study")
    table.setdefault("name", path.stem)
    return make_study(table, seeds=seeds, quick=quick)


def make_study(table: dict[str, Any], *, seeds: int | None = None, quick: bool = False) -> Study:
    """The study of a TOML table that has a `name`; see `read_study`."""
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
            raise ConfigError(one_of(_KEYS, key))
    seeds = table.get("seeds", DEFAULT_SEEDS)
    if not is_integer(seeds) or seeds < 1:
        raise ConfigError(f"seeds: expected a number of at least 1, got {seeds!r}")
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
            raise ConfigError(
                "seed: expected seeds, the number of seeds of a study, got the setting seed; try "
                f"seeds = {DEFAULT_SEEDS}"
            )
        if sum(key in settings for settings in (grid, in_cells, random, bisected)) > 1:
            raise ConfigError(
                f"{key}: expected in one of grid, cells, random and bisect, got it in two or more; "
                "keep one"
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
    # Dotted keys keep the order of the grid when the table is written.
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
