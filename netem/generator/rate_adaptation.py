"""From SNR to bytes: what the link can carry in each millisecond, each way.

Rate. Spectral efficiency η of TS 38.214 Table 5.1.3.1-1, the highest that is decoded at a bit error
rate of 5·10⁻⁵: η ≤ log₂(1 + SNR/Γ), Γ = −ln(5 BER)/1.5.

Adaptation. The sender learns of a worse channel by failing: what is on its way is lost, and nothing
passes until a round of HARQ has come back or the next rate is agreed. Below `_USABLE_DB` only a
probe is sent every `_PROBE_MS`; the first that finds a usable channel ends the silence, so an
outage outlasts its cause by up to 19 ms. Above `_PROBED_DB` probes carry some bytes. The first of
them wait until the message at the head of the queue has come again, for the receiver keeps order.

The numbers are fitted to the shipped ns-3 profiles; `docs/network-model.md` says how.
"""

from __future__ import annotations

import numpy as np

# TS 38.214 Table 5.1.3.1-1, MCS 0 to 28 [bit/s/Hz], in ascending order.
SPECTRAL_EFFICIENCY = np.array(
    [
        *(0.2344, 0.3066, 0.3770, 0.4902, 0.6016, 0.7402, 0.8770, 1.0273, 1.1758, 1.3262),
        *(1.3281, 1.4766, 1.6953, 1.9141, 2.1602, 2.4063, 2.5664, 2.5703, 2.7305, 3.0293),
        *(3.3223, 3.6094, 3.9023, 4.2129, 4.5234, 4.8164, 5.1152, 5.3320, 5.5547),
    ]
)
SNR_GAP = -np.log(5 * 5e-5) / 1.5
# Bytes per millisecond and bit/s/Hz: 125 kB at 1 GHz, less reference signals and control.
_BYTES_PER_EFFICIENCY = 92_000.0
# On the air per byte of payload: headers of IP, UDP, PDCP and RLC around each fragment.
_OVERHEAD = 1.035
_UPLINK_SHARE = 0.5

_USABLE_DB = 0.7
_PROBED_DB = -7.0
# Below it a fall costs the time until the next rate is agreed, below `_ROBUST_DB` a round of HARQ.
_FRAGILE_DB = 5.5
_ROBUST_DB = 16.0
# A fall by less is within the margin of the rate in use.
_STEP_DB = 3.0
_HARQ_MS = 1.0
_AGREED_MS = 4.0
# The downlink, with forty times the bytes on their way, needs so much longer.
_AGREED_LATER_MS = (1.5, 5.0)
# Below it a block is lost beyond HARQ now and then and comes again after so long; in the downlink,
# of larger blocks, below `_FRAGILE_DB` too, and sooner.
_MARGINAL_DB = 2.0
_STALLS_PER_MS = 0.02
_STALL_MS = 12.0
_DOWNLINK_STALLS_PER_MS = 0.03
_DOWNLINK_STALL_MS = 3.5

_PROBE_MS = 13.0
_PROBE_BYTES = 8_200.0
# The first probe that gets the head of the queue through, if the channel is bad throughout.
_HEAD_PROBE = 3
# A sender of a rate for less SNR than this loses no head: its first probe is decoded.
_LOW_RATE_DB = 10.0
_RELEASE_MS = (0.5, 2.5)
# More if the probe before was not heard either: the robot has to ask for leave to send first.
_UNHEARD_MS = 3.0
# The downlink starts later: part of what waits has to come again before its first message is whole.
_RELEASE_LATER_MS = (0.0, 4.0)
_COMES_AGAIN = 0.04


def payload_per_ms(snr_db: np.ndarray) -> np.ndarray:
    """Payload of the downlink at an SNR that its rate has followed, (n,) [bytes per ms]."""
    reached = np.log2(1.0 + 10.0 ** (np.asarray(snr_db) / 10.0) / SNR_GAP)
    mcs = np.searchsorted(SPECTRAL_EFFICIENCY, reached, side="right") - 1
    payload = _BYTES_PER_EFFICIENCY / _OVERHEAD * SPECTRAL_EFFICIENCY[np.maximum(mcs, 0)]
    return np.where(np.asarray(snr_db) < _USABLE_DB, 0.0, payload)


def capacity_per_ms(snr_db: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Payload that the link can carry in each millisecond, uplink and downlink, (2, n) [bytes]."""
    payload = payload_per_ms(snr_db).tolist()
    capacity = np.zeros((2, len(payload)))
    rate_db = float(snr_db[0])  # what the sender takes the SNR for
    resume, later = 0.0, 0.0  # when either way carries again
    silent_since, probes, heard = -1, 0, True
    for t, snr in enumerate(snr_db.tolist()):
        if silent_since < 0 and snr < _USABLE_DB:
            silent_since, probes, heard = t, 0, True
        if silent_since >= 0:
            if t < silent_since + (probes + 1) * _PROBE_MS:
                continue
            probes += 1
            if snr < _USABLE_DB:
                heard = snr >= _PROBED_DB
                capacity[:, t] = _probed(snr, probes, low_rate=rate_db < _LOW_RATE_DB)
                continue
            resume = t + rng.uniform(*_RELEASE_MS) + (0.0 if heard else _UNHEARD_MS)
            later = resume + rng.uniform(*_RELEASE_LATER_MS) + _COMES_AGAIN * (t - silent_since)
            silent_since = -1
        elif snr < min(rate_db - _STEP_DB, _FRAGILE_DB):
            resume = t + _AGREED_MS
            later = resume + rng.uniform(*_AGREED_LATER_MS)
        elif snr < min(rate_db - _STEP_DB, _ROBUST_DB):
            resume = later = t + _HARQ_MS
        elif snr < _FRAGILE_DB and t >= later:
            if snr < _MARGINAL_DB and rng.random() < _STALLS_PER_MS:
                resume = later = t + _STALL_MS
            elif rng.random() < _DOWNLINK_STALLS_PER_MS:
                later = t + _DOWNLINK_STALL_MS
        rate_db = snr
        if t + 1 > resume:
            capacity[0, t] = _UPLINK_SHARE * payload[t]
        if t + 1 > later:
            capacity[1, t] = payload[t]
    return capacity


def _probed(snr_db: float, probes: int, *, low_rate: bool) -> float:
    """Payload that a probe carries through [bytes]."""
    if snr_db < _PROBED_DB:
        return 0.0
    if low_rate or probes > _HEAD_PROBE:
        return _PROBE_BYTES / _OVERHEAD
    # until the head of the queue has come, what else was received is not handed on
    return _HEAD_PROBE * _PROBE_BYTES / _OVERHEAD if probes == _HEAD_PROBE else 0.0
