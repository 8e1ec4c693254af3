"""A sweep: how long may answers take until a push fells the robot? 12 trials on all cores.

    ./deploy/python -m examples.sweep

A study is a table of settings: a dict here, a TOML file in `experiments/configs/`. Every cell of
its grid is played with the same seeds. `experiments/studies/study_file.py` describes all keys.
Finished trials are kept: after an interruption, the same command goes on. `./wbc sweep FILE.toml`
plays a study from the command line.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from experiments.studies.study_file import make_study
from experiments.studies.sweep import sweep
from experiments.studies.trial_table import table_in_words

STUDY: dict[str, Any] = {
    "name": "delays",
    "description": "who stands a push of 100 N on late answers",
    "seeds": 2,
    "base": {"duration": 3.0, "push": ["100N@0.5s:0.2s:+y"]},
    "grid": {
        "controller": ["pr", "la", "lc"],
        "link.network": ["constant:20ms", "constant:120ms"],
    },
    "columns": ["com_error_m", "projector_age_ms.p99", "link.downlink.bytes_per_second"],
}


def main(
    duration: float = 3.0, folder: Path = Path("runs"), workers: int | None = None
) -> list[dict[str, Any]]:
    """Play the study, or the rest of it. Return its rows, one per trial, as in trials.parquet."""
    study = make_study(STUDY | {"base": STUDY["base"] | {"duration": duration}})
    out = folder / "sweep-delays"
    rows = sweep(study, out=out, workers=workers or os.cpu_count() or 1)
    print(table_in_words(rows, list(study.cells[0].shown)))
    print(f"every trial is a row of {out / 'trials.parquet'}")
    return rows


if __name__ == "__main__":  # the processes that play the trials import this file
    main()
