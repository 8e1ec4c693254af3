"""Compare generated profiles with the shipped ns-3 profiles: `./wbc netem calibrate`.

The gains of the model were fitted to the odd runs of ns-3 alone. The table gives both halves, so
that overfitting to the odd runs would show. `docs/network-model.md` lists which other parts of the
model were fitted to which runs. Two samples are compared by the Kolmogorov–Smirnov statistic
D = sup |F₁ − F₂|. Its p-value assumes independent samples. That is about right for spikes and for
runs, and wrong for successive delays of a run. For these the table gives D alone.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np

from netem.generator.channel import SCENARIOS, Scenario
from netem.generator.generate import DOWNLINK_BYTES, UPLINK_BYTES, check_set, generate_set
from netem.networks import load_profile, shipped_names
from netem.profile import DelayProfile
from netem.statistics import LINKS, SPIKE_MS, delay_spikes, delays_ms, statistics
from shared.errors import ConfigError
from shared.output.text_table import aligned
from shared.output.versions import cpu_name, versions
from shared.process.cli import EXIT_STANDING

MAX_SETS = 100
# Two samples of n and m values differ at the 5 % level if D exceeds this × √((n + m) / (n m)).
_CRITICAL = 1.358


@dataclass(frozen=True)
class Measured:
    """One link of a set of profiles."""

    profiles: Sequence[DelayProfile]
    link: str

    @cached_property
    def runs(self) -> list[np.ndarray]:
        """Delays of each run [ms]."""
        return [delays_ms(profile, self.link) for profile in self.profiles]

    @cached_property
    def figures(self) -> dict[str, float]:
        """The figures of the table, by their names in the table."""
        of = statistics(self.profiles, self.link)
        return {
            "base delay (median)": of.median,
            "90 %": of.q90,
            "99 %": of.q99,
            "99.9 %": of.q999,
            "longest": of.maximum,
            "outages per second": of.spikes_per_second,
            "duration, 10 %": _quantile(self.samples["durations"], 0.1),
            "duration, median": of.duration_median,
            "duration, 90 %": _quantile(self.samples["durations"], 0.9),
            "peak, 10 %": _quantile(self.samples["peaks"], 0.1),
            "peak, median": of.peak_median,
            "peak, 90 %": of.peak_q90,
            "memory (1/e)": of.memory,
        }

    @cached_property
    def samples(self) -> dict[str, np.ndarray]:
        """The samples that are compared as distributions, by their names in the table."""
        found = [delay_spikes(run) for run in self.runs]
        return {
            "peaks": np.array([spike.peak_ms for run in found for spike in run]),
            "durations": np.array([float(spike.messages) for run in found for spike in run]),
            "gaps": np.array(
                [
                    float(after.first - before.last - 1)
                    for run in found
                    for before, after in pairwise(run)
                ]
            ),
            "90 % of a run": np.array([np.quantile(run, 0.9) for run in self.runs]),
            "99 % of a run": np.array([np.quantile(run, 0.99) for run in self.runs]),
            "longest of a run": np.array([run.max() for run in self.runs]),
        }


def shared_spikes(profiles: Sequence[DelayProfile]) -> tuple[float, float]:
    """P(uplink in a spike | downlink in a spike) and the other way round, over sending times."""
    up, down = (
        np.concatenate([delays_ms(profile, way) > SPIKE_MS for profile in profiles])
        for way in ("uplink", "downlink")
    )
    both = float(np.sum(up & down))
    return _part(both, float(down.sum())), _part(both, float(up.sum()))


def ns3_runs(scenario: Scenario) -> list[DelayProfile]:
    """The shipped ns-3 profiles of a scenario, from run 1 on."""
    return [
        load_profile(name) for name in shipped_names() if name.rpartition("/")[0] == scenario.name
    ]


def add_calibrate_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `calibrate`."""
    parser.add_argument("--seed", type=int, default=0, help="seed of the first profile")
    parser.add_argument("--count", type=int, default=100, help="number of profiles in a set")
    parser.add_argument(
        "--sets",
        type=int,
        default=1,
        help="number of sets of different seeds; several give ranges of the ratios",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("docs/figures/network-model.png"),
        metavar="FILE.png",
        help="figure to write",
    )
    parser.add_argument(
        "--table",
        type=Path,
        default=Path("docs/results/network-model.txt"),
        metavar="FILE.txt",
        help="table to write",
    )


def run_calibrate(arguments: argparse.Namespace) -> int:
    """Print and write the table, and draw the figure. Return 0."""
    from netem.generator.calibration_figure import draw  # imports matplotlib, which is slow

    seed, count, sets = arguments.seed, arguments.count, arguments.sets
    check_set(count, seed)
    if not 1 <= sets <= MAX_SETS:
        raise ConfigError(f"sets: expected from 1 to {MAX_SETS}, got {sets}")
    command = f"./wbc netem calibrate --seed {seed} --count {count} --sets {sets}"
    parts = [_header(command, seed=seed, count=count, sets=sets)]
    drawn = {}
    for scenario in SCENARIOS.values():
        ns3 = ns3_runs(scenario)
        generated = list(generate_set(scenario, count=count, seed=seed))
        others = [
            list(generate_set(scenario, count=count, seed=seed + k * count)) for k in range(1, sets)
        ]
        parts.append(table(scenario, ns3, generated, others))
        drawn[scenario.name] = (ns3, generated)
    text = "\n\n".join(parts) + "\n"
    print(text, end="")
    try:
        arguments.table.parent.mkdir(parents=True, exist_ok=True)
        arguments.table.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"table: cannot write {arguments.table}: {error.strerror}") from None
    draw(drawn, arguments.out)
    return EXIT_STANDING


