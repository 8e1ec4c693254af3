"""The options of an import, and their notation: `40000B@1kHz`, `2ms/3ms`."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from netem.profile import PERIOD_NS
from shared.config.quantities import parse_duration_ns
from shared.errors import ConfigError

T = TypeVar("T")
_MULTIPLES = {"": 1, "k": 1000, "M": 1000**2, "G": 1000**3, "Ki": 1024, "Mi": 1024**2}
_QUEUE_BYTES = 20 * 1024**2  # as in the shipped profiles
MAX_RATE_HZ = 1e6


@dataclass(frozen=True)
class Load:
    """Messages of `size` bytes, `rate_hz` of them a second."""

    size: int
    rate_hz: float


@dataclass(frozen=True)
class Options:
    """The options of all importers. Each importer takes its own. Pairs are uplink and downlink.

    None stands for an option that the user has not given. `beside` is the file that belongs to
    another one: the receiver's to the sender's, ns-3's sendings to its receptions.
    """

    period_ns: int = PERIOD_NS
    pause: str = "refuse"
    lone_loss: str = "interval"
    interval_ns: int | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    unit: str | None = None
    lost: tuple[str, ...] = ()
    beside: Mapping[Path, Path] = field(default_factory=dict)
    clock: str | None = None
    rnti: int | None = None
    imsi: int | None = None
    cell: int | None = None
    robot: str | None = None
    phy: Path | None = None
    load: tuple[Load, Load] | None = None
    base_delay_ns: tuple[int, int] | None = None
    queue_bytes: int = _QUEUE_BYTES
    delay_ns: tuple[int, int] | None = None
    jitter_ns: tuple[int, int] | None = None
    correlation: float = 0.0
    duration_ns: int | None = None
    seed: int = 0


def parse_size(text: str) -> int:
    """`40000B`, `40kB` or `20MiB` → bytes."""
    match = re.fullmatch(r"([0-9]*\.?[0-9]+) ?(|k|M|G|Ki|Mi)B", text.strip())
    size = round(float(match[1]) * _MULTIPLES[match[2]]) if match else 0
    if not 1 <= size <= 1e12:
        raise ConfigError(f"expected a size as in 40000B, 40kB or 20MiB, got {text!r}")
    return size


def parse_load(text: str) -> Load:
    """`40000B@1kHz` → messages of 40 000 bytes, a thousand a second."""
    size, _, rate = text.partition("@")
    match = re.fullmatch(r"([0-9]*\.?[0-9]+) ?(|k|M)Hz", rate.strip())
    rate_hz = float(match[1]) * _MULTIPLES[match[2]] if match else 0.0
    if not 1e-3 <= rate_hz <= MAX_RATE_HZ:
        raise ConfigError(f"expected a load as in 40000B@1kHz, got {text!r}")
    return Load(parse_size(size), rate_hz)


def per_way(text: str, parse: Callable[[str], T]) -> tuple[T, T]:
    """`2ms` → the same both ways; `2ms/3ms` → uplink and downlink."""
    parts = [parse(part) for part in text.split("/")]
    if len(parts) > 2:
        raise ConfigError(f"expected one value or UPLINK/DOWNLINK, got {text!r}")
    return parts[0], parts[-1]


def parse_fraction(text: str) -> float:
    """`25%` or `0.25`, at least 0 and less than 1."""
    match = re.fullmatch(r"([0-9]*\.?[0-9]+) ?(%?)", text.strip())
    value = float(match[1]) / (100 if match[2] else 1) if match else 1.0
    if not 0 <= value < 1:
        raise ConfigError(f"expected a fraction from 0 to below 1 as in 25% or 0.25, got {text!r}")
    return value


def parse_columns(text: str) -> dict[str, str]:
    """`sent=pub_time(ms),received=sub_time(ms)` → the column of each meaning."""
    parts = [part.partition("=") for part in text.split(",")]
    if any(not key.strip() or not name.strip() for key, _, name in parts):
        raise ConfigError(
            f"expected columns as in sent=pub_time(ms),received=sub_time(ms), got {text!r}"
        )
    return {key.strip(): name.strip() for key, _, name in parts}


def parse_marks(text: str) -> tuple[str, ...]:
    """`-1,0` → the values that stand for a lost packet."""
    return tuple(part.strip() for part in text.split(","))


def parse_period_ns(text: str) -> int:
    """The period of a profile, from 1 µs to 1 s."""
    period_ns = parse_duration_ns(text)
    if not 1_000 <= period_ns <= 1_000_000_000:
        raise ConfigError(f"expected a period from 1us to 1s, got {text!r}")
    return period_ns
