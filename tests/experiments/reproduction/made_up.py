"""Folders of finished studies, with outcomes that a test makes up instead of simulating."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import tomli_w

from experiments.studies.study_file import read_study
from experiments.studies.trial_sequence import Outcome, Trial, TrialSequence
from experiments.studies.trial_table import write_trials
from netem.networks import load_profile

# Of a trial: CoM error [m] and violation [m/s²], or None, it fell.
World = Callable[[Trial], tuple[float, float] | None]

ABOUT = {
    "date": "2026-11-22T10:00:00+00:00",
    "machine": {"cpu": "a processor", "cores": 2},
    "versions": dict.fromkeys(("python", "mujoco", "pin", "daqp", "numpy"), "1.0"),
    "commit": "0123456789abcdef",
    "dirty": False,
    "code": "fedcba",
    "workers": 2,
    "trial_seconds": 60.0,
}
DISCREPANCY = {
    "active_set_discrepancy.ticks": [600, 300, 0, 100],
    "active_set_discrepancy.com_error_m": [0.01, 0.02, None, 0.03],
    "active_set_discrepancy.contact_violation_m_s2": [0.01, 0.1, None, 0.2],
}


def paperlike(trial: Trial) -> tuple[float, float] | None:
    """As in the paper: PR falls beyond 40 ms and in every walk beyond 3 ms, LA beyond 100 ms."""
    name, task = trial.config.controller, trial.config.task
    late = load_profile(trial.config.link.network).nominal_round_trip_ns * 1e-6
    limit = {"pr": 40.0 if task == "balance" else 3.0, "la": 100.0, "lc": 1e9}[name]
    if late > limit:
        return None
    violation = 0.0 if late == 0.0 else 0.5 if name == "pr" else 0.01
    return 0.01 + 1e-5 * late + 1e-4 * (name == "pr"), violation


def finished(out: Path, *names: str, world: World = paperlike, seeds: int | None = None) -> None:
    """What sweeps of these studies would have left in `out`; in their quick form with `seeds`."""
    for name in names:
        study = read_study(name, quick=seeds is not None, seeds=seeds)
        rows = [row for sequence in study.sequences() for row in _played(sequence, world)]
        folder = out / name
        folder.mkdir(parents=True)
        write_trials(rows, folder)
        (folder / "study.toml").write_text(tomli_w.dumps(study.table))
        (folder / "about.json").write_text(json.dumps(ABOUT))


def _played(sequence: TrialSequence, world: World) -> list[dict[str, Any]]:
    rows = []

    def outcome(trial: Trial) -> Outcome:
        errors = world(trial)
        rows.append(_row(trial, errors) | (DISCREPANCY if trial.all_active_sets else {}))
        return "fell" if errors is None else "stood"

    sequence.follow(outcome)
    return rows


def _row(trial: Trial, errors: tuple[float, float] | None) -> dict[str, Any]:
    com_error, violation = errors or (1.0, 1000.0)
    return {
        **trial.label,
        "network": trial.config.link.network,
        "fell": errors is None,
        "com_error_m": com_error,
        "contact_violation_m_s2": violation,
        "error": None,
    }
