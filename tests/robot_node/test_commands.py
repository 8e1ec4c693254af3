"""An operator's commands on the robot, tick by tick, and the pace of simulated time."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from threading import Thread
from typing import Any

import numpy as np
import pytest

from robot_node.commands import RobotCommands
from robot_node.controllers import LocallyAssisted, PurelyRemote
from robot_node.corrected import LocallyCorrected
from robot_node.live import LiveLoop, Progress
from robot_node.pace import Pace
from shared.bus.base import Inbox
from shared.errors import ConfigError, LinkError
from shared.telemetry.row_log import RowLog
from shared.telemetry.schema import Source
from shared.wire.operator.commands import (
    Pause,
    Reset,
    Resume,
    RobotCommand,
    Speed,
    Step,
    SwitchController,
)
from shared.wire.operator.texts import parse_command
from tests.processes import until
from tests.robot_node.bench import MS, SESSION, Bench, nothing


@pytest.fixture
def bench(robot, motion, configured):
    def build(**overrides):
        return Bench(robot, motion, configured(**{"push": [], **overrides}))

    return build


def given(bench: Bench, text: str) -> None:
    command = parse_command(text)
    assert isinstance(command, RobotCommand)
    bench.robot.prepare(command)()


def test_a_push_acts_from_the_next_tick_for_its_time_beside_those_of_the_settings(bench):
    played = bench(push=["10N@0.004s:0.003s:+y"]).run(3)
    given(played, "push 60N -x --for 2ms")
    played.run(4)
    forces = played.column("push_n")
    np.testing.assert_array_equal(forces[:, 0], [0, 0, 0, -60, -60, 0, 0])
    np.testing.assert_array_equal(forces[:, 1], [0, 0, 0, 0, 10, 10, 10])


def test_the_memory_of_pushes_is_bounded(bench):
    played = bench().run(1)
    for _ in range(50):
        given(played, "push 1N +x --for 1s")
    assert len(played.robot._pushes) <= 25
    played.run(1)
    assert played.column("push_n")[-1, 0] >= 20


KINDS = {"pr": PurelyRemote, "la": LocallyAssisted, "lc": LocallyCorrected}


@pytest.mark.parametrize(
    ("before", "after"), [("la", "pr"), ("pr", "la"), ("la", "lc"), ("lc", "la")]
)
def test_another_controller_takes_over_with_its_first_answer(bench, before, after):
    played = bench(controller=before).run(3)
    given(played, f"controller {after}")
    # Without answers the present controller goes on with what it has.
    played.run(5, deliver=nothing)
    assert isinstance(played.robot.controller, KINDS[before])
    assert Source.HELD not in [command.source for command in played.commands]
    # The edge sends a lost factorisation again after 100 ms.
    played.run(110)
    assert isinstance(played.robot.controller, KINDS[after])
    assert Source.HELD not in [command.source for command in played.commands]
    # Answers of the last controller's kind are no fault of the edge.
    assert played.robot.cache.refused == {}


def test_lc_takes_over_again_after_another_controller(bench):
    played = bench(controller="lc").run(3)
    for name in ("la", "lc"):
        given(played, f"controller {name}")
        played.run(210)
        assert isinstance(played.robot.controller, KINDS[name])
        assert Source.HELD not in [command.source for command in played.commands]


def test_a_sign_of_life_without_a_factorisation_is_no_first_answer(bench):
    played = bench(controller="la").run(3)
    given(played, "controller lc")
    empty = partial(dataclasses.replace, factorisations=())

    def deliver(answer):
        message = played.codec.decode_factorisations(answer)
        return [played.codec.encode_factorisations(empty(message))]

    played.run(5, deliver=deliver)
    assert isinstance(played.robot.controller, LocallyAssisted)


def test_a_controller_that_was_prepared_in_vain_ends_its_computer(bench, monkeypatch):
    played = bench(controller="lc", **{"correction.on_board_budget": 0.1}).run(2)
    closed: list[Any] = []
    monkeypatch.setattr(type(played.robot.on_board), "close", lambda it: closed.append(it))
    script, operator = (played.robot.prepare(SwitchController("lc")) for _ in range(2))
    vain = played.robot._slot._prepared[0].controller.on_board
    operator()
    assert closed == []
    played.robot.prepare(parse_command("push 1N +x"))
    assert closed == [vain]
    del script
    played.robot.close()
    # The present one and the one that waits.
    assert len(closed) == len(set(map(id, closed))) == 3


def test_a_controller_that_does_not_exist_is_refused_and_changes_nothing(bench):
    played = bench().run(2)
    with pytest.raises(ConfigError, match="expected a module that can be imported"):
        played.robot.prepare(SwitchController("no.such.module:Mine"))
    assert isinstance(played.robot.controller, LocallyAssisted)


def test_after_a_reset_the_robot_stands_as_at_the_beginning_and_its_time_goes_on(bench, robot):
    played = bench().run(5)
    given(played, "push 3000N +x --for 150ms")
    played.run(160)
    assert np.abs(played.robot._plant.state()[0][0] - robot.q_standing[0]) > 0.05
    faults = played.robot.sensor_guard.faults.total()
    given(played, "reset")
    q, v = played.robot._plant.state()
    np.testing.assert_allclose(q, robot.q_standing, atol=1e-12)
    np.testing.assert_array_equal(v, 0.0)
    assert played.robot.time_ns == 165 * MS
    played.run(3, deliver=nothing)
    # Answers to the states before the reset would be wrong.
    assert [command.source for command in played.commands[-3:]] == [Source.HELD] * 3
    played.run(20)
    assert played.commands[-1].source is Source.FRESH
    assert played.state.session == SESSION + 1
    assert played.state.time_ns == 22 * MS
    assert played.robot.time_ns == 188 * MS
    assert not played.robot.walk_ended
    assert played.robot.sensor_guard.faults.total() == faults


def test_a_robot_that_has_fallen_is_up_after_a_reset(bench):
    played = bench().run(2)
    given(played, "push 5000N +x --for 500ms")
    while not played.robot.fallen:
        played.run(1)
    given(played, "reset")
    played.run(50)
    assert not played.robot.fallen


def test_simulated_time_stands_still_and_goes_on():
    pace = Pace()
    for command, left, speed in (
        (Speed(0.25), None, 0.25),
        (Pause(), 0, 0.0),
        (Step(3), 3, 0.25),
        (Pause(), 0, 0.0),
        (Speed(0.5), 0, 0.0),
        (Resume(), None, 0.5),
        (Speed(1.0), None, 1.0),
    ):
        carry_out = pace.prepare(command)
        assert carry_out is not None
        carry_out()
        assert (pace.left, pace.clock.speed) == (left, speed)
    assert pace.prepare(Reset()) is None


class Hub:
    """A hub on which nobody asks and nobody listens."""

    def publisher(self, key: str) -> Hub:
        return self

    def publish(self, data: bytes) -> None:
        pass

    def serve(self, key: str) -> Hub:
        return self

    def answer(self, respond: object) -> bool:
        return False


class Loop:
    """A loop whose ticks come at once: that of a time after the next of the commands `before`."""

    def __init__(self) -> None:
        self.progress = Progress(running=True)
        self.pace = Pace()
        self.before: list[Any] = []

    def between_ticks(self, action: Callable[[], None], *, at_ns: int = 0) -> int:
        if at_ns and self.before:
            self.before.pop()()
        action()
        return at_ns


class Node:
    """A robot that carries everything out."""

    fallen = False

    def __init__(self) -> None:
        self.prepared: list[str] = []
        self.done: list[str] = []

    def prepare(self, command: RobotCommand) -> Callable[[], None]:
        self.prepared.append(str(command))
        return lambda: self.done.append(str(command))


def _any(stand_in: Any) -> Any:
    return stand_in


def test_a_controller_that_was_prepared_before_a_reset_is_prepared_again():
    node, loop, hub = _any(Node()), _any(Loop()), _any(Hub())
    commands = RobotCommands(hub, node, loop, print)
    loop.before = [partial(commands._carry_out, Reset())]
    # A script's command: it is prepared before its time.
    assert commands._carry_out(SwitchController("lc"), at_ns=7 * MS).time_ns == 7 * MS
    assert node.prepared == ["controller lc", "reset", "controller lc"]
    assert node.done == ["reset", "controller lc"]
    # A push is for any controller.
    loop.before = [partial(commands._carry_out, Reset())]
    commands._carry_out(parse_command("push 1N +x"), at_ns=9 * MS)
    assert node.done[2:] == ["reset", "push 1N +x --for 200ms"]
    loop.before = 5 * [partial(commands._carry_out, Reset())]
    with pytest.raises(LinkError, match="other commands came between 3 times"):
        commands._carry_out(SwitchController("la"), at_ns=9 * MS)


def test_an_action_with_a_time_waits_for_its_tick_and_lets_others_pass(bench):
    """The robot's own loop, tick by tick: see `LiveLoop._carry_out_due`."""
    node = bench().robot
    loop = LiveLoop(
        node,
        node._config.loop,
        uplink=_any(Hub()),
        inbox=Inbox(),
        log=RowLog(node.schema),
        explain=str,
    )
    done: list[str] = []

    def ask(name: str, at_ns: int) -> Thread:
        thread = Thread(target=lambda: loop.between_ticks(lambda: done.append(name), at_ns=at_ns))
        before = len(loop._between)
        thread.start()
        until(lambda: len(loop._between) > before, "it is not taken")
        return thread

    threads = [ask("late", 5 * MS), ask("now", 0)]
    loop._carry_out_due()
    assert done == ["now"]
    node.time_ns = 4 * MS
    loop._carry_out_due()
    assert done == ["now"]
    node.time_ns = 5 * MS
    loop._carry_out_due()
    assert done == ["now", "late"]
    for thread in threads:
        thread.join()
    assert loop._between == []
