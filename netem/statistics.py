"""Statistics of a profile's delays: quantiles, delay spikes, memory.

A delay spike is a run of messages that were lost, or took longer than both `SPIKE_MS` and twice the
median. Such delays are far above the base delay with its retransmissions, and a controller notices
them. The peak of a spike is the longest delay in it. An outage, in which no message passes the
link, makes a spike of the messages sent in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from netem.profile import DOWNLINK, LOST, UPLINK, DelayProfile

SPIKE_MS = 9.0
LINKS = ("uplink", "downlink", "round trip")
_QUANTILES = (0.5, 0.9, 0.99, 0.999)


@dataclass(frozen=True)
class DelaySpike:
    """A spike of messages `first` to `last`, both included. `peak_ms` is inf if all are lost."""

    first: int
    last: int
    peak_ms: float

    @property
    def messages(self) -> int:
        """The number of messages in the spike."""
        return self.last - self.first + 1


@dataclass(frozen=True)
class DelayStatistics:
    """Statistics of one link over one or several profiles; [ms] unless another unit is given.

    `median`, `q90`, `q99`, `q999` and `maximum` are those of the delays that were not lost. `lost`
    is the fraction of messages lost. `spikes_per_second` is in [1/s]. `peak_median` and `peak_q90`
    are over the spikes, `duration_median` and `duration_maximum` over their durations.
    `lost_maximum` is the longest run of losses [ms]. `memory` is the lag at which the
    autocorrelation of the delay has fallen to 1/e. A value that does not exist is NaN.
    """

    median: float
    q90: float
    q99: float
    q999: float
    maximum: float
    lost: float
    spikes_per_second: float
    peak_median: float
    peak_q90: float
    duration_median: float
    duration_maximum: float
    lost_maximum: float
    memory: float


def delays_ms(profile: DelayProfile, link: str) -> np.ndarray:
    """One-way delays, or the round trip of each message, [ms] (n,); inf for a lost one.

    A round trip is the delay of the message up plus that of an answer sent at its arrival.
    """
    ways = np.where(profile.delays_ns == LOST, np.inf, profile.delays_ns * 1e-6)
    up: np.ndarray = ways[UPLINK]
    down: np.ndarray = ways[DOWNLINK]
    if link != "round trip":
        return down if link == "downlink" else up
    n, period_ms = ways.shape[1], profile.period_ns * 1e-6
    passed = np.isfinite(up)
    arrival = np.arange(n) + (np.where(passed, up, 0.0) // period_ms).astype(int)
    round_trip: np.ndarray = up + down[arrival % n]
    return round_trip


def delay_spikes(delays: np.ndarray) -> list[DelaySpike]:
    """The spikes in one direction's delays [ms] (n,), in order."""
    threshold = max(SPIKE_MS, 2.0 * float(np.median(delays[np.isfinite(delays)])))
    found = []
    for first, end in _runs(delays > threshold):
        within = delays[first:end]
        passed = within[np.isfinite(within)]
        found.append(
            DelaySpike(int(first), int(end) - 1, float(passed.max()) if len(passed) else np.inf)
        )
    return found


def longest_run(marked: np.ndarray) -> int:
    """The length of the longest run of marks."""
    return int(np.diff(_runs(marked)).max(initial=0))


def _runs(marked: np.ndarray) -> np.ndarray:
    """Return the first index of each run of marks and the index after its last, (n, 2)."""
    edges = np.diff(np.concatenate([[False], marked, [False]]).astype(np.int8))
    return np.flatnonzero(edges).reshape(-1, 2)


def statistics(profiles: Sequence[DelayProfile], link: str) -> DelayStatistics:
    """The statistics of all profiles together. `link` is one of `LINKS`."""
    series = [delays_ms(profile, link) for profile in profiles]
    periods_ms = [profile.period_ns * 1e-6 for profile in profiles]
    every = np.concatenate(series)
    passed = every[np.isfinite(every)]
    events = [
        (spike, period)
        for each, period in zip(series, periods_ms, strict=True)
        for spike in delay_spikes(each)
    ]
    seconds = (
        sum(len(each) * period for each, period in zip(series, periods_ms, strict=True)) / 1000
    )
    peaks = [spike.peak_ms for spike, _ in events if np.isfinite(spike.peak_ms)]
    durations = [spike.messages * period for spike, period in events]
    median, q90, q99, q999 = (float(q) for q in np.quantile(passed, _QUANTILES))
    return DelayStatistics(
        median=median,
        q90=q90,
        q99=q99,
        q999=q999,
        maximum=float(passed.max()),
        lost=1.0 - len(passed) / len(every),
        spikes_per_second=len(events) / seconds,
        peak_median=_quantile(peaks, 0.5),
        peak_q90=_quantile(peaks, 0.9),
        duration_median=_quantile(durations, 0.5),
        duration_maximum=_quantile(durations, 1.0),
        lost_maximum=max(
            longest_run(~np.isfinite(each)) * period
            for each, period in zip(series, periods_ms, strict=True)
        ),
        memory=_memory(series, periods_ms),
    )


def autocorrelation(series: Sequence[np.ndarray], lags: int) -> np.ndarray:
    """The autocorrelation of the delay over lags 0 … `lags` − 1, pooled over series of one period.

    A lost message has the delay of the one before it.
    """
    filled = [_filled(each) for each in series]
    mean = np.concatenate(filled).mean()
    products, counts = np.zeros(lags), np.zeros(lags)
    for each in filled:
        n = len(each)
        # The Wiener–Khinchin theorem. The zeros keep the ends of the series apart.
        spectrum = np.fft.rfft(each - mean, 2 * n)
        known = min(lags, n)
        products[:known] += np.fft.irfft(np.abs(spectrum) ** 2)[:known]
        counts[:known] += n - np.arange(known)
    covariance = products / np.maximum(counts, 1)
    return covariance / covariance[0] if covariance[0] > 0 else np.full(lags, np.nan)


def _memory(series: Sequence[np.ndarray], periods_ms: Sequence[float]) -> float:
    lags = min(1000, max(len(each) for each in series))
    below = np.flatnonzero(autocorrelation(series, lags) < np.exp(-1))
    return float(below[0] * periods_ms[0]) if len(below) else np.nan


def _filled(delays: np.ndarray) -> np.ndarray:
    """The delays with each lost message at the delay before it, or at 0 without one."""
    passed = np.isfinite(delays)
    index = np.maximum.accumulate(np.where(passed, np.arange(len(delays)), 0))
    return np.where(np.isfinite(delays[index]), delays[index], 0.0)


def _quantile(values: Sequence[float], q: float) -> float:
    return float(np.quantile(values, q)) if values else np.nan
