"""The reason of a fall: which circumstances count, and their words."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from shared.output.fall import fall_in_words, fall_report, force_in_words, torque_limits
from shared.output.link_met import MetOutage
from shared.robots import Robot
from shared.telemetry.schema import Source, tick_schema

SCHEMA = tick_schema(nq=38, nv=37)
LIMITS = {f"joint{k}": 50.0 for k in range(31)}
S = 1_000_000_000


def fallen(**changes: tuple[slice, Any]) -> np.ndarray:
    """Rows of a robot that leaves its place at 2 s, is lost at 2.1 s and lies at 2.5 s.

    `changes` sets columns in some of the ticks: `push_n=(slice(1900, 2000), [0, 100, 0])`.
    """
    rows = np.zeros((2500, SCHEMA.width))
    seconds = np.arange(2500) * 1e-3
    filled = {
        "time_ns": seconds * S,
        "com_error_m": np.clip((seconds - 1.9) * 0.5, 0.001, None),
        "projector_age_ns": np.full(2500, 4e6),
        "source": np.full(2500, float(Source.CACHED)),
    }
    for name, values in filled.items():
        rows[:, SCHEMA.slices[name]] = values[:, None]
    for name, (ticks, value) in changes.items():
        rows[ticks, SCHEMA.slices[name]] = value
    return rows


def reason(rows: np.ndarray, controller: str = "la", outages: tuple[MetOutage, ...] = ()) -> str:
    report = fall_report(SCHEMA, rows, torque_limits=LIMITS)
    return fall_in_words(report, controller=controller, outages=outages)


def test_a_fall_begins_when_the_com_leaves_its_reference_for_the_last_time() -> None:
    rows = fallen(com_error_m=(slice(500, 600), 0.2))
    report = fall_report(SCHEMA, rows, torque_limits=LIMITS)
    assert (report["begins_s"], report["at_s"]) == (2.0, 2.5)


def test_the_age_at_the_beginning_counts_and_not_at_the_end() -> None:
    rows = fallen(projector_age_ns=(slice(1990, 2010), 190e6))
    expected = "answer in use was 190 ms old when the fall began at 2.00 s"
    assert reason(rows) == f"the {expected}"
    assert reason(rows, "pr").startswith("the torques in use were 190 ms old")


def test_a_push_shortly_before_is_named_and_an_early_one_is_not() -> None:
    sideways = [0.0, -80.0, 0.0]
    assert reason(fallen(push_n=(slice(1800, 2000), sideways))).startswith(
        "pushed with 80 N to -y at 1.80 s; "
    )
    assert "pushed" not in reason(fallen(push_n=(slice(100, 300), sideways)))


def test_the_last_of_several_pushes_is_named() -> None:
    rows = fallen(push_n=(slice(1500, 1600), [60.0, 0.0, 0.0]))
    rows[1800:1900, SCHEMA.slices["push_n"]] = [0.0, 0.0, 90.0]
    assert reason(rows).startswith("pushed with 90 N to +z at 1.80 s; ")


@pytest.mark.parametrize(
    ("begin", "end", "over", "words"),
    [
        (1.5, 1.9, True, ", after an outage of the uplink from 1.50 s on for 0.40 s"),
        (1.5, 2.3, True, ", in an outage of the uplink from 1.50 s on for 0.80 s"),
        (1.5, 2.5, False, ", in an outage of the uplink from 1.50 s on that was not over"),
        (0.2, 0.6, True, ""),
        (2.2, 2.4, True, ""),
    ],
)
def test_an_outage_at_the_beginning_or_shortly_before_is_named(
    begin: float, end: float, over: bool, words: str
) -> None:
    outage = MetOutage("uplink", round(begin * S), round(end * S), over)
    age = "the answer in use was 4 ms old when the fall began at 2.00 s"
    assert reason(fallen(), outages=(outage,)) == age + words


def test_slip_torque_and_hold_before_the_robot_is_lost_are_named_in_their_order() -> None:
    rows = fallen(
        foot_slip_m=(slice(2050, 2500), [0.0, 0.02]),
        tau=(slice(2030, 2500), np.eye(31)[7] * -50.0),
        source=(slice(2010, 2500), float(Source.HELD)),
    )
    assert reason(rows).split("; ")[1:] == [
        "the joints held from 2.01 s on, without a usable answer",
        "joint7 at its torque limit from 2.03 s on",
        "the right foot slipped by 20 mm from 2.05 s on",
    ]


def test_consequences_of_a_fall_are_no_reason() -> None:
    late = slice(2150, 2500)
    rows = fallen(foot_slip_m=(late, 0.5), tau=(late, 50.0), source=(late, float(Source.HELD)))
    assert reason(rows).count(";") == 0


def test_the_age_of_a_factorisation_is_no_reason() -> None:
    rows = fallen(source=(slice(None), float(Source.CORRECTED)))
    assert reason(rows, "lc") == (
        "no push, outage, slip or clamped torque before; the correction itself was not enough"
    )


def test_a_robot_that_falls_at_once_has_a_reason_too() -> None:
    rows = fallen(com_error_m=(slice(None), np.nan))[:3]
    assert reason(rows) == "the answer in use was 4 ms old when the fall began at 0.00 s"


def test_torque_limits_are_those_of_the_actuators_by_joint(robot: Robot) -> None:
    limits = torque_limits(robot, clamp=1.45)
    assert len(limits) == robot.model.nv - 6
    assert list(limits.values()) == pytest.approx(1.45 * robot.effort_limit)
    index = robot.model.joints[robot.model.getJointId("LKneePitch")].idx_v - 6
    assert list(limits)[index] == "LKneePitch"


@pytest.mark.parametrize(
    ("force", "words"),
    [([0, 100, 0], "100 N to +y"), ([0, 0, -5.4], "5 N to -z"), ([30, 40, 0], "(30, 40, 0) N")],
)
def test_a_force_is_told_along_its_axis(force: list[float], words: str) -> None:
    assert force_in_words(np.array(force, dtype=float)) == words


def test_an_outage_lasts_from_its_beginning_to_its_end() -> None:
    outage = MetOutage("downlink", 5, 12, over=True)
    assert outage.duration_ns == 7
    assert dataclasses.replace(outage, over=False).in_words().endswith("that was not over")
