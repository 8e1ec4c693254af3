"""Receive telemetry blocks from the bus into a queue of bounded size.

The viewer is a client of the telemetry hub and only listens. Blocks wait in a ring. If drawing
falls behind, the oldest blocks are dropped and counted.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable

from shared.bus.endpoint import parse_endpoint
from shared.bus.zenoh_bus import ZenohBus
from shared.errors import LinkError
from shared.wire.channels import LINK_KEY, SOLVES_KEY, STEPS_KEY, TICKS_KEY

# The view yields to the control loops on the same machine.
NICENESS = 10
# About six seconds of a run, at most about 30 MB.
QUEUE_BLOCKS = 256
# Length of an attempt to connect; a stop request is seen between two attempts.
ATTEMPT_MS = 500


class BlockQueue:
    """A ring of encoded blocks; `put` is called by the bus, the rest by the viewer's loop."""

    def __init__(self, limit: int = QUEUE_BLOCKS) -> None:
        self.dropped = 0
        self._blocks: deque[bytes] = deque()
        self._limit = limit
        self._lock = threading.Lock()

    def put(self, block: bytes) -> None:
        """Add a block; drop the oldest one if the ring is full."""
        with self._lock:
            if len(self._blocks) == self._limit:
                self._blocks.popleft()
                self.dropped += 1
            self._blocks.append(block)

    def take(self) -> list[bytes]:
        """Return all waiting blocks, oldest first."""
        with self._lock:
            taken = list(self._blocks)
            self._blocks.clear()
        return taken


def connect(endpoint: str, *, stopped: Callable[[], bool], timeout: float = 5.0) -> ZenohBus | None:
    """Return a client of the hub at `endpoint`; None if `stopped` while it tried.

    Raise `LinkError` if the endpoint is malformed or no hub answers within `timeout` [s].
    """
    parse_endpoint(endpoint, secured=False)
    settings = {"connect/timeout_ms": ATTEMPT_MS, "connect/exit_on_failure": True}
    deadline = time.monotonic() + timeout
    while not stopped():
        try:
            return ZenohBus(connect=[endpoint], mode="client", settings=settings)
        except LinkError:
            if time.monotonic() > deadline:
                raise LinkError(
                    f"telemetry: no hub answers at {endpoint}; start the run, and give the "
                    "endpoint of its telemetry hub"
                ) from None
    return None


def subscribe(bus: ZenohBus, blocks: BlockQueue, *, robot: str) -> None:
    """Feed `blocks` with the rows of a robot, the link and the edge, while `bus` is open."""
    for key in (TICKS_KEY, STEPS_KEY, LINK_KEY, SOLVES_KEY):
        bus.subscribe(key.format(robot=robot), lambda delivery: blocks.put(delivery.data))
