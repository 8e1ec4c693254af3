"""Generate seeded delay profiles of a modelled 5G link: `./wbc netem generate factory --out DIR`.

The steps are channel (`channel`) → capacity (`rate_adaptation`) → queue (`queueing`) → one-way
delays. Both ways share one channel. `docs/network-model.md` describes the model and compares it
with the shipped ns-3 profiles.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from netem.generator.channel import SCENARIOS, Scenario, draw_channel
from netem.generator.queueing import delays_ns, departures
from netem.generator.rate_adaptation import capacity_per_ms
from netem.profile import DOWNLINK, LOST, PERIOD_NS, UPLINK, DelayProfile
from netem.profile_file import write_profile
from netem.statistics import delay_spikes, delays_ms
from shared.errors import ConfigError, one_of
from shared.process.cli import EXIT_STANDING

SOURCE = "generated, docs/network-model.md"
# The load of the paper [bytes per message]. It decides whether a drawn channel is accepted.
UPLINK_BYTES = 1_000
DOWNLINK_BYTES = 40_000
SECONDS = 6.0
QUEUE_BYTES = 20 * 2**20
# Delay of a message in an empty queue, without the time for its bytes: 1 ms between base station
# and edge, and the rest for the radio's frames.
BASE_NS = (1_698_000, 1_645_000)
# Longer runs almost always exceed the longest delay of the paper, so drawing them would not end.
MAX_SECONDS = 60.0
MAX_COUNT = 10_000
MAX_MESSAGE_BYTES = 10_000_000
# Time after the last message in which it can still leave the queue.
_AFTER_MS = 1_000
_UNITS = {"B": 1, "kB": 1_000, "MB": 1_000_000}


def generate_profile(
    scenario: Scenario,
    seed: int,
    *,
    seconds: float = SECONDS,
    uplink_bytes: int = UPLINK_BYTES,
    downlink_bytes: int = DOWNLINK_BYTES,
) -> DelayProfile:
    """The profile of a seed. The channel does not depend on the load.

    A channel is drawn again if it delays a message of the paper's load for longer than the paper
    reports. `draws` in the metadata counts the draws.
    """
    rng = np.random.default_rng([seed, *scenario.name.encode()])
    n = round(seconds * 1000)
    longest_ns = scenario.longest_ms * 1e6
    draws = 0
    while True:
        draws += 1
        channel = draw_channel(scenario, rng, n + _AFTER_MS)
        capacity = capacity_per_ms(channel.snr_db, rng)
        delays = _delays(capacity, n, uplink_bytes=UPLINK_BYTES, downlink_bytes=DOWNLINK_BYTES)
        if delays.min() != LOST and delays.max() <= longest_ns:
            break
    if (uplink_bytes, downlink_bytes) != (UPLINK_BYTES, DOWNLINK_BYTES):
        delays = _delays(capacity, n, uplink_bytes=uplink_bytes, downlink_bytes=downlink_bytes)
    bytes_per_ms = np.rint(capacity[:, :n]).astype(np.uint32)
    return DelayProfile(
        name=f"{scenario.name} {seed}",
        delays_ns=delays,
        metadata={
            "scenario": scenario.name,
            "source": SOURCE,
            "seed": seed,
            "draws": draws,
            "distance": round(float(channel.distance[0]), 3),
            "blockers": [
                {"width": round(float(width), 4), "fraction": round(float(fraction), 4)}
                for width, fraction in zip(
                    channel.blockers.width, channel.blockers.fraction, strict=True
                )
            ],
            "uplink_bytes": uplink_bytes,
            "downlink_bytes": downlink_bytes,
            "rate_hz": 1e9 / PERIOD_NS,
        },
        columns={
            "n_block": channel.n_block[:n].astype(np.uint8),
            "sinr_dl_db": channel.snr_db[:n].astype(np.float16),
            "uplink_capacity_bytes": bytes_per_ms[UPLINK],
            "downlink_capacity_bytes": bytes_per_ms[DOWNLINK],
        },
    )


def _delays(capacity: np.ndarray, n: int, *, uplink_bytes: int, downlink_bytes: int) -> np.ndarray:
    """One-way delays of the first n messages, uplink and downlink, (2, n) [ns]."""
    return np.stack(
        [
            delays_ns(
                departures(capacity[way], message_bytes=size, queue_bytes=QUEUE_BYTES)[:n],
                base_ns=BASE_NS[way],
                period_ns=PERIOD_NS,
            )
            for way, size in ((UPLINK, uplink_bytes), (DOWNLINK, downlink_bytes))
        ]
    )


def generate_set(
    scenario: Scenario,
    *,
    count: int,
    seed: int,
    seconds: float = SECONDS,
    uplink_bytes: int = UPLINK_BYTES,
    downlink_bytes: int = DOWNLINK_BYTES,
) -> Iterator[DelayProfile]:
    """Generate the profiles of the seeds `seed` to `seed` + `count` − 1."""
    for k in range(count):
        yield generate_profile(
            scenario,
            seed + k,
            seconds=seconds,
            uplink_bytes=uplink_bytes,
            downlink_bytes=downlink_bytes,
        )


def add_generate_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `generate`."""
    parser.add_argument("scenario", help=f"one of {', '.join(SCENARIOS)}")
    parser.add_argument("--count", type=int, default=100, help="number of profiles")
    parser.add_argument(
        "--seed",
        type=int,
        default=0,
        help="seed of the first profile; each further seed is 1 larger",
    )
    parser.add_argument(
        "--seconds", type=float, default=SECONDS, help="duration of each profile [s]"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("generated"), metavar="DIR", help="folder of the profiles"
    )
    parser.add_argument(
        "--uplink",
        default=f"{UPLINK_BYTES}B",
        metavar="1000B",
        help="payload of a message up, at 1000 messages per second",
    )
    parser.add_argument(
        "--downlink",
        default=f"{DOWNLINK_BYTES}B",
        metavar="40000B",
        help="payload of a message down",
    )


