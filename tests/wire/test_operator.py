"""Commands and events as text: what is read, what is refused; nothing else gets through."""

from __future__ import annotations

import contextlib
from pathlib import Path

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.errors import ConfigError, MessageRefused
from shared.wire.operator.commands import (
    Accepted,
    AddDelay,
    Command,
    Cut,
    Drive,
    Go,
    Pause,
    PushCommand,
    ReplaceProfile,
    Reset,
    Restore,
    Resume,
    SetLoss,
    Speed,
    Stall,
    Step,
    SwitchController,
)
from shared.wire.operator.events import CommandEvent, parse_event, read_events, write_events
from shared.wire.operator.messages import (
    decode_answer,
    decode_command,
    decode_event,
    encode_answer,
    encode_command,
    encode_event,
)
from shared.wire.operator.texts import parse_command
from shared.wire.robot_clock import ClockReading, decode_clock, encode_clock

MS = 1_000_000
COMMANDS: dict[str, Command] = {
    "push 120N +y": PushCommand(120.0, "+y", 200 * MS),
    "push 62.5N -x+y --for 1s": PushCommand(62.5, "-x+y", 1000 * MS),
    "link cut": Cut(),
    "link restore": Restore(),
    "link delay 80ms": AddDelay(80 * MS),
    "link delay 0ms": AddDelay(0),
    "link loss 10%": SetLoss(0.1),
    "link loss 0.1": SetLoss(0.1),
    "link loss 12.3456%": SetLoss(0.123456),
    "push 123.456789N +z": PushCommand(123.456789, "+z", 200 * MS),
    "link profile capacity:factory/011": ReplaceProfile("capacity:factory/011"),
    "link outage 300ms": Stall(300 * MS),
    "controller LC": SwitchController("lc"),
    "go 1.5 -0.2 90deg": Go(1.5, -0.2, 1.570796),
    "drive 0.2 0 -0.1": Drive(0.2, 0.0, -0.1),
    "pause": Pause(),
    "step": Step(1),
    "step 20ms": Step(20),
    "speed 0.25": Speed(0.25),
    "resume": Resume(),
    "reset": Reset(),
}
# A text that is no command, and a part of the line that says so.
WRONG = {
    "": "expected one of push, link, controller",
    "pussh 100N +y": "did you mean push?",
    "push": "expected FORCE DIRECTION as in 120N +y, and --for 0.2s, got nothing",
    "push 120 +y": "expected a force up to 10000N as in 120N, got '120'",
    "push 1e9N +y": "expected a force up to",
    "push 0N +y": "expected a force up to",
    "push 120N up": "expected a direction ±x, ±y, ±z or ±x±y, got 'up'",
    "push 120N +y --for ever": "expected a duration as in 30ms",
    "push 120N +y --for 0ms": "expected 1ms to 60s",
    "push 120N +y for 1s": "expected FORCE DIRECTION",
    "link": "expected one of cut, restore, delay",
    "link cutt": "did you mean cut?",
    "link cut now": "expected no more words, got now",
    "link delay": "expected a round trip to add, as in 80ms, got nothing",
    "link delay 80": "expected a duration as in 30ms",
    "link delay -1ms": "expected a duration as in 30ms",
    "link loss 100%": "expected 0% to less than 100%",
    "link loss nan": "expected 0% to less than 100%",
    "link outage 9999s": "expected 1ms to 60s",
    "link profile direct": "try constant:0ms",
    "controller": "expected one of la, lc, pr, got nothing",
    "controller lx": "expected one of la, lc, pr, got 'lx'",
    "step 0": "expected 1 to 60000 ticks",
    "step -1": "expected a duration",
    "go 1 2": "expected X Y YAW in m and rad, as in 1.5 0 90deg, got 1 2",
    "go nan 0 0": "expected X Y YAW",
    "go 1e9 0 0": "expected X Y YAW",
    "go 0 0 north": "expected X Y YAW",
    "drive 0.2": "expected FORWARD LEFT TURNING up to 2 m/s and rad/s",
    "drive inf 0 0": "expected FORWARD LEFT TURNING",
    "drive": "got nothing",
    "speed 0": "expected 0.01 to 1 × real time, got 0",
    "speed 2": "expected 0.01 to 1 × real time, got 2",
    "speed nan": "expected 0.01 to 1",
    "reset " + 300 * "x": "expected at most 300 characters",
}


@pytest.mark.parametrize("text", COMMANDS)
def test_a_command_is_read_from_its_text_and_from_its_message(text: str) -> None:
    command = COMMANDS[text]
    assert parse_command(text) == command
    assert parse_command(str(command)) == command
    assert decode_command(encode_command(command)) == command


@pytest.mark.parametrize("text", WRONG)
def test_a_wrong_command_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(ConfigError) as refused:
        parse_command(text)
    assert WRONG[text] in str(refused.value)
    assert "\n" not in str(refused.value)


VALUES = st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text()


@given(st.binary(max_size=60) | st.builds(msgpack.packb, st.lists(VALUES, max_size=6)))
def test_no_bytes_do_more_than_be_refused(data: bytes) -> None:
    for decode, refusal in (
        (decode_command, ConfigError),
        (decode_answer, ConfigError),
        (decode_event, MessageRefused),
        (decode_clock, MessageRefused),
    ):
        with contextlib.suppress(refusal):
            decode(data)


def test_a_message_of_another_version_or_of_any_size_is_refused() -> None:
    with pytest.raises(ConfigError, match="expected version 1 of the messages, got 2"):
        decode_command(msgpack.packb([2, "pause"]))
    with pytest.raises(ConfigError, match="expected a message of this version"):
        decode_command(msgpack.packb([1, 2000 * "x"]))


def test_an_answer_says_when_or_why_not() -> None:
    for answer in (Accepted(2_345 * MS, "a note"), "push: the robot has fallen"):
        assert decode_answer(encode_answer(answer)) == answer


def test_events_are_written_and_read_at_the_same_times(tmp_path: Path) -> None:
    events = tuple(CommandEvent(k * 1_237 * MS, each) for k, each in enumerate(COMMANDS.values()))
    write_events(tmp_path / "events.txt", events)
    assert read_events(tmp_path / "events.txt") == events
    for event in events:
        assert decode_event(encode_event(event, wall_ns=7)) == (event, 7)


def test_a_script_is_read_in_the_order_of_its_times_and_to_the_next_tick(tmp_path: Path) -> None:
    script = tmp_path / "scene.txt"
    script.write_text("# a scene\n\n2s   link restore\n1500.2ms link cut\n")
    assert read_events(script) == (
        CommandEvent(1_501 * MS, Cut()),
        CommandEvent(2_000 * MS, Restore()),
    )
    assert parse_event("0s pause").time_ns == 0


def test_a_line_that_cannot_be_used_is_named(tmp_path: Path) -> None:
    script = tmp_path / "scene.txt"
    script.write_text("1s link cut\nlink restore\n")
    with pytest.raises(ConfigError, match=r"scene\.txt, line 2: expected a duration"):
        read_events(script)
    with pytest.raises(ConfigError, match=r"events: cannot read .*none"):
        read_events(tmp_path / "none")


def test_a_reading_of_the_clock_tells_the_tick_that_begins_next() -> None:
    reading = ClockReading(10, 20, 0.25, now_ns=500 * MS, task_ns=100 * MS)
    assert decode_clock(encode_clock(reading)) == reading
    assert reading.origin == (10, 20, 0.25)
    assert reading.tick_from(500 * MS) == 100 * MS
    assert reading.tick_from(500 * MS + 1) == 101 * MS
    assert reading.tick_from(0) == 0