def table(
    scenario: Scenario,
    ns3: Sequence[DelayProfile],
    generated: Sequence[DelayProfile],
    others: Sequence[Sequence[DelayProfile]] = (),
) -> str:
    """The part of the table for one scenario; `others`: more generated sets, for ratio ranges."""
    again = [p.metadata["draws"] - 1 for each in (generated, *others) for p in each]
    lines = [
        f"{scenario.name}: {len(ns3)} ns-3 runs, {len(generated)} generated; of "
        f"{len(again) + sum(again)} channels {sum(again)} drawn again for a delay above "
        f"{scenario.longest_ms:g} ms"
    ]
    for link in LINKS:
        halves = [Measured(half, link) for half in (ns3[::2], ns3[1::2])]
        whole, first = Measured(ns3, link), Measured(generated, link)
        lines += ["", *_figures(link, halves, whole, first, [Measured(s, link) for s in others])]
        lines += ["", *_distances(link, halves, first)]
    return "\n".join([*lines, "", *_shared(ns3, generated)])


def _figures(
    link: str,
    halves: Sequence[Measured],
    whole: Measured,
    generated: Measured,
    others: Sequence[Measured],
) -> list[str]:
    heading = ["ns-3 odd", "ns-3 even", "ns-3 all", "generated", "ratio"]
    rows = [[f"{link} [ms]", *heading, *(["lowest", "highest"] if others else [])]]
    for name, value in generated.figures.items():
        against = whole.figures[name]
        ratios = [value / against, *(other.figures[name] / against for other in others)]
        cells = [f"{each.figures[name]:.2f}" for each in (*halves, whole, generated)]
        rows.append([name, *cells, f"{ratios[0]:.2f}"])
        if others:
            rows[-1] += [f"{min(ratios):.2f}", f"{max(ratios):.2f}"]
    return aligned(rows, left=1)


def _distances(link: str, halves: Sequence[Measured], generated: Measured) -> list[str]:
    rows = [
        [f"{link}: D", "odd", "critical", "p", "even", "critical", "p", "n generated, odd, even"]
    ]
    for name, sample in generated.samples.items():
        against = [half.samples[name] for half in halves]
        cells = [cell for other in against for cell in _ks(sample, other)]
        sizes = ", ".join(str(len(each)) for each in (sample, *against))
        rows.append([name, *cells, sizes])
    every = [np.concatenate(each.runs) for each in (generated, *halves)]
    ds = [f"{distance(every[0], other):.3f}" for other in every[1:]]
    rows.append(["every delay", ds[0], "-", "-", ds[1], "-", "-", "not independent"])
    return aligned(rows, left=1)


def _ks(sample: np.ndarray, other: np.ndarray) -> tuple[str, str, str]:
    """D, its critical value at 5 % and p, as text."""
    n, m = len(sample), len(other)
    if not n or not m:
        return "-", "-", "-"
    d = distance(sample, other)
    critical = _CRITICAL * math.sqrt((n + m) / (n * m))
    return f"{d:.3f}", f"{critical:.3f}", f"{p_value(d, n, m):.2g}"


def distance(sample: np.ndarray, other: np.ndarray) -> float:
    """Kolmogorov–Smirnov statistic of two samples."""
    one, two = np.sort(sample), np.sort(other)
    values = np.concatenate([one, two])
    parts = [np.searchsorted(each, values, side="right") / len(each) for each in (one, two)]
    return float(np.abs(parts[0] - parts[1]).max())


def p_value(d: float, n: int, m: int) -> float:
    """Probability of a D of at least `d` for n and m independent values of one distribution.

    2 Σ (−1)ᵏ⁻¹ exp(−2 k² λ²), λ = (√e + 0.12 + 0.11/√e) D with e = n m/(n + m) (Stephens, 1970).
    """
    root = math.sqrt(n * m / (n + m))
    scaled = (root + 0.12 + 0.11 / root) * d
    if scaled < 0.2:  # the series converges slowly, to 1
        return 1.0
    k = np.arange(1, 101)
    terms = np.where(k % 2 == 1, 2.0, -2.0) * np.exp(-2.0 * (k * scaled) ** 2)
    return float(np.clip(terms.sum(), 0.0, 1.0))


def _shared(ns3: Sequence[DelayProfile], generated: Sequence[DelayProfile]) -> list[str]:
    sets = (ns3[::2], ns3[1::2], ns3, generated)
    shared = [shared_spikes(each) for each in sets]
    return aligned(
        [
            ["both ways", "ns-3 odd", "ns-3 even", "ns-3 all", "generated"],
            ["P(up | down in outage)", *(f"{up:.2f}" for up, _ in shared)],
            ["P(down | up in outage)", *(f"{down:.2f}" for _, down in shared)],
        ],
        left=1,
    )


def _header(command: str, *, seed: int, count: int, sets: int) -> str:
    found = versions()
    further = "" if sets == 1 else f"; lowest and highest ratio of {sets} such sets"
    return "\n".join(
        [
            "Generated delay profiles beside the shipped ns-3 profiles",
            command,
            f"{cpu_name()}; python {found['python']}, numpy {found['numpy']}; "
            f"seeds {seed} to {seed + count - 1}{further}",
            f"uplink {UPLINK_BYTES} B, downlink {DOWNLINK_BYTES} B at 1 kHz",
            f"an outage: messages delayed by more than {SPIKE_MS:g} ms; one per ms, so the "
            "duration [ms] is also the number of messages",
            "gains fitted to the odd ns-3 runs alone; ratio: generated / ns-3 all",
        ]
    )


def _part(of: float, whole: float) -> float:
    return of / whole if whole else math.nan


def _quantile(values: np.ndarray, q: float) -> float:
    return float(np.quantile(values, q)) if len(values) else math.nan
