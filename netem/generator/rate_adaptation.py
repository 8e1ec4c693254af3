"""Capacity of the link from its SNR: the bytes that it can carry in each millisecond, each way.

Rate. The spectral efficiency η is the highest of TS 38.214 Table 5.1.3.1-1 that is decoded at a bit
error rate of 5·10⁻⁵: η ≤ log₂(1 + SNR/Γ), Γ = −ln(5 BER)/1.5.

Adaptation. The sender learns of a worse channel from failures. The data under way are lost, and no
data pass until a round of HARQ has come back or the next rate is agreed. Below `_USABLE_DB` the
sender sends only a probe every `_PROBE_MS`. The first probe on a usable channel ends the silence,
so an outage outlasts its cause by up to 19 ms. Above `_PROBED_DB` probes carry some bytes. The
receiver keeps order, so the first probes wait until the message at the head of the queue has been
sent again.

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
# Bytes on the air per byte of payload: headers of IP, UDP, PDCP and RLC around each fragment.
_OVERHEAD = 1.035
_UPLINK_SHARE = 0.5

_USABLE_DB = 0.7
_PROBED_DB = -7.0
# A fall of the SNR below `_FRAGILE_DB` costs the time until the next rate is agreed. A fall below
# `_ROBUST_DB` costs a round of HARQ.
_FRAGILE_DB = 5.5
_ROBUST_DB = 16.0
# A smaller fall of the SNR is within the margin of the rate in use.
_STEP_DB = 3.0
_HARQ_MS = 1.0
_AGREED_MS = 4.0
# The downlink has forty times the bytes under way, and needs this much longer.
_AGREED_LATER_MS = (1.5, 5.0)
# Below `_MARGINAL_DB` HARQ loses a block now and then, which is sent again after `_STALL_MS`. The
# downlink has larger blocks: it also loses them below `_FRAGILE_DB`, and sends them again sooner.
_MARGINAL_DB = 2.0
_STALLS_PER_MS = 0.02
_STALL_MS = 12.0
_DOWNLINK_STALLS_PER_MS = 0.03
_DOWNLINK_STALL_MS = 3.5

_PROBE_MS = 13.0
_PROBE_BYTES = 8_200.0
# The number of the first probe that delivers the head of the queue while the channel stays bad.
_HEAD_PROBE = 3
# A sender with a rate for a lower SNR than this loses no head: its first probe is decoded.
_LOW_RATE_DB = 10.0
_RELEASE_MS = (0.5, 2.5)
# Additional time if the probe before was not received: the robot must first request to send.
_UNHEARD_MS = 3.0
# The downlink starts later: part of the queue is sent again before its first message is complete.
_RELEASE_LATER_MS = (0.0, 4.0)
_COMES_AGAIN = 0.04


def payload_per_ms(snr_db: np.ndarray) -> np.ndarray:
    """Payload of the downlink with a rate that matches the SNR, (n,) [bytes per ms]."""
    reached = np.log2(1.0 + 10.0 ** (np.asarray(snr_db) / 10.0) / SNR_GAP)
    mcs = np.searchsorted(SPECTRAL_EFFICIENCY, reached, side="right") - 1
    payload = _BYTES_PER_EFFICIENCY / _OVERHEAD * SPECTRAL_EFFICIENCY[np.maximum(mcs, 0)]
    return np.where(np.asarray(snr_db) < _USABLE_DB, 0.0, payload)


def capacity_per_ms(snr_db: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Payload that the link can carry in each millisecond, uplink and downlink, (2, n) [bytes]."""
    payload = payload_per_ms(snr_db).tolist()
    capacity = np.zeros((2, len(payload)))
    rate_db = float(snr_db[0])  # the SNR that the sender assumes
    resume, later = 0.0, 0.0  # the times at which uplink and downlink carry data again
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
    """The payload that a probe delivers [bytes]."""
    if snr_db < _PROBED_DB:
        return 0.0
    if low_rate or probes > _HEAD_PROBE:
        return _PROBE_BYTES / _OVERHEAD
    # The receiver holds back later data until the head of the queue has come.
    return _HEAD_PROBE * _PROBE_BYTES / _OVERHEAD if probes == _HEAD_PROBE else 0.0