def run_generate(arguments: argparse.Namespace) -> int:
    """Write `DIR/factory-0000.npz` and so on. Return 0."""
    scenario = scenario_named(arguments.scenario)
    check_set(arguments.count, arguments.seed)
    if not 0.1 <= arguments.seconds <= MAX_SECONDS:
        raise ConfigError(
            f"seconds: expected from 0.1 to {MAX_SECONDS:g}, got {arguments.seconds:g}"
        )
    uplink_bytes = parse_bytes("uplink", arguments.uplink)
    downlink_bytes = parse_bytes("downlink", arguments.downlink)
    try:
        arguments.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"out: cannot make folder {arguments.out}: {error.strerror}") from None
    profiles = generate_set(
        scenario,
        count=arguments.count,
        seed=arguments.seed,
        seconds=arguments.seconds,
        uplink_bytes=uplink_bytes,
        downlink_bytes=downlink_bytes,
    )
    longest, spikes, lost, again = 0.0, 0, 0, 0
    for k, profile in enumerate(profiles):
        write_profile(profile, arguments.out / f"{scenario.name}-{k:04d}.npz")
        for way in ("uplink", "downlink"):
            delays = delays_ms(profile, way)
            longest = max(longest, *delays[np.isfinite(delays)])
        spikes += len(delay_spikes(delays_ms(profile, "downlink")))
        lost += int(np.sum(profile.delays_ns == LOST))
        again += profile.metadata["draws"] - 1
    print(
        f"{arguments.count} profiles of {arguments.seconds:g} s in {arguments.out}, seeds "
        f"{arguments.seed} to {arguments.seed + arguments.count - 1}: "
        f"{spikes / (arguments.count * arguments.seconds):.2f} delay spikes per second down, "
        f"longest one-way delay {longest:.0f} ms, {lost} messages lost; "
        f"{again} channels drawn again"
    )
    return EXIT_STANDING


def scenario_named(name: str) -> Scenario:
    """The scenario of a name; `ConfigError` with the valid names for an unknown name."""
    if name not in SCENARIOS:
        raise ConfigError(f"scenario: {one_of(SCENARIOS, name)}")
    return SCENARIOS[name]


def check_set(count: int, seed: int) -> None:
    """Raise `ConfigError` for an invalid number of profiles or seed."""
    if not 1 <= count <= MAX_COUNT:
        raise ConfigError(f"count: expected from 1 to {MAX_COUNT} profiles, got {count}")
    if seed < 0:
        raise ConfigError(f"seed: expected 0 or more, got {seed}")


def parse_bytes(name: str, text: str) -> int:
    """Parse `1000B`, `40kB` or `1000` to bytes."""
    match = re.fullmatch(r"([0-9]+)(B|kB|MB)?", text.strip())
    size = int(match[1]) * _UNITS[match[2] or "B"] if match else 0
    if not 1 <= size <= MAX_MESSAGE_BYTES:
        raise ConfigError(
            f"{name}: expected the bytes of a message as in 1000B or 40kB, from 1B to "
            f"{MAX_MESSAGE_BYTES // 1_000_000}MB, got {text!r}"
        )
    return size
