"""Both ends of an operator's commands on the telemetry session: the client and the servers.

The robot, the shim and the edge each serve the commands that they carry out. A command has one
answer. A server takes a few commands at once and then four a second, off the robot's tick. More
would delay more than one tick in a hundred, so the server drops the rest of a flood. The times of a
script are known before the start. A script therefore needs no message: each process carries out
those of its commands that concern it.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable, Sequence

from shared.bus.base import Delivery
from shared.bus.memory import MemoryBus
from shared.bus.zenoh_bus import ZenohBus
from shared.clock import ScaledClock
from shared.errors import LinkError, MessageRefused, UserError
from shared.wire.operator.commands import Accepted, Command, EdgeCommand, LinkCommand
from shared.wire.operator.events import CommandEvent
from shared.wire.operator.messages import (
    CLOCK_KEY,
    EDGE_COMMANDS_KEY,
    EVENTS_KEY,
    LINK_COMMANDS_KEY,
    ROBOT_COMMANDS_KEY,
    decode_answer,
    decode_command,
    encode_answer,
    encode_command,
    encode_event,
)
from shared.wire.robot_clock import ClockReading, decode_clock

_AT_ONCE, _A_SECOND = 8.0, 4.0
_ANSWER_SECONDS = 5.0
# The first reading of the clock comes up to this time after the beginning of the task.
_MISSED_NS = 1_000_000_000


class CommandClient:
    """Sends commands to the stack of a telemetry hub, over a session that `bus` has with it."""

    def __init__(self, bus: ZenohBus) -> None:
        self._bus = bus

    def send(self, command: Command) -> Accepted:
        """Send a command and wait until it takes effect.

        Raise `LinkError` with the reason if it is refused, or if no process answers.
        """
        key, who = ROBOT_COMMANDS_KEY, "robot"
        if isinstance(command, LinkCommand):
            key, who = LINK_COMMANDS_KEY, "shim, which --network direct leaves out"
        elif isinstance(command, EdgeCommand):
            key, who = EDGE_COMMANDS_KEY, "edge on this machine"
        data = self._bus.ask(key, encode_command(command), within=_ANSWER_SECONDS)
        if data is None:
            raise LinkError(
                f"{command}: expected an answer, got none: the stack has no {who}, or it gets too "
                "many commands at once; try again"
            )
        answer = decode_answer(data)
        if isinstance(answer, str):
            raise LinkError(answer)
        return answer


def play_script(
    script: Sequence[CommandEvent],
    carry_out: Callable[[CommandEvent], object],
    say: Callable[[str], None],
) -> None:
    """Carry out the events of a script in turn, on another thread.

    `carry_out(event)` waits until the event is due. `say` prints a line for an event that it
    refuses.
    """

    def play() -> None:
        for event in script:
            try:
                carry_out(event)
            except UserError as error:
                say(str(error))

    threading.Thread(target=play, name="script", daemon=True).start()


class RobotTimes:
    """Answers and publishes the commands of a process beside the robot, by the robot's clock.

    `say` prints a line for each. `on_clock` gets each reading of the clock. `clock` is the robot's:
    it runs slower, or stands still, when the robot's does.
    """

    def __init__(
        self,
        hub: ZenohBus | MemoryBus,
        say: Callable[[str], None],
        on_clock: Callable[[ClockReading], None] = lambda reading: None,
    ) -> None:
        self._say = say
        self._on_clock = on_clock
        self.clock = ScaledClock()
        self._read = threading.Condition()
        self._reading: ClockReading | None = None
        # The time of the task at the first reading.
        self._begun_ns = 0
        self._events = hub.publisher(EVENTS_KEY)
        hub.subscribe(CLOCK_KEY, self._take)

    def carried_out(
        self, command: Command, now_ns: int | None = None, *, tell: bool = True
    ) -> Accepted:
        """Publish a command that holds from `now_ns` of the robot's clock on, or from now on.

        Without `tell`, no line is printed.
        """
        if now_ns is None:
            now_ns = self.clock.now_ns()
        event = CommandEvent(
            0 if self._reading is None else self._reading.tick_from(now_ns), command
        )
        self._events.publish(encode_event(event, wall_ns=now_ns))
        if tell:
            self._say(f"{event.time_ns * 1e-9:.3f} s: operator: {command}")
        return Accepted(event.time_ns)

    def play(
        self, script: Sequence[CommandEvent], carry_out: Callable[[Command], Accepted]
    ) -> None:
        """Carry out the commands of a script at their times of the task, on another thread.

        A process that starts again leaves out the commands that it has carried out before.
        """

        def carry_out_due(event: CommandEvent) -> None:
            with self._read:
                self._read.wait_for(lambda: self._reading is not None)
                if event.time_ns < self._begun_ns - _MISSED_NS:
                    return
                while (wait_ns := self._wait_ns(event.time_ns)) > 0:
                    # Until then, or until the next reading of the clock.
                    self._read.wait(None if math.isinf(wait_ns) else wait_ns * 1e-9)
            carry_out(event.command)

        play_script(script, carry_out_due, self._say)

    def _wait_ns(self, time_ns: int) -> float:
        """Return the real time until a time of the task [ns]; infinite while the task is paused."""
        reading, speed = self._reading, self.clock.speed
        assert reading is not None
        left_ns = time_ns - reading.task_ns - (self.clock.now_ns() - reading.now_ns)
        if left_ns <= 0:
            return 0.0
        return left_ns / speed if speed > 0.0 else math.inf

    def _take(self, delivery: Delivery) -> None:
        with contextlib.suppress(MessageRefused):
            reading = decode_clock(delivery.data)
            with self._read:
                if self._reading is None:
                    self._begun_ns = reading.task_ns
                self.clock.origin, self._reading = reading.origin, reading
                self._read.notify_all()
            self._on_clock(reading)


class CommandServer:
    """Answers the commands on a key, one after another, on a thread.

    `carry_out(command)` returns when the command has taken effect. It raises `UserError` for a
    command that it refuses.
    """

    def __init__(self, bus: ZenohBus, key: str, carry_out: Callable[[Command], Accepted]) -> None:
        self._requests = bus.serve(key)
        self._carry_out = carry_out
        threading.Thread(target=self._serve, name="commands", daemon=True).start()

    def _serve(self) -> None:
        left, before = _AT_ONCE, time.monotonic()
        while self._requests.answer(self._answer):
            now = time.monotonic()
            left = min(_AT_ONCE, left + (now - before) * _A_SECOND) - 1.0
            before = now
            if left < 0.0:
                time.sleep(-left / _A_SECOND)

    def _answer(self, data: bytes) -> bytes:
        try:
            return encode_answer(self._carry_out(decode_command(data)))
        except UserError as error:
            return encode_answer(str(error))
        except Exception as error:  # no command may end the thread
            return encode_answer(f"an unexpected error: {type(error).__name__}: {error}")
