"""The robot's controller, which an operator can replace by another one between two ticks.

The new controller collects answers first. The present one goes on until the new one has its first
answer.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from robot_node.cache import AnswerCache
from robot_node.controllers import Controller, ControllerParts, MakeController
from robot_node.onboard import OnBoard
from robot_node.sent_states import SentStates
from shared.config.settings import RunConfig
from shared.wbc.limits import Limits
from shared.wbc.model import WholeBodyModel
from shared.wbc.stack import make_stacks


@dataclass(frozen=True)
class OtherController:
    """A controller that may replace the present one, with its settings."""

    config: RunConfig
    controller: Controller


class ControllerSlot:
    """The controller of the robot, and the one that waits for its first answer.

    `config` is that of the `controller`. `cache` takes the answers: that of the controller, or of
    the controller that waits.
    """

    def __init__(self, parts: ControllerParts, make_controller: MakeController) -> None:
        self.config = parts.config
        self.controller = make_controller(parts)
        self.cache = self.controller.cache
        self._parts = parts
        self._make_controller = make_controller
        self._waiting: OtherController | None = None
        # The time of the state that was answered last before a controller began to wait.
        self._before_ns = 0
        # Made for a command that has not been carried out.
        self._prepared: list[OtherController] = []
        self._retired: list[OnBoard] = []
        self._retired_qps = 0

    @property
    def next_config(self) -> RunConfig:
        """The settings of the controller that waits, or else of the present one."""
        return self.config if self._waiting is None else self._waiting.config

    @property
    def on_board_qps(self) -> int:
        """The QPs that have been begun on board, by all controllers so far."""
        on_board = self.controller.on_board
        return self._retired_qps + (0 if on_board is None else on_board.solves)

    def another(self, config: RunConfig, session: int) -> OtherController:
        """Make a controller with separate workspaces, so that the tick may go on meanwhile."""
        robot = self._parts.model.robot
        parts = dataclasses.replace(
            self._parts,
            config=config,
            session=session,
            model=WholeBodyModel(robot),
            stacks=make_stacks(robot, config.wbc, Limits.of(robot, config)),
        )
        made = OtherController(config, self._make_controller(parts))
        self._prepared.append(made)
        return made

    def begin_switch(self, other: OtherController) -> None:
        """Let another controller collect answers. Until it has one, the present one goes on."""
        self._take_prepared(other)
        self._abandon_switch()
        self._before_ns = self.cache.newest_stamp_ns
        self.cache = _continued(other.controller.cache, self.cache)
        self._waiting = other

    def follow(self) -> None:
        """Change to the controller that waits once it has an answer. Call this in every tick."""
        waiting = self._waiting
        if (
            waiting is not None
            and self.cache.newest_stamp_ns > self._before_ns
            and not self.cache.is_empty
        ):
            self._waiting = None
            self._change_to(waiting)

    def replace(self, other: OtherController) -> None:
        """Change to another controller at once."""
        self._take_prepared(other)
        _continued(other.controller.cache, self.cache)
        self._abandon_switch()
        self._change_to(other)

    def offer(self, data: bytes, *, sent: SentStates) -> bool:
        """Offer an answer to the caches. Return whether one has taken it."""
        present = self.controller.cache
        last = present is not self.cache and present.offer(data, sent=sent)
        if last and type(present) is not type(self.cache):
            # The controller that waits has no use for an answer of this kind.
            return True
        return self.cache.offer(data, sent=sent)

    def close(self) -> None:
        """End the processes of all on-board computers."""
        self._take_prepared(None)
        self._abandon_switch()
        self.close_retired()
        if self.controller.on_board is not None:
            self.controller.on_board.close()

    def close_retired(self) -> None:
        """End the processes of the computers that are not needed any more."""
        while self._retired:
            self._retired.pop().close()

    def _change_to(self, other: OtherController) -> None:
        if self.controller.on_board is not None:
            self._retired_qps += self.controller.on_board.solves
            self._retired.append(self.controller.on_board)
        self.config, self.controller = other.config, other.controller
        self.cache = other.controller.cache

    def _abandon_switch(self) -> None:
        if self._waiting is not None:
            self._retire(self._waiting)
        self._waiting = None

    def _take_prepared(self, taken: OtherController | None) -> None:
        """Retire the controllers that were prepared beside the one that is taken.

        They continue from what the robot had before, so that no command uses them any more.
        """
        prepared, self._prepared = self._prepared, []
        for other in prepared:
            if other is not taken:
                self._retire(other)

    def _retire(self, other: OtherController) -> None:
        if other.controller.on_board is not None:
            self._retired.append(other.controller.on_board)


def _continued(cache: AnswerCache, before: AnswerCache) -> AnswerCache:
    """Let a new cache go on with the counts of the one before."""
    cache.refused.update(before.refused)
    cache.newest_stamp_ns = before.newest_stamp_ns
    return cache
