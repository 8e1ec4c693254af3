"""The campaign of faults: its cases, its journal, its oracles, and its first cases themselves."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.faults import fuzz, live, lockstep
from benchmarks.faults.campaign import JOURNAL, chosen, play, play_case
from benchmarks.faults.cases import (
    FUZZ,
    KINDS,
    LATER,
    LIVE,
    LOCKSTEP,
    SHORT,
    WHOLE,
    Case,
    make_cases,
)
from benchmarks.faults.hostile import TO_EDGE, TO_OPEN_ROWS, TO_ROBOT
from benchmarks.faults.hostile_plans import TO_LAW, TO_PLANS
from benchmarks.faults.page import BEGIN, END, PAGE, evidence, with_evidence
from benchmarks.faults.pair import Pair
from benchmarks.faults.promises import PROMISES, Outcome, broken, table
from edge_node import session
from experiments.studies.journal import open_journal
from shared.config.config_file import load_config
from shared.errors import ConfigError
from tests.processes import ROOT

ROOMS = {FUZZ: fuzz, LOCKSTEP: lockstep, LIVE: live}
LOCKSTEP_KEPT = {
    "fell": False,
    "ended": True,
    "finite": True,
    "clamped": True,
    "same_again": True,
}
FUZZ_KEPT = {
    "sent": True,
    "fell": False,
    "finite": True,
    "clamped": True,
    "answered_after": True,
    "torque_apart_after": 0.0,
    "torque_tolerance": fuzz.TOLERANCE,
    "plan_taken": False,
}
LIVE_KEPT = dict.fromkeys(("agrees", "readable", "clean", "one_line", "told"), True)


def labels(cases: list[Case]) -> list[dict[str, Any]]:
    return [case.label for case in cases]


def case_of(kind: str, fault: str, **parameters: Any) -> Case:
    return Case(kind, 0, 0, fault, parameters)


def hostile(to: str, change: str, **parameters: Any) -> Case:
    given = {"to": to, "change": change, "every_state": False, "at": 20, "first": True}
    return case_of(FUZZ, f"{change} to the {to}", controller="la", **{**given, **parameters})


# The cases.


def test_a_seed_gives_the_same_cases_and_another_seed_others() -> None:
    whole = chosen(0, short=False)
    assert labels(chosen(0, short=False)) == labels(whole)
    assert labels(chosen(1, short=False)) != labels(whole)
    identities = {case.identity for seed in (0, 1) for case in chosen(seed, short=False)}
    assert len(identities) == 2 * len(whole)


def test_the_whole_campaign_is_as_large_as_it_says_and_the_short_one_is_its_beginning() -> None:
    whole, short = chosen(0, short=False), chosen(0, short=True)
    for kind in KINDS:
        of_kind = [case for case in whole if case.kind == kind]
        assert len(of_kind) == WHOLE[kind]
        first = of_kind[: SHORT[kind]]
        if kind in LATER:
            first += of_kind[LATER[kind] :][: len(lockstep.LATER_DRAWS)]
        assert labels([case for case in short if case.kind == kind]) == labels(first)
    assert WHOLE[LOCKSTEP] >= 300
    assert WHOLE[LIVE] >= 60


def test_faults_that_came_later_leave_the_earlier_cases_as_they_were() -> None:
    earlier = make_cases(LOCKSTEP, lockstep.DRAWS, seed=0, count=LATER[LOCKSTEP])
    whole = chosen(0, short=False, kinds=[LOCKSTEP])
    assert labels(whole[: LATER[LOCKSTEP]]) == labels(earlier)
    assert {case.fault for case in whole[LATER[LOCKSTEP] :]} == set(lockstep.LATER_DRAWS)


@pytest.mark.parametrize("kind", [FUZZ, LOCKSTEP])
def test_the_short_campaign_has_every_fault_of_messages_and_links(kind: str) -> None:
    short = [case.fault for case in chosen(0, short=True, kinds=[kind])]
    later = lockstep.LATER_DRAWS if kind == LOCKSTEP else {}
    assert set(short) == set(ROOMS[kind].DRAWS) | set(later)


def test_every_lockstep_fault_meets_every_controller_standing_and_walking() -> None:
    met = {
        (case.fault, settings["controller"], settings["task"])
        for case in chosen(0, short=False, kinds=[LOCKSTEP])
        for settings in (case.parameters["settings"],)
    }
    for fault in (*lockstep.DRAWS, *lockstep.LATER_DRAWS):
        for controller in lockstep.CONTROLLERS:
            assert (fault, controller, "balance") in met
            stands = fault in ("repeated holds", "drift of the estimate")
            assert (fault, controller, "walk") in met or stands


def test_the_settings_of_every_trial_can_be_read() -> None:
    for case in chosen(3, short=False, kinds=[LOCKSTEP]):
        assert lockstep.config_of(case).controller == case.parameters["controller"]


def test_an_outage_of_la_is_short_and_outside_the_push() -> None:
    cases = make_cases(LOCKSTEP, lockstep.DRAWS, seed=0, count=2000)
    outages = [
        lockstep.config_of(case)
        for case in cases
        if case.fault == "outage" and case.parameters["controller"] == "la"
    ]
    assert len(outages) > 50
    for config in outages:
        (outage,) = config.link.outages
        assert outage.duration_ns is not None
        assert outage.duration_ns <= 400_000_000
        for push in config.pushes:
            assert outage.start_ns > push.start_ns + push.duration_ns + 500_000_000


def test_a_case_is_selected_by_its_name_and_a_wrong_name_is_refused() -> None:
    (case,) = chosen(0, short=False, only=["lockstep-017"])
    assert labels([case]) == labels([chosen(0, short=False, kinds=[LOCKSTEP])[17]])
    with pytest.raises(ConfigError, match=r"--only: expected .* got 'lockstep-x'"):
        chosen(0, short=False, only=["lockstep-x"])


@pytest.mark.parametrize(
    ("controller", "settings", "to_robot"),
    [("la", {}, TO_ROBOT), ("lc", {}, TO_ROBOT), ("la", fuzz.LIMITED, TO_OPEN_ROWS)],
)
def test_every_change_makes_another_message(
    controller: str, settings: dict[str, Any], to_robot: dict[str, Any]
) -> None:
    # An answer to every state.
    refresh = {"correction.refresh_distance": 0.0, "correction.refresh_interval_ns": 0}
    pair = Pair(load_config(None, {"controller": controller, "push": [], **refresh, **settings}))
    states: list[bytes] = []
    answers: list[bytes] = []

    def noted(messages: list[bytes]) -> Any:
        def note(data: bytes) -> list[bytes]:
            messages.append(data)
            return [data]

        return note

    for _ in range(5):
        pair.tick(uplink=noted(states), downlink=noted(answers))
    rng = np.random.default_rng(0)
    for changes, data in ((TO_EDGE, states[-1]), (to_robot, answers[-1])):
        for name, (draw, change) in changes.items():
            for _ in range(8):
                given = {**draw(rng), "first": True}
                assert change(data, pair.codec, given, rng) != data, (name, given)


def test_every_change_makes_another_plan_or_law() -> None:
    pair = Pair(load_config(None, fuzz.WALK))
    sent: list[bytes] = []

    def note(data: bytes) -> list[bytes]:
        sent.append(data)
        return [data]

    for _ in range(100):
        pair.tick(plans=note)
    law, plan, *_ = sent
    rng = np.random.default_rng(0)
    for changes, data in ((TO_PLANS, plan), (TO_LAW, law)):
        for name, (draw, change) in changes.items():
            for _ in range(3):
                given = {**draw(rng), "first": True}
                assert change(data, pair.codec, given, rng) != data, (name, given)


def test_a_plan_after_which_all_others_would_be_stale_changes_nothing() -> None:
    case = hostile("plans", "order", at=0, by=("number", 2**63 - 1))
    outcome = fuzz.play(case)
    assert broken(case, outcome) == []
    assert outcome["refused"]["plans"] == {"number": 1}


# The journal.


def test_a_campaign_that_was_interrupted_plays_what_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cases = make_cases(LIVE, live.DRAWS, seed=1, count=4)
    played = []

    def fake(them: Any, given: dict[str, Any]) -> Outcome:
        played.append(given)
        if len(played) == 3:
            raise KeyboardInterrupt
        if len(played) == 2:
            raise ValueError("two\nlines")
        return dict(LIVE_KEPT)

    for fault in live.DRAWS:
        monkeypatch.setitem(live._PLAYS, fault, fake)
    with open_journal(tmp_path / JOURNAL) as journal, pytest.raises(KeyboardInterrupt):
        play(cases, journal, known={})
    with open_journal(tmp_path / JOURNAL) as journal:
        assert [*journal.failed()] == [cases[1].identity]
    with (tmp_path / JOURNAL).open("a") as file:
        file.write('{"case": "half a li')
    with open_journal(tmp_path / JOURNAL) as journal:
        outcomes = play(cases, journal, known=journal.usable(keep_code=False))
    # The second case, which ended by an error, is played again; the first is not.
    assert played[3:] == [case.parameters for case in cases[1:]]
    assert [*outcomes.values()] == [LIVE_KEPT] * 4
    lines = [json.loads(line) for line in (tmp_path / JOURNAL).read_text().splitlines()]
    assert [line["label"] for line in lines] == labels([cases[0], *cases[1:2], *cases[1:]])
    assert lines[0]["summary"] == LIVE_KEPT
    assert lines[1]["error"].startswith("ValueError: two lines")
    assert "live-001  kill -9 of the supervisor, 0 s: ERROR ValueError" in capsys.readouterr().out


def test_a_case_that_the_machine_does_not_allow_is_skipped_with_its_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    number = [*live.DRAWS].index("a second user")
    case = make_cases(LIVE, live.DRAWS, seed=0)[number]
    record = play_case(case)
    assert record["summary"] == {"skipped": "only root can be another user"}
    assert broken(case, record["summary"]) == []
    assert "1 more skipped" in evidence({case: record["summary"]})


# The oracles.


@pytest.mark.parametrize(
    ("case", "kept", "changes", "promise"),
    [
        (hostile("edge", "joint"), FUZZ_KEPT, {"fell": True}, "raises no error"),
        (hostile("edge", "joint"), FUZZ_KEPT, {"finite": False}, "finite and within"),
        (hostile("edge", "joint"), FUZZ_KEPT, {"torque_apart_after": 0.6}, "every torque is"),
        (hostile("edge", "joint"), FUZZ_KEPT, {"answered_after": False}, "no honest message"),
        (case_of(LOCKSTEP, "cut", controller="lc"), LOCKSTEP_KEPT, {"fell": True}, "LC never"),
        (case_of(LOCKSTEP, "cut", controller="pr"), LOCKSTEP_KEPT, {"clamped": False}, "clamp"),
        (case_of(LOCKSTEP, "outage", controller="la"), LOCKSTEP_KEPT, {"fell": True}, "0.4 s"),
        (
            case_of(LOCKSTEP, "repeated holds", controller="la"),
            LOCKSTEP_KEPT,
            {"fell": True},
            "repeated joint holds",
        ),
        (
            case_of(LOCKSTEP, "jump of the estimate", controller="la"),
            LOCKSTEP_KEPT,
            {"fell": True},
            "estimate jumps or drifts",
        ),
        (
            case_of(LOCKSTEP, "loss", controller="la"),
            LOCKSTEP_KEPT,
            {"same_again": False},
            "to the last bit",
        ),
        (case_of(LIVE, "a full disk"), LIVE_KEPT, {"agrees": False}, "agrees"),
        (case_of(LIVE, "a full disk"), LIVE_KEPT, {"clean": False}, "is left"),
    ],
)
def test_a_broken_promise_is_seen(
    case: Case, kept: Outcome, changes: Outcome, promise: str
) -> None:
    assert broken(case, kept) == []
    (text,) = broken(case, {**kept, **changes})
    assert promise in text
    lines = table([(case, {**kept, **changes})])
    assert any(text in line and f"`{case.name}`" in line for line in lines)


def test_what_is_not_promised_breaks_nothing() -> None:
    for fault, controller in (("cut", "la"), ("outage", "pr"), ("loss", "la")):
        assert broken(case_of(LOCKSTEP, fault, controller=controller), LOCKSTEP_KEPT) == []
        fallen = {**LOCKSTEP_KEPT, "fell": True}
        assert broken(case_of(LOCKSTEP, fault, controller=controller), fallen) == []


def test_an_error_breaks_every_promise_of_its_kind() -> None:
    case = hostile("edge", "joint")
    assert broken(case, None) == [each.text for each in PROMISES if each.kind == FUZZ]


def test_an_edge_that_one_message_silences_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The fault for which the oracle was made: a huge sequence, after which all is stale."""
    case = hostile("edge", "sequence", by=2**63 - 1)
    assert broken(case, fuzz.play(case)) == []
    monkeypatch.setattr(session.RobotSession, "is_stuck", lambda self, now_ns: False)
    outcome = fuzz.play(case)
    assert outcome["refused"]["edge"] == {"stale": 1000}
    assert any("no honest message" in each for each in broken(case, outcome))


