"""Figures 4, 5 and 6 of the paper, drawn from our links and trials as PNG and SVG.

Fig. 4 shows an instance of the delay in each scenario. Fig. 5 shows a balance in the smart factory
with PR, LA and LC. Fig. 6 shows a walk there with LA. Both have the delay on top, and the CoM error
and the contact violation below. The trials are those of the studies `fig5` and `fig6`, seed 0.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from experiments.reproduction.traces import Trace, play_trace
from experiments.studies.study_file import read_study
from netem.networks import load_profile
from netem.statistics import delays_ms

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

INSTANCES = {"(a) Smart factory": "factory/011", "(b) Burning building": "building/011"}
_COLOURS = {"pr": "tab:orange", "la": "tab:blue", "lc": "tab:green"}
# Salt and metadata are fixed, so that the same command draws the same bytes.
_STYLE: Any = {"svg.hashsalt": "remote-wbc", "font.size": 9, "axes.grid": True, "grid.alpha": 0.3}
_METADATA = {"png": {"Software": None}, "svg": {"Date": None}}


def draw_fig4(folder: Path) -> None:
    """Draw the round trip over one shipped profile of each scenario."""
    with mpl.rc_context(_STYLE):
        figure, axes = plt.subplots(1, 2, figsize=(9.0, 2.6), sharex=True)
        for axis, (title, name) in zip(axes, INSTANCES.items(), strict=True):
            profile = load_profile(name)
            delays = delays_ms(profile, "round trip")
            seconds = np.arange(len(delays)) * profile.period_ns * 1e-9
            axis.plot(seconds, delays, linewidth=0.8)
            axis.set(title=f"{title}: {name}", xlabel="time [s]", ylabel="round trip [ms]")
            axis.set(xlim=(0.0, seconds[-1]), ylim=(0.0, None))
        _save(figure, folder / "fig4")


def draw_fig5(folder: Path) -> None:
    """Draw PR, LA and LC in one balance, with the push shaded red."""
    study = read_study("fig5")
    traces = {trial.config.controller: play_trace(trial.config) for trial in study.trials}
    network = study.trials[0].config.link.network
    with mpl.rc_context(_STYLE):
        figure = _over_time(traces, f"Balance in the smart factory, {network}; red: the push")
        # The violations of the three controllers differ by orders of magnitude.
        figure.axes[2].set(yscale="log", ylim=(1e-4, None))
        _save(figure, folder / "fig5")


def draw_fig6(folder: Path) -> None:
    """Draw LA in one walk, without measurement noise."""
    config = read_study("fig6").trials[0].config
    traces = {config.controller: play_trace(config)}
    title = f"Walk in the smart factory, {config.link.network}; dotted: contact switches"
    with mpl.rc_context(_STYLE):
        _save(_over_time(traces, title), folder / "fig6")


FIGURES: Mapping[str, Callable[[Path], None]] = {
    "fig4": draw_fig4,
    "fig5": draw_fig5,
    "fig6": draw_fig6,
}


def _over_time(traces: Mapping[str, Trace], title: str) -> Figure:
    """Draw delay, CoM error and contact violation, one below the other."""
    figure, axes = plt.subplots(3, 1, figsize=(8.0, 6.0), sharex=True)
    first = next(iter(traces.values()))
    axes[0].plot(first.time, first.round_trip_ms, color="black", linewidth=0.8)
    for name, trace in traces.items():
        label = f"{name.upper()}{' (fell)' if trace.fell else ''}"
        line = {"color": _COLOURS[name], "linewidth": 0.8, "label": label}
        axes[1].plot(trace.time, trace.com_error_cm, **line)
        axes[2].plot(trace.time, trace.contact_violation_m_s2, **line)
    for axis in axes:
        if first.push is not None:
            axis.axvspan(*first.push, color="red", alpha=0.2, linewidth=0)
        for switch in first.mode_changes:
            axis.axvline(switch, color="grey", linestyle=":", linewidth=0.6)
        axis.set_ylim(0.0, None)
    axes[0].set(title=title, ylabel="round trip [ms]")
    axes[1].set(ylabel="CoM error [cm]")
    axes[2].set(ylabel="contact violation\n[m/s²]", xlabel="time [s]")
    axes[2].set_xlim(0.0, max(trace.time[-1] for trace in traces.values()))
    if len(traces) > 1:
        axes[1].legend(loc="upper right", fontsize=8)
    return figure


def _save(figure: Figure, path: Path) -> None:
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    for suffix, metadata in _METADATA.items():
        figure.savefig(path.with_suffix(f".{suffix}"), dpi=150, metadata=metadata)
    plt.close(figure)
