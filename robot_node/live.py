"""The robot against the wall clock: the two phases of the tick on an absolute 1 kHz schedule.

Nothing in the loop prints, writes or waits for another thread: rows go to a background thread.
`Narrator` looks at the loop ten times a second and reports its events.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from robot_node.node import RobotNode
from robot_node.pace import Pace
from robot_node.tick import Tick
from shared.bus.base import Delivery, Inbox, Publisher
from shared.clock import Ticker
from shared.config.link_settings import LoopConfig
from shared.errors import LinkError
from shared.output.no_start import refused_in_words, too_old
from shared.process.realtime import RealtimeBudget
from shared.telemetry.row_log import RowLog
from shared.telemetry.schema import Source

# An answer older than this is reported: no healthy link is that slow.
STALE_NS = 250_000_000
# The wait for the tick that carries a command out.
_BETWEEN_SECONDS = 2.0
# The time between two looks for a command while simulated time stands still.
_STANDING_SECONDS = 2e-3
# The narrator's words for a base's estimate that has moved without the robot.
_MOVED = {
    "jumps": "the base's estimate has jumped: the robot goes on where it was",
    "drifts": "the base's estimate drifts: the plan stays with the feet",
}
# An overtaken message is refused as a matter of course.
_OVERTAKEN = "stale"


@dataclass
class Progress:
    """State of the loop for other threads, overwritten every tick.

    `silence_ns` is the age of the state that the edge has answered last. `walk_ended`: a joint hold
    has ended the walk. The next tick is due at `due_ns` of the robot's clock.
    """

    time_ns: int = 0
    source: Source = Source.HELD
    silence_ns: int = -1
    running: bool = False
    walk_ended: bool = False
    due_ns: int = 0


class _Between:
    """An action between two ticks, not before `at_ns`, and the task time at which it was done."""

    def __init__(self, action: Callable[[], None], at_ns: int) -> None:
        self.action = action
        self.at_ns = at_ns
        self.time_ns = 0
        self.error: Exception | None = None
        self.done = threading.Event()


class LiveLoop:
    """Runs a robot node in real time.

    By Eq. (7) the robot waits d* for the answer to this tick's state. If the last answer took
    longer than d*, the robot does not wait, and commands at once. `explain` describes the endpoint
    if no answer comes. `steps` gets the rows of footprints. With `stays`, a fall does not end the
    loop: simulated time stands still until a reset.
    """

    def __init__(
        self,
        node: RobotNode,
        config: LoopConfig,
        *,
        uplink: Publisher,
        inbox: Inbox,
        log: RowLog,
        explain: Callable[[], str],
        steps: RowLog | None = None,
        stays: bool = False,
    ) -> None:
        self.progress = Progress()
        self.wall_seconds = 0.0
        self.pace = Pace()
        self._node = node
        self._config = config
        self._uplink = uplink
        self._inbox = inbox
        self._plans = Inbox()
        self._log = log
        self._tick = Tick(node, log.row, steps)
        self._explain = explain
        self._stays = stays
        self._between: list[_Between] = []
        self._clock = self.pace.clock
        self._arrived_ns = 0
        self._round_trip_ns = 0

    @property
    def refused(self) -> dict[str, int]:
        """Messages refused so far, by reason."""
        return dict(self._node.refused)

    @property
    def answering(self) -> list[str]:
        """The edges of which an answer was taken."""
        by_sender = self._node.answers.by_sender
        return [name for name, counts in by_sender.items() if counts["taken"]]

    @property
    def fallen(self) -> bool:
        """Return whether the robot has fallen, and simulated time stands still."""
        return self._node.fallen and self._stays

    @property
    def sensor_faults(self) -> dict[str, int]:
        """Samples held over so far, by the sensor."""
        return dict(self._node.sensor_guard.faults)

    @property
    def base_estimate(self) -> dict[str, int]:
        """Jumps and drifts of the base's estimate so far."""
        return self._node.base_estimate

    def receive(self, delivery: Delivery) -> None:
        """Take in a message from the edge; called on the bus's thread."""
        self._arrived_ns = self._clock.now_ns()
        self._inbox.put(delivery)

    def between_ticks(self, action: Callable[[], None], *, at_ns: int = 0) -> int:
        """Do an action between two ticks. Return the task time of the tick that follows [ns].

        Call this from another thread. With `at_ns` the tick of that task time follows, or the next
        one if the time has passed. Raise `LinkError` if no tick comes.
        """
        waiting = _Between(action, at_ns)
        self._between.append(waiting)
        # Simulated time may stand still for long before a time of the task.
        if not waiting.done.wait(_BETWEEN_SECONDS if at_ns <= self.progress.time_ns else None):
            with contextlib.suppress(ValueError):
                self._between.remove(waiting)
            raise LinkError(f"expected a tick within {_BETWEEN_SECONDS:g} s, got none; try again")
        if waiting.error is not None:
            raise waiting.error
        return waiting.time_ns

    def receive_plan(self, delivery: Delivery) -> None:
        """Take in a message on the key of plans; called on the bus's thread."""
        self._plans.put(delivery)

    def run(self, *, duration_ns: int, stopping: Callable[[], bool]) -> None:
        """Run until the task has lasted `duration_ns`, the robot has fallen, or `stopping()` is
        true.

        Raise `LinkError` if no projector arrives within the connect timeout.
        """
        node, clock, config = self._node, self._clock, self._config
        begun_ns = clock.now_ns()
        ticker = Ticker(start_ns=begun_ns, period_ns=config.period_ns)
        task_began_ns = begun_ns
        budget = RealtimeBudget()
        while node.time_ns < duration_ns and not stopping():
            if node.fallen:
                if not self._stays:
                    break
                self.pace.stand_still()
            budget.keep(time.monotonic_ns())
            clock.sleep_until(ticker.due_ns)
            if self._between:
                self._carry_out_due()
            if self.pace.left is not None:
                self._stand_still(stopping)
            now_ns = clock.now_ns()
            late_ns = now_ns - ticker.due_ns
            state = self._tick.begin(now_ns)
            sensed_ns = clock.now_ns()
            self._uplink.publish(state)
            sending_ns = clock.now_ns() - sensed_ns

            if (
                node.controller.every_state_answered
                and self._round_trip_ns < config.fresh_within_ns
            ):
                clock.sleep_until(ticker.due_ns + config.fresh_within_ns)
            was_running = node.running
            command, answered = self._tick.end(
                clock.now_ns(),
                self._inbox.take(),
                late_ns=late_ns,
                overruns=ticker.overruns,
                sending_ns=sending_ns,
                plans=self._plans.take(),
            )
            if answered:
                self._round_trip_ns = self._arrived_ns - node.cache.newest_stamp_ns

            now_ns = clock.now_ns()
            if not node.running:
                self._check_timeout(now_ns - begun_ns)
            elif not was_running:
                # Overruns during the wait do not count; the count begins with the task.
                task_began_ns, ticker.overruns = ticker.due_ns, 0
            ticker.next(now_ns)
            silence_ns = now_ns - node.cache.newest_stamp_ns
            self.progress = Progress(
                node.time_ns,
                command.source,
                silence_ns,
                node.running,
                node.walk_ended,
                ticker.due_ns,
            )
        self.wall_seconds = (clock.now_ns() - task_began_ns) * 1e-9

    def _carry_out_due(self) -> None:
        for waiting in tuple(self._between):
            if waiting.at_ns <= self._node.time_ns:
                self._carry_out(waiting)

    def _carry_out(self, waiting: _Between) -> None:
        """Do the action of `between_ticks`. A reset after a fall lets simulated time go on."""
        had_fallen = self._node.fallen
        try:
            waiting.action()
        except Exception as error:  # the tick never raises
            waiting.error = error
        if had_fallen and not self._node.fallen:
            self.pace.resume()
        waiting.time_ns = self._node.time_ns
        with contextlib.suppress(ValueError):
            self._between.remove(waiting)
        waiting.done.set()

    def _stand_still(self, stopping: Callable[[], bool]) -> None:
        """Wait while simulated time stands still. Count the ticks until it does."""
        pace = self.pace
        if pace.left == 0:
            pace.stand_still()
            # The last rows before a pause or a fall should be seen now, not after it.
            self._log.hand_over()
            while pace.left == 0 and not stopping():
                time.sleep(_STANDING_SECONDS)
                if self._between:
                    self._carry_out_due()
        if pace.left:
            pace.left -= 1

    def _check_timeout(self, waited_ns: int) -> None:
        if waited_ns <= self._config.connect_timeout * 1e9:
            return
        youngest_ns = self._node.youngest_answer_ns
        if youngest_ns is not None:
            reason = too_old(self._config, youngest_ns * 1e-6)
        elif refused := refused_in_words(self.refused):
            reason = f"the robot refused {refused}"
        else:
            reason = self._explain()
        raise LinkError(
            f"no usable answer from the edge within {self._config.connect_timeout:g} s: {reason}"
        )


