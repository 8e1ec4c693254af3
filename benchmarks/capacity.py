"""Comparison of the recorded delays with the delays that the derived capacity gives.

The recorded load, one message per millisecond each way, is sent through the queue of
`capacity:NAME`. Messages that leave after the end of the recording are left out, because the link
is unknown then. A tenth and a hundredth of the load show the delays of a smaller load.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.timing import header
from netem.networks import CAPACITY, load_network, load_profile, shipped_names
from netem.profile import DIRECTIONS, LOST
from shared.config.link_settings import LinkConfig

_LOADS = (1_000, 40_000)
_QUANTILES = (0.5, 0.9, 0.99, 0.999)
_PARTS = (1, 10, 100)


def run() -> str:
    """The table, as text."""
    names = shipped_names()
    scenarios = dict.fromkeys(name.rpartition("/")[0] for name in names)
    lines = [header(), "", f"{'':33}{'[ms]':10}" + "".join(f"{_percent(q):>9}" for q in _QUANTILES)]
    for scenario in scenarios:
        for way in range(len(DIRECTIONS)):
            chosen = [name for name in names if name.rpartition("/")[0] == scenario]
            lines += _of(scenario, chosen, way)
    return "\n".join(lines)


def _of(scenario: str, names: Sequence[str], way: int) -> list[str]:
    recorded: list[np.ndarray] = []
    replayed: dict[int, list[np.ndarray]] = {part: [] for part in _PARTS}
    for name in names:
        known = load_profile(name).delays_ns[way]
        link = load_network(CAPACITY + name)
        counted = (known != LOST) & (
            np.arange(len(known)) * link.period_ns + known < link.duration_ns
        )
        recorded.append(known[counted] * 1e-6)
        for part in _PARTS:
            source = link.source(way, queue_bytes=LinkConfig.queue_bytes)
            delays = np.array(
                [source(k * link.period_ns, _LOADS[way] // part) for k in range(len(known))]
            )
            delays = np.where(delays == LOST, np.nan, delays * 1e-6)
            replayed[part].append(delays[counted])
    before = np.concatenate(recorded)
    after = {part: np.concatenate(each) for part, each in replayed.items()}
    text = f"{scenario}, {DIRECTIONS[way]}"
    rows = {
        "recorded": before,
        "replayed": after[1],
        "error": np.abs(after[1] - before),
        "load / 10": after[10],
        "load / 100": after[100],
    }
    return [
        f"{text if k == 0 else '':33}{name:10}"
        + "".join(f"{value:9.2f}" for value in np.nanquantile(values, _QUANTILES))
        for k, (name, values) in enumerate(rows.items())
    ]


def _percent(quantile: float) -> str:
    return f"{100 * quantile:g} %"
