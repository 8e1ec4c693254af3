"""The files of a service in the folder of a run: a set for each life, which is one process of the
service from start to end.

The rows of a process that runs, or that was killed, are in `STEM.rows`. A process that ends leaves
`STEM.parquet`, its rows, and `STEM.json`, its report. Before the next process writes, these files
get the number of their life: `STEM.1.parquet`, `STEM.2.parquet` and so on.
"""

from __future__ import annotations

import contextlib
from pathlib import Path

from shared.errors import ConfigError
from shared.file_lock import is_locked
from shared.telemetry.parquet import write_parquet
from shared.telemetry.row_log import read_rows

# The endings of the files of a life.
KINDS = ("rows", "parquet", "json")


def lives(run: Path, stem: str) -> list[str]:
    """Return the stems of a service's lives that have left files, the earliest first."""
    found = {file.name.rpartition(".")[0] for kind in KINDS for file in run.glob(f"{stem}*.{kind}")}
    numbers = {name: _number(name, stem) for name in found}
    return sorted((name for name in found if numbers[name] > 0), key=lambda name: numbers[name])


def begin_life(run: Path, stem: str) -> None:
    """Number the files of the previous life, so that the next life does not replace them.

    Raise `ConfigError` if a process still writes them.
    """
    if is_locked(run / f"{stem}.rows"):
        raise ConfigError(
            f"out: expected a folder for this {stem} alone, got {run}, to which another one "
            "writes; end it, or try another --out"
        )
    earlier = [_number(name, stem) for name in lives(run, stem) if name != stem]
    number = 1 + round(max(earlier, default=0))
    for kind in KINDS:
        # Renaming is quick: a service that starts again is waited for.
        with contextlib.suppress(FileNotFoundError):
            (run / f"{stem}.{kind}").replace(run / f"{stem}.{number}.{kind}")


def recover(run: Path, stem: str) -> None:
    """Write the rows of lives that were killed as Parquet, and remove the files of rows.

    Files of a living process are left alone. Raise `OSError` if the disk has no room.
    """
    for name in lives(run, stem):
        rows, table = run / f"{name}.rows", run / f"{name}.parquet"
        if not rows.exists() or is_locked(rows):
            continue
        # A file of another program may have this name.
        with contextlib.suppress(ValueError):
            write_parquet(*read_rows(rows), table)
            rows.unlink()


def _number(name: str, stem: str) -> float:
    """Return the number of a life from its stem, infinite for the last one; 0 for other files."""
    if name == stem:
        return float("inf")
    number = name.removeprefix(f"{stem}.")
    return int(number) if number.isdecimal() and number != name else 0
