"""Processor time of a message: states sent and projectors received at 1 kHz, by bus or bare Zenoh.

The other end is a process (`benchmarks.link_end`). The time to send is the time of the caller. The
time to receive is that of Zenoh's thread from one callback to the next, the callback included.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import numpy as np
import zenoh

from benchmarks.link_paths import direct, started
from shared.bus.base import Delivery, Envelope, Inbox
from shared.bus.zenoh_bus import ZenohBus
from shared.clock import Ticker, sleep_until
from shared.config.robot_settings import RobotConfig
from shared.wire.channels import DOWNLINK, UPLINK

MESSAGES = 2000
STATE_BYTES, PROJECTOR_BYTES = 720, 28_300
_WARM_UP = 100
_PERIOD_NS = 1_000_000
_UP, _DOWN = (channel.key_for(RobotConfig().name) for channel in (UPLINK, DOWNLINK))

# A connection to an endpoint: sends a message; notes the thread's time at each arrival.
Connect = Callable[[str, list[int]], AbstractContextManager[Callable[[bytes], object]]]


def lines(connect: Connect) -> list[list[str]]:
    """Rows of a table: the processor time to send and to receive."""
    sent, received = measure(connect)
    table = [["", "p50 [µs]", "p99 [µs]"]]
    for name, durations in (
        (f"send {STATE_BYTES} B", sent),
        (f"receive {PROJECTOR_BYTES} B", received),
    ):
        p50, p99 = np.percentile(durations, [50, 99]) * 1e-3
        table.append([name, f"{p50:.1f}", f"{p99:.1f}"])
    return table


def measure(connect: Connect) -> tuple[np.ndarray, np.ndarray]:
    """Processor time of each message sent and received [ns]."""
    arrivals: list[int] = []
    sent = np.empty(MESSAGES + _WARM_UP)
    message = bytes(STATE_BYTES)
    with tempfile.TemporaryDirectory(prefix="benchmark-") as name, direct() as path:
        out = str(Path(name) / "arrivals.npy")
        far = ("benchmarks.link_end", "far", "--endpoint", path.listen, "--out", out)
        with (
            started(*far, "--bytes", str(PROJECTOR_BYTES)),
            connect(path.dial, arrivals) as send,
        ):
            while len(arrivals) < _WARM_UP:
                time.sleep(0.01)
            arrivals.clear()
            # Not during a send, which is the same thread's work.
            while len(arrivals) < MESSAGES:
                time.sleep(0.01)
            received = np.diff(arrivals[:MESSAGES])
            ticker = Ticker(start_ns=time.monotonic_ns(), period_ns=_PERIOD_NS)
            for k in range(len(sent)):
                sleep_until(ticker.due_ns)
                began = time.thread_time_ns()
                send(message)
                sent[k] = time.thread_time_ns() - began
                ticker.next(time.monotonic_ns())
    return sent[_WARM_UP:], received


@contextmanager
def ours(endpoint: str, arrivals: list[int]) -> Iterator[Callable[[bytes], object]]:
    """Send by the bus of a run, into an inbox."""
    inbox = Inbox()

    def receive(delivery: Delivery) -> None:
        inbox.put(delivery)
        arrivals.append(time.thread_time_ns())

    bus = ZenohBus(connect=[endpoint], largest=UPLINK.max_bytes)
    try:
        bus.subscribe(_DOWN, receive)
        yield bus.publisher(_UP).publish
    finally:
        bus.close()


@contextmanager
def bare(endpoint: str, arrivals: list[int]) -> Iterator[Callable[[bytes], object]]:
    """Send by Zenoh alone: a put of the same bytes, and a callback that does not read them."""
    config = zenoh.Config()
    config.insert_json5("connect/endpoints", f'["{endpoint}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    envelope = Envelope(session=0, sequence=0, sent_ns=0, clock=0).encode()
    with zenoh.open(config) as session:

        def receive(sample: zenoh.Sample) -> None:
            arrivals.append(time.thread_time_ns())

        direct_call = zenoh.handlers.Callback(receive, indirect=False)
        subscriber = session.declare_subscriber(_DOWN, direct_call)
        publisher = session.declare_publisher(_UP, express=True)
        yield lambda data: publisher.put(data, attachment=envelope)
        subscriber.undeclare()
