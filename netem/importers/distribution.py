"""Distributions of a delay, without its order in time: tables of tc-netem, and histograms.

netem: whole numbers, 8192 to a standard deviation. A delay is DELAY + JITTER · x / 8192, or 0 where
that is negative. Successive draws may be correlated: z_k = ρ z_{k−1} + √(1 − ρ²) ε_k, and x is the
table at the quantile of z_k. (The kernel mixes uniform numbers instead, which narrows the
distribution.)

Histogram: XML as the DETERMINISTIC6G simulator reads it, `<bin low="1.5ms">count</bin>`. Each bin
reaches up to the next one's low. Or lines of a bin's low in ms and its count.

No draw has outages. An outage is many late messages in a row, and a distribution has no order.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from netem.importers.measured import UNITS_NS, Measured, Way, one_way, ordered
from netem.importers.options import Options
from netem.importers.resample import check_span
from netem.importers.source import content_lines, nanoseconds, number, whole, wrong
from netem.profile import DIRECTIONS
from shared.errors import ProfileError

_SIGMA = 8192
_MAX_TABLE = 1 << 20
_DURATION_NS = 60_000_000_000
_BIN = re.compile(
    r"""<bin low ?= ?["']([-+\w.]{1,40}?) ?([a-zµμ]{0,2})["'] ?> ?([^<\s]{1,40}) ?</bin>"""
)


def read_netem_table(path: Path, options: Options, direction: int) -> Measured:
    """Delays drawn from a table. `ProfileError` names the line that is wrong."""
    if options.delay_ns is None or options.jitter_ns is None:
        raise ProfileError(
            f"{path}: expected --delay and --jitter, the mean and the standard deviation of a "
            "table of tc-netem, got less; try --delay 10ms --jitter 2ms"
        )
    table = []
    for line, text in content_lines(path):
        for cell in text.split():
            expected = "whole numbers from -32768 to 32767, as in a netem table"
            table.append(whole(cell, path, f"line {line}", expected, low=-(2**15), high=2**15 - 1))
        if len(table) > _MAX_TABLE:
            raise wrong(path, f"line {line}", f"at most {_MAX_TABLE} numbers", text)
    if len(table) < 2:
        raise ProfileError(f"{path}: expected the numbers of a netem table, got {len(table)}")
    # scipy.signal is slow to import, and the other commands of netem do not need it.
    from scipy.signal import lfilter
    from scipy.special import ndtr

    rng = np.random.default_rng([options.seed, direction])
    n, rho = _count(path, options), options.correlation
    noise = rng.standard_normal(n)
    noise[1:] *= np.sqrt(1 - rho**2)
    quantiles = ndtr(lfilter([1.0], [1.0, -rho], noise))
    values = np.sort(table)[np.minimum((quantiles * len(table)).astype(int), len(table) - 1)]
    mean, jitter = options.delay_ns[direction], options.jitter_ns[direction]
    delays = np.rint(mean + jitter * (values / _SIGMA)).astype(np.int64)
    early = int((delays < 0).sum())
    name = DIRECTIONS[direction]
    notes = [f"{name}: drawn from a distribution, correlation {rho:g}: no outages"]
    if early:
        notes.append(f"{name}: {early} negative delays of {n} taken as 0")
    return one_way(direction, _way(np.maximum(delays, 0), options), *notes)


def read_histogram(path: Path, options: Options, direction: int) -> Measured:
    """Delays drawn from a histogram. `ProfileError` names the line that is wrong."""
    lows, counts = [], []
    for line, text in content_lines(path):
        where = f"line {line}"
        found = _BIN.findall(text)
        if len(found) != text.count("<bin") or (not found and not _is_frame(text)):
            found = _two_columns(path, where, text)
        for low, unit, count in found:
            counts.append(
                number(
                    count,
                    path,
                    where,
                    "a bin's count",
                )
            )
            if unit not in UNITS_NS or counts[-1] < 0:
                raise wrong(path, where, 'a bin as in <bin low="1.5ms">12</bin>', text.strip())
            if low.lstrip("+-") == "inf":
                if counts.pop():
                    raise wrong(path, where, "nothing in a bin without bounds", text.strip())
                continue
            lows.append(nanoseconds(low, UNITS_NS[unit], path, where, "a bin's low"))
            if (len(lows) > 1 and lows[-1] <= lows[-2]) or lows[-1] < 0:
                raise wrong(path, where, "bins in order of their low, none below 0", text.strip())
    if len(lows) < 2 or not sum(counts):
        raise ProfileError(f"{path}: expected a histogram of at least two bins, got none")
    rng = np.random.default_rng([options.seed, direction])
    n = _count(path, options)
    edges = np.append(lows, 2 * lows[-1] - lows[-2])
    bins = rng.choice(len(lows), size=n, p=np.array(counts) / sum(counts))
    delays = edges[bins] + rng.random(n) * np.diff(edges)[bins]
    note = f"{DIRECTIONS[direction]}: each drawn by itself from a distribution: no outages"
    return one_way(direction, _way(np.rint(delays).astype(np.int64), options), note)


def _two_columns(path: Path, where: str, text: str) -> list[tuple[str, str, str]]:
    cells = text.replace(",", " ").split()
    if len(cells) != 2:
        raise wrong(path, where, '<bin low="1.5ms">12</bin>, or a low in ms and a count', text)
    return [(cells[0], "ms", cells[1])]


def _is_frame(text: str) -> bool:
    """Return whether a text is markup around the bins, or blank."""
    return re.fullmatch(r"(<\?[^>]*>|<!--[^>]*-->|</?histograms?[^>]*>|\s)*", text) is not None


def _count(path: Path, options: Options) -> int:
    duration_ns = options.duration_ns or _DURATION_NS
    check_span(path, duration_ns, options.period_ns)
    return max(1, duration_ns // options.period_ns)


def _way(delays: np.ndarray, options: Options) -> Way:
    return ordered(np.arange(len(delays)) * options.period_ns, delays)
