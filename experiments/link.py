"""A trial of a whole link: each controller balances in windows that cover it, and at outages.

`./wbc link FILE` shows whether the robot stands on a link. Windows of some seconds follow one
another from the beginning of the profile to its end. The robot is pushed in each of them. Further
windows place the push at the beginning of the longest outages. The same command goes on after an
interruption.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from experiments.studies.study import Study
from experiments.studies.study_file import make_study
from experiments.studies.sweep import sweep, workers_from
from netem.networks import CAPACITY, load_profile
from netem.profile import DIRECTIONS, DelayProfile
from netem.statistics import delay_spikes, delays_ms
from shared.config.extensions import CONTROLLERS
from shared.config.quantities import parse_push
from shared.errors import ConfigError, writing
from shared.output.figure import save_figure
from shared.output.text_table import aligned
from shared.process.cli import EXIT_STANDING

mpl.use("agg")
from matplotlib import pyplot as plt

_PUSH = "100N@1.0s:0.2s:+y"
_AGE, _MET, _REASON = "projector_age_ms.max", "worst_outage.ms", "fall_reason"
_STANDS, _FALLS = "tab:green", "tab:red"

Row = dict[str, Any]


@dataclass(frozen=True)
class LinkOutage:
    """A span of a profile [s] in which a direction passes no message, or passes it far too late."""

    direction: str
    start: float
    duration: float

    @property
    def end(self) -> float:
        """The end of the span [s]."""
        return self.start + self.duration


def add_link_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `link`."""
    parser.add_argument("network", metavar="NETWORK", help="a profile or a file, as --network")
    parser.add_argument(
        "--controller",
        nargs="+",
        default=["pr", "la", "lc"],
        metavar="NAME",
        help=f"some of {', '.join(CONTROLLERS.own)}; default: pr la lc",
    )
    parser.add_argument(
        "--window", type=float, default=5.0, metavar="SECONDS", help="length of a window (5)"
    )
    parser.add_argument("--push", default=_PUSH, help=f"push in each window (default {_PUSH})")
    parser.add_argument(
        "--worst", type=int, default=5, metavar="N", help="windows at the N longest outages (5)"
    )
    parser.add_argument("--quick", action="store_true", help="only the windows at the outages")
    parser.add_argument(
        "--workers", type=int, metavar="N", help="number of processes (default: all cores)"
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder of the trials (default runs/link-NETWORK)"
    )


def run_link(arguments: argparse.Namespace) -> int:
    """Play the windows that are missing. Print a line for each controller and the verdict."""
    if arguments.push == "none":
        raise ConfigError(f"--push: expected a push in each window as in {_PUSH}, got none")
    profile = load_profile(arguments.network.removeprefix(CAPACITY))
    found = link_outages(profile)
    starts = window_starts(
        profile,
        apart(found)[: arguments.worst],
        window=arguments.window,
        push_at=parse_push(arguments.push).start_ns * 1e-9,
        covering=not arguments.quick,
    )
    study = study_of(
        arguments.network,
        starts=starts,
        controllers=arguments.controller,
        window=arguments.window,
        push=arguments.push,
    )
    out = arguments.out or Path("runs") / study.name
    played = sweep(study, out=out, workers=workers_from(arguments.workers))
    rows = [{**row, "start": starts[row["cell"]]} for row in played]
    text = "\n".join([*verdicts(rows, profile), "", *table(rows), *falls(rows, profile)])
    picture = out / "link.png"
    print(text)
    with writing(out, what="out"):
        (out / "link.txt").write_text(text + "\n", encoding="utf-8")
    draw(rows, profile, picture)
    print(picture)
    return EXIT_STANDING


def link_outages(profile: DelayProfile) -> list[LinkOutage]:
    """The outages of both directions, the longest first: an outage for each delay spike."""
    period = profile.period_ns * 1e-9
    found = [
        LinkOutage(direction, each.first * period, each.messages * period)
        for direction in DIRECTIONS
        for each in delay_spikes(delays_ms(profile, direction))
    ]
    return sorted(found, key=lambda each: -each.duration)


def apart(found: Sequence[LinkOutage]) -> list[LinkOutage]:
    """The outages in their order, without any outage that overlaps an earlier one.

    Most outages of a link hit both directions.
    """
    chosen: list[LinkOutage] = []
    for each in found:
        if all(each.end <= other.start or other.end <= each.start for other in chosen):
            chosen.append(each)
    return chosen


def window_starts(
    profile: DelayProfile,
    worst: Sequence[LinkOutage],
    *,
    window: float,
    push_at: float,
    covering: bool,
) -> dict[str, float]:
    """The beginning of each window in the profile [s], by the window's name.

    With `covering`, windows follow one another over the whole profile. Each outage of `worst` has a
    window whose push, `push_at` [s] after its beginning, comes at the beginning of the outage.
    """
    length = profile.duration_ns * 1e-9
    starts: dict[str, float] = {}
    if covering:
        last = max(0.0, length - window)
        for start in [*np.arange(0.0, last, window), last]:
            starts[f"from {start:.3g} s"] = float(start)
    for each in worst:
        name = f"push at {each.start:.4g} s, {each.direction} out for {each.duration * 1e3:.0f} ms"
        starts[name] = (each.start - push_at) % length
    if not starts:
        raise ConfigError(
            "--quick: expected a link with outages, got one without; leave --quick out"
        )
    return starts