class Narrator:
    """Reports the events of the robot, from a separate thread, which calls `each_look` too."""

    _PERIOD_SECONDS = 0.1

    def __init__(
        self,
        loop: LiveLoop,
        say: Callable[[str], None],
        *,
        each_look: Callable[[], None] = lambda: None,
    ) -> None:
        self._loop = loop
        self._say = say
        self._each_look = each_look
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="narrator", daemon=True)

    def __enter__(self) -> Narrator:
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._done.set()
        self._thread.join(timeout=1.0)

    def _watch(self) -> None:
        running, stale_since, holding, stopping, ended = False, 0.0, False, False, False
        fallen = False
        reported = {_OVERTAKEN}
        faulty: set[str] = set()
        moved: set[str] = set()
        answering = 1
        while not self._done.wait(self._PERIOD_SECONDS):
            progress = self._loop.progress
            self._each_look()
            if not progress.running:
                continue
            if not running:
                running = True
                self._say("first answer received: the task begins")
            at = f"{progress.time_ns * 1e-9:.2f} s"
            if self._loop.fallen and not fallen:
                self._say(f"{at}: the robot has fallen; `reset` puts it on its feet, Ctrl-C ends")
            fallen = self._loop.fallen
            if progress.silence_ns > STALE_NS and not stale_since:
                stale_since = time.monotonic()
                self._say(
                    f"{at}: no answer for {progress.silence_ns * 1e-6:.0f} ms, link stalled or "
                    "edge lost; going on with the cache"
                )
            elif progress.silence_ns <= STALE_NS and stale_since:
                self._say(f"{at}: new answers again after {time.monotonic() - stale_since:.2f} s")
                stale_since = 0.0
            if (progress.source is Source.HELD) != holding:
                holding = not holding
                self._say(f"{at}: {'holding the joints' if holding else 'joints released'}")
            if progress.walk_ended and not ended:
                ended = True
                self._say(f"{at}: the joint hold has ended the walk: standing where the feet are")
            if progress.source is Source.STOPPING and not stopping:
                stopping = True
                self._say(f"{at}: corrections are doubtful: ending the walk")
            if len(edges := self._loop.answering) > answering:
                answering = len(edges)
                self._say(f"{at}: answers come from {answering} edges: {', '.join(edges)}")
            for sensor in self._loop.sensor_faults.keys() - faulty:
                faulty.add(sensor)
                self._say(
                    f"{at}: implausible measurement of {sensor}: held over; counted in the report "
                    "at the end"
                )
            for kind, count in self._loop.base_estimate.items():
                if count and kind not in moved:
                    moved.add(kind)
                    self._say(f"{at}: {_MOVED[kind]}; counted in the report at the end")
            for reason in self._loop.refused.keys() - reported:
                reported.add(reason)
                self._say(
                    f"{at}: refuses messages on its key ({reason}): see docs/wire.md; counted in "
                    "the report at the end"
                )
