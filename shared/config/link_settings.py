"""Settings of the tick `[loop]`, of the emulated link `[link]` and of messages `[wire]`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from shared.config.quantities import Outage, parse_duration_ns, parse_outage
from shared.config.setting import setting


@dataclass(frozen=True)
class LoopConfig:
    """The 1 kHz tick.

    If its newest projector is older than `hold_after`, the robot holds its joints. The default is
    longer than the outages of the factory and building profiles, and shorter than LA can stand.

    If nothing has come from the other end of a `tcp/` connection for `link_lease`, the connection
    is closed and made again. So is a `tls/` connection on Linux, if nothing is acknowledged. Each
    end tells the other one its own `link_lease`.
    """

    period_ns: int = setting(1_000_000, help="length of a tick; no other value is supported")
    fresh_within_ns: int = setting(500_000, help="deadline d* of Eq. (7), within the period")
    hold_after: float = setting(
        0.5,
        help="projector age above which the robot holds its joints",
        unit="s",
        at_least=0.0,
        may_be_infinite=True,
    )
    edge_compute_ns: int = setting(
        300_000, help="the edge's computing time in lockstep, where none is measured", at_least=0
    )
    connect_timeout: float = setting(
        20.0, help="time that the robot waits for its first projector", unit="s", at_least=0.0
    )
    link_lease: float = setting(
        1.0,
        help="silence after which a tcp/ or tls/ connection is made again",
        unit="s",
        at_least=0.2,
    )


@dataclass(frozen=True)
class LinkConfig:
    """The emulated link.

    With `capacity:` before a profile, its capacity is replayed instead of its delays. Then each
    direction queues at most `queue_bytes`, and a message that finds no room is lost. If
    `uplink_bytes` or `downlink_bytes` is not zero, a message counts as that size instead of its
    real one. During an `outage`, in the link's own time, no message passes: a message sent then
    waits for its end.
    """

    network: str = setting(
        "factory/001",
        help="a shipped profile (factory/003), a .npz or .csv file, constant:ROUND_TRIP "
        "(constant:30ms), constant:UP/DOWN, generated:factory/SEED; any of them after capacity: "
        "to replay its capacity; or direct, without a shim",
        flag="--network",
    )
    loss: float = setting(
        0.0,
        help="probability of losing a message, each way",
        at_least=0.0,
        below=1.0,
        flag="--loss",
    )
    keep_order: bool = setting(
        True, help="messages arrive in the order of sending, as in a radio's link layer"
    )
    outage: tuple[str, ...] = setting(
        (),
        help="duration and start of an outage; cut@4s: for ever",
        flag="--outage",
        metavar="389ms@1.2s",
    )
    start: str = setting(
        "",
        help="start of the run in the profile; empty: the seed draws it",
        flag="--network-start",
        metavar="12.5s",
    )
    uplink_bytes: int = setting(0, help="size of a state, 0: its real size", at_least=0)
    downlink_bytes: int = setting(0, help="size of an answer, 0: its real size", at_least=0)
    queue_bytes: int = setting(20 * 2**20, help="size of a direction's queue", at_least=1)

    @cached_property
    def start_ns(self) -> int | None:
        """`start` [ns]; None if it is empty."""
        return parse_duration_ns(self.start) if self.start else None

    @cached_property
    def outages(self) -> tuple[Outage, ...]:
        """The outages that `outage` describes."""
        return tuple(parse_outage(text) for text in self.outage)


@dataclass(frozen=True)
class WireConfig:
    """The format of messages."""

    projector_dtype: str = setting(
        "float64", help="type of a projector's numbers", choices=("float32", "float64")
    )
