"""Commands to a running stack: which stack they are for, and what is refused without one."""

from __future__ import annotations

import argparse
import os
import struct
from pathlib import Path

import pytest

from deploy import operate
from deploy.background import registry
from deploy.background.registry import in_terminal
from deploy.background.state import READY, StackFolder, StackState
from deploy.console.keys import commands_of, keys_in_words
from deploy.drive import Gamepad, Hand
from shared.errors import ConfigError, LinkError
from shared.process.cli import Parser
from shared.wire.operator.commands import Cut, Drive, PushCommand, SwitchController

NOBODY = 2**22 + 1
STOP = Drive(0.0, 0.0, 0.0)


@pytest.fixture(autouse=True)
def own_registry(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(registry, "registry_folder", lambda: tmp_path / "stacks")


def running(run: Path, robot: str = "romeo", *named: str) -> StackFolder:
    """The folder of a stack whose lock is held by the caller, once it has claimed it."""
    run.mkdir()
    stack = StackFolder(run)
    stack.claim().close()
    services = named or ("edge", "netem", "robot")
    stack.write(StackState(os.getpid(), robot, services, READY, 9.0))
    return stack


def sent(command: str, *typed: str) -> int:
    parser = Parser()
    getattr(operate, f"add_{command}_arguments")(parser)
    code: int = getattr(operate, f"run_{command}")(parser.parse_args(typed))
    return code


def test_without_a_stack_a_command_says_how_to_start_one(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"^no stack runs; start one with .*wbc up$"):
        sent("pause")
    with pytest.raises(ConfigError, match="no stack of amy runs"):
        sent("reset", "--name", "amy")
    stack = running(tmp_path / "ended")
    with pytest.raises(ConfigError, match=rf"no stack in {stack.run} runs"):
        sent("link", "cut", "--run", str(stack.run))


def test_a_wrong_command_is_refused_before_a_stack_is_looked_for() -> None:
    for command, *typed in (
        ("push", "120", "+y"),
        ("push", "120N", "sideways"),
        ("link", "delay"),
        ("link", "chop"),
        ("controller", "lx"),
        ("step", "0"),
        ("go", "1", "2", "north"),
        ("drive", "0.1", "0"),
        ("speed", "7"),
    ):
        with pytest.raises(ConfigError, match="expected"):
            sent(command, *typed)


@pytest.mark.parametrize("direction", ["+y", "-y", "-x", "-z", "+x-y", "-x+y", "-x-y"])
def test_a_direction_may_begin_with_a_minus(direction: str) -> None:
    with pytest.raises(ConfigError, match="no stack runs"):
        sent("push", "120N", direction, "--for", "100ms")


def test_one_stack_is_chosen_by_itself_and_one_of_several_by_name_or_folder(
    tmp_path: Path,
) -> None:
    amy = running(tmp_path / "amy", "amy")
    with amy.claim(), in_terminal(amy.run):
        # It is found, and has no control socket yet.
        with pytest.raises(LinkError, match="takes no commands yet"):
            sent("pause")
        bob = running(tmp_path / "bob", "bob", "robot")
        with bob.claim():
            link = tmp_path / "stacks/.terminals" / str(NOBODY)
            link.symlink_to(bob.run)
            with pytest.raises(ConfigError, match=r"several stacks run: .*; select one with"):
                sent("pause")
            for chosen in (("--name", "bob"), ("--run", str(bob.run))):
                with pytest.raises(LinkError, match="takes no commands yet"):
                    sent("pause", *chosen)
            with pytest.raises(ConfigError, match="link cut: expected a stack with netem"):
                sent("link", "cut", "--name", "bob")
            # Only one of them has a link.
            with pytest.raises(LinkError, match="takes no commands yet"):
                sent("link", "cut")
    with pytest.raises(ConfigError, match="no stack runs"):
        sent("pause")
    # What a killed stack has left is removed by the next one.
    with in_terminal(amy.run):
        assert not link.is_symlink()


def test_keys_are_commands_and_every_key_is_in_the_table() -> None:
    commands, enter = commands_of("c\033[D?2\n")
    assert commands == [Cut(), PushCommand(80.0, "+y", 200_000_000), SwitchController("lc")]
    assert enter
    assert commands_of("zq\033") == ([], False)
    table = keys_in_words(link=True)
    assert "← push 80N +y" in table
    assert "c link cut" in table
    assert all(len(line) <= 79 for line in table.splitlines())
    assert "link" not in keys_in_words(link=False)


def test_the_first_word_after_link_decides_between_a_command_and_a_study(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    import remote_wbc
    from experiments import link

    studied: list[str] = []

    def study(arguments: argparse.Namespace) -> int:
        studied.append(arguments.network)
        return 0

    monkeypatch.setattr(link, "run_link", study)

    def typed(*words: str) -> int:
        parser = Parser()
        parser.set_defaults(parser=parser)
        remote_wbc.add_link_arguments(parser)
        return remote_wbc.run_link(parser.parse_args(words))

    with pytest.raises(ConfigError, match="no stack runs"):
        typed("cut")
    with pytest.raises(ConfigError, match="link delay: expected a duration"):
        typed("delay", "80")
    assert typed("./cut") == 0
    assert typed("factory/011", "--quick") == 0
    assert studied == ["./cut", "factory/011"]
    with pytest.raises(SystemExit):
        typed("factory/011", "80ms")


def test_a_key_drives_while_it_is_held_and_any_other_key_stops() -> None:
    hand = Hand()
    assert hand.wanted(0.0) == STOP
    hand.take("w", 1.0)
    assert hand.wanted(1.5).forward > 0.0
    assert hand.wanted(1.8) == STOP
    hand.take("wd", 2.0)
    assert hand.wanted(2.1).left < 0.0
    hand.take("x", 2.2)
    assert hand.wanted(2.3) == STOP


def test_a_gamepad_drives_only_while_a_shoulder_button_is_held() -> None:
    gamepad = Gamepad()

    def event(value: int, kind: int, number: int) -> None:
        gamepad.take(struct.pack("IhBB", 7, value, kind, number))

    event(-32767, 2, 1)
    assert gamepad.wanted is None
    event(1, 1, 4)
    assert gamepad.wanted == Drive(0.15, 0.0, 0.0)
    # A stick that is almost at rest is at rest.
    event(3000, 2, 0)
    assert gamepad.wanted == Drive(0.15, 0.0, 0.0)
    event(0, 1, 4)
    assert gamepad.wanted is None
    gamepad.take(b"cut")
