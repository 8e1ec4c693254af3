"""The pace of simulated time: real time, slower, standing still, or some ticks at a time.

An operator sets it. The robot's clock and the link's delays follow; the edge computes as before.
"""

from __future__ import annotations

from collections.abc import Callable

from shared.clock import ScaledClock
from shared.wire.operator.commands import Pause, Resume, RobotCommand, Speed, Step


class Pace:
    """The clock of simulated time. `left` ticks remain until it stands still; None: it goes on."""

    def __init__(self) -> None:
        self.clock = ScaledClock()
        self.left: int | None = None
        self._speed = 1.0

    def prepare(self, command: RobotCommand) -> Callable[[], None] | None:
        """Return a function that carries a command out; None if it does not concern the pace."""
        if isinstance(command, Pause):
            return lambda: self._go_on(left=0)
        if isinstance(command, Step):
            return lambda: self._go_on(left=command.ticks)
        if isinstance(command, Speed):
            return lambda: self._set_speed(command.factor)
        return self.resume if isinstance(command, Resume) else None

    def resume(self) -> None:
        """Go on without an end, at the speed that was set last."""
        self._go_on(left=None)

    def stand_still(self) -> None:
        """Stop the clock, and let no tick follow."""
        self._go_on(left=0)

    def _go_on(self, *, left: int | None) -> None:
        self.left = left
        speed = 0.0 if left == 0 else self._speed
        if self.clock.speed != speed:
            self.clock.run_at(speed)

    def _set_speed(self, speed: float) -> None:
        self._speed = speed
        self._go_on(left=self.left)
