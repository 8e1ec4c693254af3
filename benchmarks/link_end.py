"""One end of a link under test, as a process: sends at 1 kHz and notes each arrival with its time.

`python -m benchmarks.link_end near …` takes the robot's place, `far` the edge's, each at its
priority. Stamps are the machine's monotonic clock, the same at both ends. With `--answer` the far
end sends only answers, each to the newest message, as the edge does. An answer begins with the time
at which that message was sent. The process prints READY, then FIRST at the first arrival. SIGTERM
ends the sending; the process then waits for the messages still on their way.
"""

from __future__ import annotations

from remote_wbc import begin

begin(__name__)

import struct
import time
from pathlib import Path

import numpy as np

from shared.bus.base import Delivery, Inbox, Publisher
from shared.bus.zenoh_bus import ZenohBus
from shared.clock import Ticker, sleep_until
from shared.commands import python_module
from shared.config.robot_settings import RobotConfig
from shared.process.cli import EXIT_STANDING, Parser, run
from shared.process.realtime import prepare, suspend_garbage_collection
from shared.process.service import StopSignal
from shared.wire.channels import DOWNLINK, UPLINK

_PERIOD_NS = 1_000_000
_POLL_NS = 50_000_000
# No profile that is measured holds a message longer than this.
_DRAIN_SECONDS = 1.0
# The same as in robot_node and edge_node.
_PRIORITIES = {"near": 30, "far": 10}
_STAMP = struct.Struct("<q")
# Columns of the written table.
SEQUENCE, SENT, ARRIVED, ECHOED = range(4)


class Arrivals:
    """Every arrival as (sequence, sent_ns, arrived_ns, echoed_ns); 0 echoes nothing."""

    def __init__(self) -> None:
        self.inbox = Inbox()
        self.newest_sent_ns = 0
        self._reported = False
        self._rows: list[tuple[int, int, int, int]] = []

    def receive(self, delivery: Delivery) -> None:
        """Called on the bus's thread."""
        now_ns = time.monotonic_ns()
        envelope = delivery.envelope
        assert envelope is not None
        (echoed_ns,) = _STAMP.unpack_from(delivery.data)
        self.newest_sent_ns = envelope.sent_ns
        self._rows.append((envelope.sequence, envelope.sent_ns, now_ns, echoed_ns))
        self.inbox.put(delivery)

    def take(self) -> bool:
        """Return whether a message has arrived since the last call."""
        arrived = bool(self.inbox.take())
        if arrived and not self._reported:
            self._reported = True
            print("FIRST", flush=True)
        return arrived

    def table(self) -> np.ndarray:
        """Return the arrivals, shape (n, 4) int64, in the order of arrival."""
        return np.array(self._rows, dtype=np.int64).reshape(-1, 4)


def main() -> int:
    parser = Parser(prog=python_module("benchmarks.link_end"), description=__doc__)
    parser.add_argument("end", choices=sorted(_PRIORITIES))
    parser.add_argument("--endpoint", required=True, help="the near end dials it, the far listens")
    parser.add_argument("--bytes", type=int, required=True, help="of each message sent")
    parser.add_argument("--answer", action="store_true", help="answer instead of a fixed rate")
    parser.add_argument("--out", type=Path, required=True, help="arrivals, .npy")
    arguments = parser.parse_args()
    near, robot = arguments.end == "near", RobotConfig().name
    stop = StopSignal()
    scheduling = prepare(priority=_PRIORITIES[arguments.end])
    endpoint = [arguments.endpoint]
    bus = ZenohBus(connect=endpoint) if near else ZenohBus(listen=endpoint)
    arrivals = Arrivals()
    outgoing, incoming = (UPLINK, DOWNLINK) if near else (DOWNLINK, UPLINK)
    publisher = bus.publisher(outgoing.key_for(robot))
    bus.subscribe(incoming.key_for(robot), arrivals.receive)
    suspend_garbage_collection()
    print(f"READY {scheduling}", flush=True)
    send = _answer if arguments.answer else _send
    send(publisher, arrivals, stop, n_bytes=arguments.bytes)
    time.sleep(_DRAIN_SECONDS)
    bus.close()
    np.save(arguments.out, arrivals.table())
    return EXIT_STANDING


def _send(publisher: Publisher, arrivals: Arrivals, stop: StopSignal, *, n_bytes: int) -> None:
    """Send one message per period until stopped."""
    message = bytes(n_bytes)
    ticker = Ticker(start_ns=time.monotonic_ns(), period_ns=_PERIOD_NS)
    while not stop.requested:
        sleep_until(ticker.due_ns)
        publisher.publish(message)
        arrivals.take()
        ticker.next(time.monotonic_ns())


def _answer(publisher: Publisher, arrivals: Arrivals, stop: StopSignal, *, n_bytes: int) -> None:
    """Answer the newest message when one has arrived, until stopped."""
    rest = bytes(n_bytes - _STAMP.size)
    while not stop.requested:
        arrivals.inbox.wait(_POLL_NS)
        if arrivals.take():
            publisher.publish(_STAMP.pack(arrivals.newest_sent_ns) + rest)


if __name__ == "__main__":
    run(main)
