"""Commands that show profiles: `list`, `show` and `stats`."""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
from pathlib import Path

import numpy as np

from netem.networks import load_profile, shipped_names
from netem.profile import DIRECTIONS, LOST, DelayProfile
from netem.statistics import LINKS, SPIKE_MS, delay_spikes, delays_ms, statistics
from shared.errors import ProfileError, one_of
from shared.process.cli import EXIT_STANDING

_NETWORK = "a shipped profile (factory/003), a .npz or .csv file, constant:30ms"
_BARS = " ▁▂▃▄▅▆▇█"
_WIDTH = 72


def add_list_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `list`."""
    parser.add_argument(
        "scenario", nargs="?", help="list only the profiles of this scenario, as in factory"
    )


def run_list(arguments: argparse.Namespace) -> int:
    """Print a line per shipped profile. Return 0."""
    names = shipped_names()
    scenarios = sorted({name.rpartition("/")[0] for name in names})
    if arguments.scenario not in (None, *scenarios):
        raise ProfileError(f"scenario: {one_of(scenarios, arguments.scenario)}")
    print(f"{'profile':28}  seconds  round trip [ms]     longest   spikes  lost")
    for name in names:
        if arguments.scenario in (None, name.rpartition("/")[0]):
            profile = load_profile(name)
            trip = statistics([profile], "round trip")
            spikes = len(delay_spikes(delays_ms(profile, "round trip")))
            print(
                f"{name:28}  {profile.duration_ns * 1e-9:7.1f}  {trip.median:15.2f}  "
                f"{trip.maximum:8.1f} ms  {spikes:7}  {_percent(trip.lost)}"
            )
    return EXIT_STANDING


def add_show_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `show`."""
    parser.add_argument("network", metavar="NAME", help=_NETWORK)
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="picture to write")


def run_show(arguments: argparse.Namespace) -> int:
    """Print the source of a profile and its delay over time. Return 0."""
    profile = load_profile(arguments.network)
    n = profile.delays_ns.shape[1]
    print(f"{profile.name}: {n} periods of {profile.period_ns / 1000:g} µs")
    for key, value in profile.metadata.items():
        print(f"  {key}: {json.dumps(value, ensure_ascii=False)}")
    if profile.columns:
        print(f"  columns: {', '.join(profile.columns)}")
    top = max(1.0, *(_finite_max(delays_ms(profile, way)) for way in DIRECTIONS))
    for way in DIRECTIONS:
        print(f"  {way:8} │{_sparkline(delays_ms(profile, way), top)}│")
    print(f"  {'':8}  0 … {profile.duration_ns * 1e-9:g} s, 0 … {top:.1f} ms; × lost")
    if arguments.plot is not None:
        _plot(profile, arguments.plot)
        print(f"  picture: {arguments.plot}")
    return EXIT_STANDING