def study_of(
    network: str, *, starts: dict[str, float], controllers: Sequence[str], window: float, push: str
) -> Study:
    """The trials of a link: each controller in each window."""
    if not 2.0 <= window <= 3600.0:
        raise ConfigError(f"--window: expected 2 to 3600 s, got {window:g}")
    if parse_push(push).start_ns * 1e-9 >= window:
        raise ConfigError(f"--push: expected a push within the window of {window:g} s, got {push}")
    name = network.rpartition("/")[2].rpartition(".")[0] or network
    return make_study(
        {
            "name": f"link-{name.replace('/', '-').replace(':', '-')}",
            "description": f"every controller over all of {network}",
            "base": {"link.network": network, "duration": window, "push": [push]},
            "grid": {"controller": list(dict.fromkeys(controllers))},
            "cells": [
                {"name": name, "link.start": f"{start:.6f}s"} for name, start in starts.items()
            ],
            "columns": ["fell", "task_seconds", _AGE, _MET, _REASON],
        },
        seeds=1,
    )


def verdicts(rows: Sequence[Row], profile: DelayProfile) -> list[str]:
    """A sentence for each controller, and one for each trial that is not counted."""
    lines = []
    for controller, played in _by_controller(rows).items():
        fallen = [_fell_at(row, profile) for row in played if row["fell"]]
        name, of = CONTROLLERS.label(controller), len(played)
        if fallen:
            where = f"first at {min(fallen):.2f} s of the link"
            lines.append(f"{name} falls in {len(fallen)} of {of} windows, {where}.")
        elif played:
            lines.append(f"{name} stands in all {of} windows.")
        else:
            lines.append(f"{name} has no result: the trials ended as follows.")
    return lines + [
        f"{CONTROLLERS.label(row['controller'])}, {row['cell']}: not counted: {row['error']}"
        for row in rows
        if row["error"] is not None
    ]


def table(rows: Sequence[Row]) -> list[str]:
    """A line for each controller: windows, falls, the longest outage met, the oldest answer."""
    lines = [["controller", "windows", "stood", "longest outage met", "oldest answer used"]]
    for controller, played in _by_controller(rows).items():
        met = max((row[_MET] for row in played), default=0.0)
        ages = [row[_AGE] for row in played if row[_AGE] is not None]
        lines.append(
            [
                CONTROLLERS.label(controller),
                str(len(played)),
                str(sum(not row["fell"] for row in played)),
                _milliseconds(met),
                f"{max(ages):.0f} ms" if ages else "-",
            ]
        )
    return aligned(lines)


def falls(rows: Sequence[Row], profile: DelayProfile) -> list[str]:
    """A line for each fall, by its place on the link, with its reason; [] without falls."""
    lines = [["falls", "at", "window", "outage met", "reason (times from the window's start)"]]
    for controller, played in _by_controller(rows).items():
        for row in sorted(played, key=lambda row: row["start"]):
            if row["fell"]:
                at = f"{_fell_at(row, profile):.2f} s"
                place = [CONTROLLERS.label(controller), at, row["cell"]]
                lines.append([*place, _milliseconds(row[_MET]), row[_REASON]])
    return ["", *aligned(lines)] if len(lines) > 1 else []


def draw(rows: Sequence[Row], profile: DelayProfile, path: Path) -> None:
    """Draw the delays of the link over its time, and below them the windows of each controller."""
    by_controller = _by_controller(rows)
    figure, (above, below) = plt.subplots(
        2, 1, sharex=True, figsize=(10.0, 5.5), height_ratios=[2.0, 1.0]
    )
    seconds = np.arange(profile.delays_ns.shape[1]) * profile.period_ns * 1e-9
    for direction in DIRECTIONS:
        delays = delays_ms(profile, direction)
        above.plot(seconds, np.where(np.isfinite(delays), delays, np.nan), lw=0.8, label=direction)
        lost = ~np.isfinite(delays)
        above.plot(seconds[lost], np.zeros(lost.sum()), "x", color="k", ms=3)
    above.set(ylabel="one-way delay [ms], × lost", title=profile.name)
    above.legend(fontsize=8)
    for height, played in enumerate(by_controller.values()):
        for row in sorted(played, key=lambda row: bool(row["fell"])):
            start, lasted = row["start"], row["task_seconds"]
            below.plot(
                [start, start + lasted],
                [height, height],
                lw=6,
                solid_capstyle="butt",
                color=_FALLS if row["fell"] else _STANDS,
            )
            if row["fell"]:
                below.plot(start + lasted, height, "v", color="k", ms=8)
    below.set_yticks(range(len(by_controller)), [CONTROLLERS.label(name) for name in by_controller])
    below.set(xlabel="time on the link [s]; green: stood, red: fell, ▼ where", ylim=(-0.7, None))
    save_figure(figure, path, what="picture")


def _by_controller(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """The rows of finished trials."""
    found: dict[str, list[Row]] = {}
    for row in rows:
        played = found.setdefault(row["controller"], [])
        if row["error"] is None:
            played.append(row)
    return found


def _fell_at(row: Row, profile: DelayProfile) -> float:
    """The place on the link at which a trial fell [s]."""
    seconds: float = (row["start"] + row["task_seconds"]) % (profile.duration_ns * 1e-9)
    return seconds


def _milliseconds(met: float) -> str:
    return f"{met:.0f} ms" if met else "none"
