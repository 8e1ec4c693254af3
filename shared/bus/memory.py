"""A bus inside one process: a message is delivered within the call that publishes it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable

from shared.bus.base import Delivery, Envelope
from shared.clock import Clock


class MemoryBus:
    """Delivers encoded bytes synchronously; time comes from the given clock."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._receivers: dict[str, list[Callable[[Delivery], None]]] = defaultdict(list)
        self._publishers = 0

    def publisher(self, key: str) -> MemoryPublisher:
        self._publishers += 1
        return MemoryPublisher(self._receivers[key], self._clock, session=self._publishers)

    def subscribe(self, key: str, receive: Callable[[Delivery], None]) -> None:
        self._receivers[key].append(receive)

    def close(self) -> None:
        self._receivers.clear()


class MemoryPublisher:
    """Publisher of a `MemoryBus`."""

    def __init__(
        self, receivers: list[Callable[[Delivery], None]], clock: Clock, *, session: int
    ) -> None:
        self._receivers = receivers
        self._clock = clock
        self._session = session
        self.sent = 0

    def publish(self, data: bytes) -> None:
        envelope = Envelope(self._session, self.sent, self._clock.now_ns(), clock=0)
        self.forward(Delivery(data, envelope))

    def forward(self, delivery: Delivery) -> None:
        self.sent += 1
        for receive in self._receivers:
            receive(delivery)