def add_stats_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `stats`."""
    parser.add_argument(
        "networks",
        nargs="+",
        metavar="NAME",
        help=f"{_NETWORK}, or a whole scenario (factory) or folder; several are pooled",
    )
    parser.add_argument("--json", action="store_true", help="print JSON")


def run_stats(arguments: argparse.Namespace) -> int:
    """Print quantiles, delay spikes and memory of one or several profiles together. Return 0."""
    profiles = [profile for name in arguments.networks for profile in _profiles(name)]
    if len({profile.period_ns for profile in profiles}) > 1:
        raise ProfileError(
            "stats: expected profiles of one period, got several; give the profiles one by one"
        )
    table = {link: dataclasses.asdict(statistics(profiles, link)) for link in LINKS}
    if arguments.json:
        empty = {
            link: {key: None if math.isnan(value) else value for key, value in row.items()}
            for link, row in table.items()
        }
        print(json.dumps({"profiles": [p.name for p in profiles], **empty}, indent=2))
        return EXIT_STANDING
    seconds = sum(profile.duration_ns for profile in profiles) * 1e-9
    print(f"{len(profiles)} profile{'s' * (len(profiles) > 1)}, {seconds:g} s; delays in ms")
    print(f"{'':24}" + "".join(f"{link:>12}" for link in LINKS))
    for key in table[LINKS[0]]:
        values = [row[key] for row in table.values()]
        cells = ["–" if math.isnan(v) else f"{v:.2f}" for v in values]
        if key == "lost":
            cells = [_percent(v) for v in values]
        print(f"{_TOLD[key]:24}" + "".join(f"{cell:>12}" for cell in cells))
    print(_EXPLAINED)
    return EXIT_STANDING


_TOLD = {
    "median": "median",
    "q90": "90 %",
    "q99": "99 %",
    "q999": "99.9 %",
    "maximum": "longest",
    "lost": "lost",
    "spikes_per_second": "spikes per second",
    "peak_median": "  peak, median",
    "peak_q90": "  peak, 90 %",
    "duration_median": "  duration, median",
    "duration_maximum": "  duration, longest",
    "lost_maximum": "longest run of losses",
    "memory": "memory (1/e)",
}


_EXPLAINED = f"""
round trip: a message up, and its answer down from the moment that it arrives
median … longest: of the messages that arrived; lost: the part of the time in which none did
spike: successive messages that were lost, or took over {SPIKE_MS:g} ms and twice the median
peak: the longest delay in a spike of a message that arrived; duration: lost messages count
memory: the time between two delays whose correlation is 1/e"""


def _profiles(name: str) -> list[DelayProfile]:
    """The profiles of a name: one profile, or all of a scenario or a folder."""
    shipped = [each for each in shipped_names() if each.rpartition("/")[0] == name]
    if shipped:
        return [load_profile(each) for each in shipped]
    if Path(name).is_dir():
        files = sorted(file for file in Path(name).iterdir() if file.suffix in (".npz", ".csv"))
        if not files:
            raise ProfileError(f"stats: expected .npz or .csv files in {name}, found none")
        return [load_profile(str(file)) for file in files]
    return [load_profile(name)]


def _sparkline(delays: np.ndarray, top: float) -> str:
    """The longest delay of each of `_WIDTH` spans; a cross for a span in which all were lost."""
    marks = []
    for stretch in np.array_split(delays, min(_WIDTH, len(delays))):
        passed = stretch[np.isfinite(stretch)]
        level = math.ceil(passed.max() / top * (len(_BARS) - 1)) if len(passed) else -1
        marks.append("×" if level < 0 else _BARS[level])
    return "".join(marks)


def _finite_max(delays: np.ndarray) -> float:
    return float(delays[np.isfinite(delays)].max())


def _percent(fraction: float) -> str:
    return f"{100 * fraction:.2f} %"


def _plot(profile: DelayProfile, path: Path) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    from shared.output.figure import save_figure

    capacities = [f"{way}_capacity_bytes" for way in DIRECTIONS]
    known = [name for name in capacities if name in profile.columns]
    figure, axes = plt.subplots(
        1 + bool(known), 1, figsize=(9, 3.2 * (1 + bool(known))), sharex=True, squeeze=False
    )
    seconds = np.arange(profile.delays_ns.shape[1]) * profile.period_ns * 1e-9
    for way, colour in zip(DIRECTIONS, ("tab:blue", "tab:orange"), strict=True):
        delays = delays_ms(profile, way)
        axes[0, 0].plot(seconds, np.where(np.isfinite(delays), delays, np.nan), colour, label=way)
    lost = np.flatnonzero((profile.delays_ns == LOST).any(axis=0))
    if len(lost):
        axes[0, 0].plot(seconds[lost], np.zeros(len(lost)), "rx", label="lost")
    axes[0, 0].set(ylabel="one-way delay [ms]", title=profile.name)
    axes[0, 0].legend()
    for name in known:
        axes[1, 0].plot(seconds, profile.columns[name] / 1000, label=name)
    if known:
        axes[1, 0].set(ylabel="capacity [kB per period]", yscale="symlog")
        axes[1, 0].legend()
    axes[-1, 0].set_xlabel("sending time [s]")
    for axis in axes[:, 0]:
        axis.grid(alpha=0.3)
    save_figure(figure, path, what="plot")
