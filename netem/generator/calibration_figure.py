"""Figure of `./wbc netem calibrate`: distributions, memory and an example of each scenario."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from netem.profile import DelayProfile
from netem.statistics import autocorrelation, delay_spikes, delays_ms
from shared.output.figure import save_figure

mpl.use("Agg")
from matplotlib import pyplot as plt

_COLOURS = {"ns-3": "black", "generated": "tab:orange"}
_STYLES = {"uplink": "--", "downlink": "-"}
_LAGS = 600


def draw(
    sets: Mapping[str, tuple[Sequence[DelayProfile], Sequence[DelayProfile]]], path: Path
) -> None:
    """Draw two rows of panels for each scenario. `sets`: its ns-3 and its generated profiles.

    Raise `ConfigError` if the file cannot be written.
    """
    figure, axes = plt.subplots(2 * len(sets), 3, figsize=(14, 7.4 * len(sets)), squeeze=False)
    for k, (scenario, both) in enumerate(sets.items()):
        named = dict(zip(_COLOURS, both, strict=True))
        _draw_scenario(axes[2 * k : 2 * k + 2], scenario, named)
    save_figure(figure, path, what="out", dpi=90)


def _draw_scenario(
    axes: np.ndarray, scenario: str, sets: Mapping[str, Sequence[DelayProfile]]
) -> None:
    delays, durations, peaks, memory, *examples = axes.ravel()
    for name, profiles in sets.items():
        for way, style in _STYLES.items():
            runs = [delays_ms(profile, way) for profile in profiles]
            found = [spike for run in runs for spike in delay_spikes(run)]
            line = {"color": _COLOURS[name], "linestyle": style, "label": f"{name}, {way}"}
            _exceeded(delays, np.concatenate(runs), **line)
            _exceeded(durations, [spike.messages for spike in found], **line)
            _exceeded(peaks, [spike.peak_ms for spike in found], **line)
            memory.plot(autocorrelation(runs, _LAGS), **line)
    delays.set(title=f"{scenario}: delays", xlabel="one-way delay [ms]", yscale="log")
    delays.set_ylabel("part of the messages with a longer delay")
    delays.legend(fontsize=8, loc="upper right")
    durations.set(title=f"{scenario}: outages", xlabel="duration of an outage [ms]")
    peaks.set(title=f"{scenario}: outages", xlabel="longest delay in an outage [ms]")
    memory.set(title=f"{scenario}: memory", xlabel="lag [ms]", ylabel="autocorrelation")
    memory.set_xlim(0, _LAGS if scenario == "factory" else _LAGS / 4)
    top = 1.05 * max(_example(profiles).max() for profiles in sets.values())
    for axis, (name, profiles) in zip(examples, sets.items(), strict=True):
        example = _example(profiles)
        axis.plot(np.arange(len(example)) * 1e-3, example, color=_COLOURS[name], linewidth=1)
        axis.set(title=f"{scenario}: {name}, downlink of a run", xlabel="sending time [s]")
        axis.set(ylabel="one-way delay [ms]", ylim=(0, top))
    for axis in axes.ravel():
        axis.grid(alpha=0.3)


def _exceeded(axis: Any, values: Sequence[float] | np.ndarray, **line: Any) -> None:
    """Draw, over the value, the part of the values that exceeds it."""
    ordered = np.sort(np.asarray(values, dtype=float))
    if len(ordered):
        axis.step(ordered, 1.0 - np.arange(1, len(ordered) + 1) / len(ordered), **line)


def _example(profiles: Sequence[DelayProfile]) -> np.ndarray:
    """Downlink delays of the run with the median mean delay [ms]."""
    runs = sorted((delays_ms(p, "downlink") for p in profiles), key=lambda run: float(run.mean()))
    return runs[len(runs) // 2]
