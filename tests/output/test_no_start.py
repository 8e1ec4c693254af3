"""A robot that does not begin says why, in one line with a remedy."""

from __future__ import annotations

from typing import Any

import pytest

from shared.config.config_file import load_config
from shared.output.no_start import why_not_begun

SENT = 2000


def why(up: dict[str, Any], down: dict[str, Any], controller: str = "la", **parts: Any) -> str:
    """`up` and `down` change a link on which every message passes."""
    ways = {
        "uplink": {"sent": SENT, "received": SENT, "refused": {}, **up},
        "downlink": {"sent": SENT, "received": SENT, "refused": {}, **down},
    }
    summary = {"network": "factory/001", "youngest_answer_ms": None, "link": ways, **parts}
    return why_not_begun(summary, load_config(None, {"controller": controller}))


def test_answers_that_are_too_old_name_the_limit_their_age_and_a_controller_that_stands() -> None:
    text = why({}, {}, youngest_answer_ms=1000.8)
    assert "at most 500 ms (loop.hold_after), the youngest was 1001 ms old" in text
    assert "try --controller lc" in text


def test_a_capacity_below_the_answers_is_told_as_the_reason_of_their_age() -> None:
    down = {"received": 8, "bytes_per_message": {"p50": 28_309.0, "max": 28_309.0}}
    text = why({}, down, youngest_answer_ms=600.0, network="capacity:mine.csv")
    assert "the downlink carried 8 of 2000 messages of 28309 B" in text
    assert "carried" not in why({}, down, youngest_answer_ms=600.0)


@pytest.mark.parametrize(
    ("check", "remedy"),
    [
        ("config", "use one --config at both ends"),
        ("plan", "use one version of the software at both ends"),
        ("version", "use one version of the software at both ends"),
        ("session", "end the other robot of this name"),
        ("not_finite", "docs/wire.md describes this check"),
    ],
)
def test_refused_messages_name_the_check_and_the_remedy_at_either_end(
    check: str, remedy: str
) -> None:
    refused = {"refused": {"stale": 9, check: 7}}
    for text, end in (
        (why({}, refused), "robot"),
        (why(refused, {"sent": 0, "received": 0}), "edge"),
    ):
        assert text.startswith(f"the {end} refused messages (7 by the check {check}); {remedy}")


NOTHING = {"received": 0}


@pytest.mark.parametrize(
    ("up", "down", "words"),
    [
        ({"received": 0, "dropped_by_profile": SENT}, {"sent": 0, **NOTHING}, "the uplink lost"),
        ({}, {**NOTHING, "dropped_by_profile": 1900}, "the downlink lost 1900 of 2000 answers"),
        ({"sent": 0, **NOTHING}, {"sent": 0, **NOTHING}, "the run ended before any states"),
        (NOTHING, {"sent": 0, **NOTHING}, "none of 2000 states came out of the uplink before"),
        ({}, NOTHING, "none of 2000 answers came out of the downlink before"),
        ({}, {"sent": 0, **NOTHING}, "the edge received 2000 states and has not answered yet"),
        ({"received": None}, {"sent": None, **NOTHING}, "no answer came; the edge's own output"),
    ],
)
def test_where_messages_get_lost_is_told(
    up: dict[str, Any], down: dict[str, Any], words: str
) -> None:
    assert why(up, down).startswith(words)


@pytest.mark.parametrize("received", [0, 6])
def test_a_queue_smaller_than_a_message_is_told(received: int) -> None:
    size = {"bytes_per_message": {"p50": 300.0, "max": 31_000_000.0}}
    text = why({}, {"received": received, "dropped_by_profile": 20, **size}, "lc")
    assert text.startswith("the downlink has no room for a message: 31000000 B, but link.queue_by")


def test_answers_without_the_part_that_the_controller_needs_are_told() -> None:
    assert "without a projector for the robot's contact mode" in why({}, {})
    assert "without a factorisation for the robot's contact mode" in why({}, {}, "lc")


def test_an_edge_without_a_solution_names_the_outcomes() -> None:
    text = why({}, {"sent": 0, **NOTHING}, edge_solves={"infeasible": 12})
    assert text.startswith("the edge found no solution (12 infeasible)")
