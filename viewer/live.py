"""Show a live run: telemetry blocks from the bus go to a screen, into a file, or both.

The loop draws the blocks that have arrived, and waits for more until it is stopped. Blocks that
cannot be drawn are counted and skipped. If blocks come too fast, the queue drops the oldest.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import rerun as rr

from shared.config.settings import RunConfig
from shared.robots import Robot, load_robot
from shared.telemetry.row_log import decode_rows
from shared.telemetry.schema import LINK_SCHEMA, SOLVE_SCHEMA, STEP_SCHEMA, Schema, tick_schema
from shared.wire.operator.messages import VIEW_KEY
from viewer.blueprint import layout
from viewer.display import Display
from viewer.intake import NICENESS, BlockQueue, connect, subscribe
from viewer.meshes import load_meshes
from viewer.recording import new_recording
from viewer.scene import Scene
from viewer.title import log_title, title

# The period of the robot's blocks [s].
DRAW_PERIOD = 0.1
# Rows of the link may come this much later than the robot's rows of the same time.
PATIENCE_NS = 500_000_000


def watch(
    config: RunConfig,
    *,
    telemetry: str,
    view: str,
    out: Path | None,
    stopped: Callable[[], bool],
    say: Callable[[str], None],
) -> None:
    """Show a run until `stopped`; `UserError` if the hub or the display cannot be opened.

    Print a line that starts with READY when blocks are received, and a line at the end.
    """
    os.nice(NICENESS)
    robot = load_robot(config.robot.name)
    meshes = load_meshes(robot)
    blocks = BlockQueue()
    recording = new_recording(f"{robot.name}, live")
    file = out / "recording.rrd" if out is not None else None
    # Before the bus: its threads must not be forked into the display's child process.
    display = Display(
        recording, view, blueprint=layout(config, duration=None), file=file, newest_first=True
    )
    bus = None
    scene = Scene(recording, robot, config, meshes=meshes)
    drawn = _Drawn(recording, scene, robot, config, say)
    try:
        bus = connect(telemetry, stopped=stopped)
        if bus is None:
            return
        subscribe(bus, blocks, robot=robot.name)
        say(f"READY {display.state}")
        if display.address:
            say(display.address)
        shown = view != "record"
        seen, waits = bus.publisher(VIEW_KEY), shown
        while not stopped():
            time.sleep(DRAW_PERIOD)
            drawn.add(blocks.take())
            if waits and display.seen:
                seen.publish(b"")
                waits = False
            if shown and not display.shown and not stopped():
                shown = False
                say("the view was closed" + ("; still recording" if file else ""))
                if file is None:
                    break
        drawn.add(blocks.take())
    finally:
        # The recording first.
        display.close()
        if bus is not None:
            bus.close()
    say(
        f"{drawn.rows} rows drawn, {drawn.missing} ticks missing, "
        f"{blocks.dropped} blocks dropped when behind, {drawn.refused} blocks refused"
    )


class _Drawn:
    """The scene, and counts of the rows drawn, the blocks refused and the ticks missing."""

    def __init__(
        self,
        recording: rr.RecordingStream,
        scene: Scene,
        robot: Robot,
        config: RunConfig,
        say: Callable[[str], None],
    ) -> None:
        ticks = tick_schema(nq=robot.model.nq, nv=robot.model.nv)
        self._schemas = (ticks, LINK_SCHEMA, SOLVE_SCHEMA, STEP_SCHEMA)
        self.rows = 0
        self.refused = 0
        self.missing = 0
        self._next_tick: int | None = None
        self._recording = recording
        self._scene = scene
        self._config = config
        self._say = say
        self._verdict = ""

    def add(self, blocks: list[bytes]) -> None:
        for block in blocks:
            # After any error in a block, the view goes on with the next one.
            try:
                schema, rows = decode_rows(block, *self._schemas)
                self._scene.log_rows(schema, rows)
                self._count(schema, rows)
            except Exception as error:
                if not self.refused:
                    self._say(f"a block cannot be drawn: {error}")
                self.refused += 1
        self._scene.look_for_silence(patience_ns=PATIENCE_NS)
        if self._scene.verdict != self._verdict:
            self._verdict = self._scene.verdict
            log_title(self._recording, title(self._config, self._verdict))

    def _count(self, schema: Schema, rows: np.ndarray) -> None:
        """Count rows and missing ticks. A gap is a block lost or dropped by the queue."""
        self.rows += len(rows)
        if "tick" in schema.slices and len(rows):
            ticks = schema.column(rows, "tick").astype(int)
            if self._next_tick is not None:
                self.missing += max(0, int(ticks[0]) - self._next_tick)
            self._next_tick = int(ticks[-1]) + 1
