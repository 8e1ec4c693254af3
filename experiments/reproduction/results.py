"""The results in the folder of `run`: rows by study, limits of bisections, computation times."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from experiments.reproduction.compute_times import ComputeTimes
from experiments.reproduction.outcome import Row
from experiments.studies.bisection import Limit, limits
from experiments.studies.study_file import read_study
from experiments.studies.trial_table import read_trials
from shared.toml_file import read_toml

FIGURE_FOLDER = "figures"
COMPUTE_TIMES = "compute-times.json"


@dataclass(frozen=True)
class Results:
    """The folder of `run`. Each study is read once. An unfinished study has no rows."""

    folder: Path
    _rows: dict[str, list[Row]] = field(default_factory=dict)
    _limits: dict[str, list[Limit]] = field(default_factory=dict)

    def rows(self, name: str) -> Sequence[Row]:
        """Rows of a study's trials; [] if it is not finished."""
        if name not in self._rows:
            finished = (self.folder / name / "trials.parquet").is_file()
            self._rows[name] = read_trials(self.folder / name).to_pylist() if finished else []
        return self._rows[name]

    def limits(self, name: str) -> Sequence[Limit]:
        """Limits from a study's bisections; [] if it is not finished."""
        if name not in self._limits:
            rows = self.rows(name)
            self._limits[name] = limits(read_study(self.folder / name), rows) if rows else []
        return self._limits[name]

    @property
    def compute_times(self) -> ComputeTimes | None:
        """Table V; None if it was not measured."""
        file = self.compute_times_file
        return None if file is None else ComputeTimes.from_json(file["measured"])

    @property
    def compute_times_file(self) -> dict[str, Any] | None:
        """The file of the times, with `code` (the measured version) and `quick`; None without."""
        path = self.folder / COMPUTE_TIMES
        if not path.is_file():
            return None
        file: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        return file

    def about(self, name: str) -> dict[str, Any]:
        """The provenance of a finished study: its `about.json`."""
        text = (self.folder / name / "about.json").read_text(encoding="utf-8")
        about: dict[str, Any] = json.loads(text)
        return about

    def shortened(self, name: str) -> bool:
        """Return whether a finished study was played with `--quick`: its file has no [quick]."""
        if not self.rows(name):
            return False
        return "quick" not in read_toml(self.folder / name / "study.toml", what="study")
