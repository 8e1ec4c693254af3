"""What services publish while they run, and who listens to a publisher: events to wait for."""

from __future__ import annotations

import numpy as np

from shared.bus.base import Delivery
from shared.bus.zenoh_bus import ZenohBus, ZenohPublisher
from shared.robots import load_robot
from shared.telemetry.row_log import decode_rows
from shared.telemetry.schema import tick_schema
from shared.wire.channels import TICKS_KEY


class TelemetryHub:
    """The `--telemetry` of one robot: its newest block of rows."""

    def __init__(self, endpoint: str, *, robot: str = "romeo") -> None:
        self.endpoint = endpoint
        self._newest: dict[str, np.ndarray] = {}
        model = load_robot(robot).model
        self._schema = tick_schema(nq=model.nq, nv=model.nv)
        self._bus = ZenohBus(listen=[endpoint], mode="router")
        self._bus.subscribe(TICKS_KEY.format(robot=robot), self._take)

    def _take(self, delivery: Delivery) -> None:
        schema, rows = decode_rows(delivery.data, self._schema)
        self._newest = {name: schema.column(rows, name) for name in schema.slices}

    def newest(self, name: str) -> np.ndarray:
        """A column of the newest block; nothing before the first one."""
        return self._newest.get(name, np.zeros(0))

    def last(self, name: str) -> float:
        """The newest value of a column; −1 before the first one."""
        return float(self.newest(name)[-1:].sum()) if self._newest else -1.0

    def close(self) -> None:
        self._bus.close()


def is_heard(publisher: ZenohPublisher) -> bool:
    """Whether a subscriber is known at this end: what is sent from now on gets on its way."""
    status = publisher._publisher.matching_status
    return bool(status.matching)  # type: ignore[attr-defined]  # a bool in Zenoh's types, but not there
