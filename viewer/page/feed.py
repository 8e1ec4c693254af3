"""The state of a run for the page, from telemetry blocks. It is always the whole state.

A browser that is slow or late therefore needs only the newest state. The state has poses of the
last block of ticks, which the page plays one after the other, and the last seconds of the link.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np

from shared.config.settings import RunConfig
from shared.errors import MessageRefused
from shared.robots import Robot
from shared.telemetry.row_log import decode_rows
from shared.telemetry.schema import (
    LINK_SCHEMA,
    SOLVE_SCHEMA,
    STEP_SCHEMA,
    Schema,
    Source,
    tick_schema,
)
from shared.wbc.contacts import ContactMode
from shared.wire.operator.commands import Command, Drive
from shared.wire.operator.messages import decode_event
from viewer.footholds import Footholds
from viewer.page.strip import Strip
from viewer.pose import PoseModel
from viewer.verdict import Verdict

# Poses this far apart are smooth enough, as the page interpolates [ns].
POSE_NS = 25_000_000
# A push stays in the picture for this time at least, also in a slow browser [ns].
PUSH_NS = 500_000_000
_DIGITS = 4
_MAX_EVENTS = 6


class Feed:
    """Takes in blocks of rows; `state` is the newest state. `refused` counts unusable blocks."""

    def __init__(self, robot: Robot, config: RunConfig, joints: Sequence[int]) -> None:
        self.refused = 0
        self._ticks = tick_schema(nq=robot.model.nq, nv=robot.model.nv)
        self._pose = PoseModel(robot, joints, friction=config.wbc.friction)
        self._verdict = Verdict(robot)
        self._strip = Strip()
        self._footholds = Footholds(robot)
        self._push, self._pushed_ns = np.zeros(3), 0
        self._events: deque[str] = deque(maxlen=_MAX_EVENTS)
        self._last: Command | None = None
        self._state: dict[str, Any] = {"verdict": self._verdict.text}

    def take_events(self, messages: Sequence[bytes]) -> bool:
        """Take in an operator's events; an event may come twice. Return whether any came."""
        for message in messages:
            try:
                event, _ = decode_event(message)
            except MessageRefused:
                self.refused += 1
            else:
                text = f"{event.time_ns * 1e-9:.2f} s: {event.command}"
                # A velocity is given again and again while a key is held.
                goes_on = isinstance(event.command, Drive) and event.command == self._last
                self._last = event.command
                if text not in self._events and not goes_on:
                    self._events.append(text)
        return bool(messages)

    @property
    def state(self) -> str:
        """The newest state as JSON.

        `clock` is the robot's clock [s]. A pose has its time `at` on it, and for each joint the
        position (3) [m] and the quaternion xyzw (4) in the world. `soles` are outlines on the
        ground by their kind: planned, chosen, landed.
        """
        soles = {
            kind.name.lower(): [np.round(each, _DIGITS).tolist() for each in outlines]
            for kind, outlines in self._footholds.soles.items()
        }
        return json.dumps(
            {
                **self._state,
                "soles": soles,
                "strip": self._strip.newest(),
                "events": list(self._events),
            },
            separators=(",", ":"),
        )

    def take(self, blocks: Sequence[bytes]) -> bool:
        """Take in blocks, in order. Return whether the state has changed."""
        changed = False
        for block in blocks:
            # After any error in a block, the page goes on with the next one.
            try:
                schema, rows = decode_rows(
                    block, self._ticks, LINK_SCHEMA, SOLVE_SCHEMA, STEP_SCHEMA
                )
                if len(rows):
                    self._take(schema, rows)
                    changed = True
            except Exception:
                self.refused += 1
        return changed

    def _take(self, schema: Schema, rows: np.ndarray) -> None:
        if schema is self._ticks:
            self._take_ticks(rows)
        elif schema is LINK_SCHEMA:
            self._strip.take_link(schema, rows)
        elif schema is STEP_SCHEMA:
            self._footholds.take(rows)

    def _take_ticks(self, rows: np.ndarray) -> None:
        schema = self._ticks
        running = rows[schema.column(rows, "time_ns") >= 0]
        self._verdict.take(schema, running)
        self._strip.take_ticks(schema, rows)
        last = {name: rows[-1, where] for name, where in schema.slices.items()}
        fallen, begun = self._verdict.fallen, len(running) > 0
        self._take_push(schema, rows)
        self._state = {
            "verdict": self._verdict.text,
            "fallen": fallen,
            "time": _rounded(max(0.0, last["time_ns"][0] * 1e-9)),
            "clock": _rounded(last["wall_ns"][0] * 1e-9),
            "source": "" if fallen or not begun else Source(int(last["source"][0])).label,
            "contact": "" if fallen else ContactMode(int(last["mode"][0])).label,
            "age_ms": _rounded(last["projector_age_ns"][0] * 1e-6) if begun else None,
            "com_error_cm": None if fallen else _rounded(100.0 * last["com_error_m"][0]),
            "com": [_rounded(each) for each in last["com"]],
            "push": [_rounded(each) for each in self._push],
            "poses": self._poses(rows),
        }

    def _take_push(self, schema: Schema, rows: np.ndarray) -> None:
        """Note the strongest push of the rows, and keep it for a while."""
        pushes = schema.column(rows, "push_n")
        sizes = np.abs(pushes).sum(axis=1)
        now_ns = int(schema.column(rows, "wall_ns")[-1])
        if sizes.max() > 0.0:
            self._push, self._pushed_ns = pushes[np.argmax(sizes)], now_ns
        elif now_ns - self._pushed_ns > PUSH_NS:
            self._push = np.zeros(3)

    def _poses(self, rows: np.ndarray) -> list[dict[str, Any]]:
        """Return a pose for each `POSE_NS`, and the last one."""
        wall_ns = self._ticks.column(rows, "wall_ns").astype(np.int64)
        q = self._ticks.column(rows, "q")
        usable = np.flatnonzero(np.isfinite(q).all(axis=1))
        span = wall_ns[usable] // POSE_NS
        chosen = usable[np.append(np.diff(span) != 0, True)] if len(usable) else usable
        poses = []
        for row in chosen.tolist():
            placed = self._pose.joints(q[row])
            joints = np.hstack([placed.translation, placed.quat_xyzw])
            flat = np.round(joints, _DIGITS).ravel().tolist()
            poses.append({"at": _rounded(wall_ns[row] * 1e-9), "joints": flat})
        return poses


def _rounded(value: float) -> float | None:
    """Return a number with few digits; None if it is not finite, as JSON has no such number."""
    return round(float(value), _DIGITS) if np.isfinite(value) else None
