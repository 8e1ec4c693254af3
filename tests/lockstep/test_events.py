"""An operator's commands in lockstep: their times, their effects, and the same run again."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import pytest

from experiments.lockstep import Lockstep, TrialResult
from experiments.trial import add_trial_arguments, run_trial, write_run
from shared.config.config_file import load_config
from shared.errors import ConfigError, ProfileError
from shared.telemetry.schema import LINK_SCHEMA, Source
from shared.wbc.contacts import ContactMode
from shared.wire.operator.events import parse_event, read_events
from tests.lockstep.test_stepping import WALK

MS = 1_000_000
SCENE = (
    "0.2s push 60N +x --for 100ms",
    "0.3s link outage 100ms",
    "0.45s controller lc",
    "0.6s link delay 30ms",
    "0.65s pause",
    "0.7s controller la",
    "0.75s link profile constant:4ms",
    "0.8s reset",
    "0.9s link cut",
    "0.95s link restore",
)


def played(*events: str, **overrides) -> TrialResult:
    settings = {"push": [], "link.network": "constant:10ms", "duration": 1.1, **overrides}
    config = load_config(None, settings)
    return Lockstep(config, all_active_sets=False, events=map(parse_event, events)).run()


def column(result: TrialResult, name: str) -> np.ndarray:
    return result.schema.column(result.rows, name)


def test_a_run_is_played_again_from_its_record_to_the_same_events_and_bits(tmp_path: Path) -> None:
    first = played(*SCENE)
    assert [str(event) for event in first.events] == [str(parse_event(each)) for each in SCENE]
    run = tmp_path / "run"
    config = load_config(None, {"push": [], "link.network": "constant:10ms", "duration": 9.0})
    write_run(run, config, first)
    parser = argparse.ArgumentParser()
    add_trial_arguments(parser)
    # The record says when the run ended: it is not played for the nine seconds of its settings.
    typed = ["--events", str(run), "--out", str(tmp_path / "again")]
    assert run_trial(parser.parse_args(typed)) == 0
    assert read_events(tmp_path / "again/events.txt") == first.events
    again, other = (read_summary(each) for each in (run, tmp_path / "again"))
    assert again["log_hash"] == other["log_hash"]


def read_summary(run: Path) -> dict[str, object]:
    found: dict[str, object] = json.loads((run / "summary.json").read_text())
    return found


def test_each_command_has_its_effect_at_its_tick() -> None:
    result = played(*SCENE)
    pushed = np.flatnonzero(column(result, "push_n")[:, 0])
    times_ns = column(result, "time_ns")
    assert (times_ns[pushed[0]], times_ns[pushed[-1]]) == (200 * MS, 299 * MS)
    link = result.link_rows
    up = LINK_SCHEMA.column(link, "direction") == 0
    sent, nominal = (LINK_SCHEMA.column(link, name)[up] // MS for name in ("wall_ns", "nominal_ns"))
    # The link's time begins with the first state, the task's with the first answer.
    begun = int(column(result, "wall_ns")[times_ns == 0][0]) // MS
    delay = dict(zip(sent.astype(int) - begun, nominal.astype(int), strict=True))
    assert [delay[at] for at in (299, 300, 399)] == [5, 105, 6]
    # Half of the added 30 ms each way; from 0.75 s on it is added to the new profile's 2 ms.
    assert [delay[at] for at in (599, 600, 749, 770)] == [5, 20, 20, 17]
    lost = LINK_SCHEMA.column(link, "achieved_ns")[up] < 0
    assert set(sent[lost].astype(int) - begun) == set(range(900, 950))
    assert delay[1000] == 2
    sources = column(result, "source").astype(int)
    at = {int(time): source for time, source in zip(times_ns // MS, sources, strict=True)}
    assert at[590] == Source.CORRECTED
    assert at[780] == Source.CACHED
    # After a reset answers to the states before it are of no use.
    assert at[805] == Source.HELD
    assert at[890] == Source.CACHED


def test_a_reset_after_a_fall_lets_the_run_go_on() -> None:
    events = ("0.1s push 2000N +x --for 200ms", "1.2s reset")
    result = played(*events, duration=1.5)
    assert result.summary["fell"] is False
    assert result.summary["task_seconds"] == pytest.approx(1.5)
    alone = played(events[0], duration=1.5)
    assert alone.summary["fell"] is True
    assert alone.summary["task_seconds"] < 1.2


def test_commands_that_nothing_can_carry_out_are_refused_before_the_run() -> None:
    with pytest.raises(ConfigError, match="link cut: expected a link, got --network direct"):
        played("1s link cut", **{"link.network": "direct"})
    with pytest.raises(ProfileError, match="no such profile"):
        played("1s link profile factory/999")


def test_a_reset_begins_a_walk_by_touch_anew() -> None:
    settings = {**WALK, "duration": 2.0}
    trial = Lockstep(
        load_config(None, settings), all_active_sets=False, events=[parse_event("1.1s reset")]
    )
    assert trial.run().summary["fell"] is False
    assert trial.robot.clock is not None
    # The first step of the second walk; the first walk would be in its third.
    assert trial.robot.clock.phase == 1
    assert trial.robot.plans is not None
    assert trial.robot.plans.law != 0


STANDS = {**WALK, "task": "balance", "walk.steps": 6}


@pytest.mark.parametrize("cut", [False, True])
def test_a_driven_robot_stops_by_itself_when_no_hand_is_on_it(cut: bool) -> None:
    """It walks ahead by the commands that it gets, and stands after the last one. With the link
    cut in the middle of its steps it stands too, and goes on after `restore`.
    """
    events = ["0.3s drive 0.15 0 0", "0.8s drive 0.15 0 0"]
    if cut:
        events = ["0.3s drive 0.15 0 0", "1.0s link cut", "3.3s link restore", "3.4s go 0.3 0 0"]
    config = load_config(None, {**STANDS, "duration": 6.3 if cut else 3.6})
    trial = Lockstep(config, all_active_sets=False, events=map(parse_event, events))
    result = trial.run()
    assert result.summary["fell"] is False
    mode, time_ns = (result.schema.column(result.rows, name) for name in ("mode", "time_ns"))
    stands = mode == ContactMode.DOUBLE_SUPPORT
    assert not stands[time_ns < 2_000 * MS].all()
    assert stands[-300:].all()
    ahead = float(result.schema.column(result.rows, "com")[-1, 0])
    if cut:
        # The plan that it had ended in a stand, and the goal was reached after the cut.
        assert stands[(time_ns > 3_200 * MS) & (time_ns < 3_300 * MS)].all()
        assert ahead == pytest.approx(0.33, abs=0.05)
    else:
        assert 0.05 < ahead < 0.4


def test_a_robot_that_does_not_step_by_touch_cannot_be_sent_anywhere() -> None:
    with pytest.raises(ConfigError, match="go 1 0 0: expected robots that step by touch"):
        played("0.1s go 1 0 0")