def test_torques_beyond_the_clamp_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    case = chosen(0, short=True, kinds=[LOCKSTEP])[0]
    given = {**case.parameters["settings"], "duration": 0.3}
    case = case_of(LOCKSTEP, "cut", controller="lc", settings=given)
    assert broken(case, lockstep.play(case)) == []
    monkeypatch.setattr("robot_node.safety.TorqueGuard.accept", lambda self, tau: 100.0 * tau)
    assert any("clamp" in each for each in broken(case, lockstep.play(case)))


# The page.


def test_the_page_has_the_evidence_between_its_markers() -> None:
    assert with_evidence(f"a {BEGIN} old {END} b", "new") == f"a {BEGIN}\n\nnew\n\n{END} b"
    with pytest.raises(ConfigError, match=r"docs: expected .* add them"):
        with_evidence("nothing", "new")


def test_the_page_names_every_promise() -> None:
    page = (ROOT / "docs" / PAGE).read_text()
    missing = [each.text for each in PROMISES if f"| {each.text} |" not in page]
    assert not missing, "run ./wbc bench faults --docs docs"


# The short campaign. Its live part: tests/live/test_benchmarks.py.


@pytest.mark.parametrize(
    "case", chosen(0, short=True, kinds=[FUZZ, LOCKSTEP]), ids=lambda case: case.name
)
def test_the_short_campaign_keeps_every_promise(case: Case) -> None:
    record = play_case(case)
    assert record["error"] is None
    assert broken(case, record["summary"]) == []
