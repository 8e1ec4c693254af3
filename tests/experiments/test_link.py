"""`wbc link`: windows cover the link, worst moments get the push, and the verdict says where."""

from __future__ import annotations

import argparse
import re
from typing import Any

import numpy as np
import pytest

from experiments.link import (
    LinkOutage,
    add_link_arguments,
    apart,
    falls,
    link_outages,
    run_link,
    study_of,
    table,
    verdicts,
    window_starts,
)
from netem.profile import LOST, DelayProfile
from netem.profile_file import write_profile
from shared.errors import ConfigError

MS = 1_000_000


def profile(*, seconds: float = 12.0, dead: tuple[float, float] | None = None) -> DelayProfile:
    """A sound link of 2 ms each way, with a span in which everything is lost."""
    delays = np.full((2, round(seconds * 1e3)), 2 * MS)
    if dead is not None:
        delays[:, round(dead[0] * 1e3) : round(dead[1] * 1e3)] = LOST
    return DelayProfile("mine", delays)


def starts_of(link: DelayProfile, **changes: Any) -> dict[str, float]:
    options = {"window": 5.0, "push_at": 1.0, "covering": True, **changes}
    return window_starts(link, apart(link_outages(link)), **options)


def row(controller: str, start: float, *, fell: bool, seconds: float = 5.0) -> dict[str, Any]:
    return {
        "controller": controller,
        "cell": f"from {start:g} s",
        "start": start,
        "fell": fell,
        "task_seconds": seconds,
        "projector_age_ms.max": 12.0,
        "worst_outage.ms": 400.0 if start == 5.0 else 0.0,
        "fall_reason": "pushed" if fell else None,
        "error": None,
    }


@pytest.mark.parametrize("seconds", [3.0, 5.0, 12.0, 20.0])
def test_windows_cover_the_link(seconds: float) -> None:
    covered = np.zeros(round(seconds * 10), dtype=bool)
    for start in starts_of(profile(seconds=seconds)).values():
        assert 0.0 <= start <= max(0.0, seconds - 5.0)
        covered[round(start * 10) : round((start + 5.0) * 10)] = True
    assert covered.all()


def test_the_push_comes_at_the_beginning_of_a_long_outage() -> None:
    link = profile(dead=(7.0, 7.4))
    starts = starts_of(link, covering=False)
    # Both directions are out at once, which is one window.
    assert list(starts) == ["push at 7 s, uplink out for 400 ms"]
    assert starts["push at 7 s, uplink out for 400 ms"] == pytest.approx(6.0)


def test_a_sound_link_has_no_worst_moments() -> None:
    with pytest.raises(ConfigError, match="--quick: expected a link with outages"):
        starts_of(profile(), covering=False)


def test_outages_that_overlap_a_longer_one_are_left_out() -> None:
    long, beside, later = (
        LinkOutage("uplink", 1.0, 0.5),
        LinkOutage("downlink", 1.1, 0.3),
        LinkOutage("downlink", 4.0, 0.1),
    )
    assert apart([long, beside, later]) == [long, later]


def test_the_verdict_says_where_on_the_link_each_controller_falls_and_why() -> None:
    link = profile(dead=(7.0, 7.4))
    rows = [
        row("pr", 0.0, fell=False),
        row("pr", 5.0, fell=True, seconds=2.6),
        row("lc", 0.0, fell=False),
        row("lc", 5.0, fell=False),
        {**row("lc", 7.0, fell=False), "error": "no result about the link: it never began"},
    ]
    assert verdicts(rows, link) == [
        "PR falls in 1 of 2 windows, first at 7.60 s of the link.",
        "LC stands in all 2 windows.",
        "LC, from 7 s: not counted: no result about the link: it never began",
    ]
    lines = table(rows)
    assert lines[1].split() == ["PR", "2", "1", "400", "ms", "12", "ms"]
    fall = falls(rows, link)[-1]
    assert re.split("  +", fall) == ["PR", "7.60 s", "from 5 s", "400 ms", "pushed"]
    assert falls(rows[2:], link) == []


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"window": 1.0}, "--window: expected 2 to 3600 s, got 1"),
        ({"push": "100N@6.0s:0.2s:+y"}, "--push: expected a push within the window of 5 s"),
        ({"controllers": ["pid"]}, "la.*lc.*pr.*'pid'"),
    ],
)
def test_what_cannot_be_played_is_refused(changes: dict[str, Any], message: str) -> None:
    options = {"controllers": ["lc"], "window": 5.0, "push": "100N@1.0s:0.2s:+y", **changes}
    with pytest.raises(ConfigError, match=message):
        study_of("constant:4ms", starts={"from 0 s": 0.0}, **options)


def test_a_link_that_dies_fells_pr_and_not_lc(tmp_path, capsys) -> None:
    file = tmp_path / "mine.npz"
    write_profile(profile(seconds=4.0, dead=(1.2, 2.6)), file)
    parser = argparse.ArgumentParser()
    add_link_arguments(parser)
    typed = [str(file), "--controller", "pr", "lc", "--window", "3", "--quick"]
    arguments = parser.parse_args([*typed, "--out", str(tmp_path / "out")])
    assert run_link(arguments) == 0
    shown = capsys.readouterr().out
    assert "PR falls in 1 of 1 windows" in shown
    reason = r"push at 1.2 s.* ms +pushed with 100 N to \+y at 1.00 s; the torques in use were"
    assert re.search(reason, shown), shown
    assert "in an outage of the uplink from 1.00 s on" in shown
    assert "LC stands in all 1 windows" in shown
    assert (tmp_path / "out" / "link.png").stat().st_size > 10_000
    # Nothing is played a second time.
    before = (tmp_path / "out" / "trials.jsonl").read_bytes()
    assert run_link(arguments) == 0
    assert (tmp_path / "out" / "trials.jsonl").read_bytes() == before
