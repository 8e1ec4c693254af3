"""What the robot does when messages stop, get lost or come in disorder."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.lockstep import Lockstep
from experiments.studies.trial_sequence import outcome_of
from experiments.studies.workers import play as play_trial
from netem.profile import LOST
from shared.errors import LinkError, ProfileError
from shared.output.summary import summary_in_words

MS = 1_000_000
ONE_WAY_MS = 5.0
FOR_EVER = float("inf")


def steady(milliseconds):
    return np.full((2, milliseconds), ONE_WAY_MS)


def column(result, name):
    return result.schema.column(result.rows, name)


@pytest.fixture
def cut(trace):
    """A link that is cut for good after 0.5 s."""
    delays = steady(4000)
    delays[:, 500:] = LOST
    return trace(delays)


@pytest.fixture
def outage(trace):
    """A link that loses everything from 0.5 s to 1.0 s."""
    delays = steady(4000)
    delays[:, 500:1000] = LOST
    return trace(delays)


@pytest.mark.parametrize("controller", ["la", "pr"])
def test_when_the_link_is_cut_the_robot_goes_on_with_what_it_has(play, robot, cut, controller):
    result = play(
        duration=1.6,
        push=[],
        controller=controller,
        **{"link.network": cut, "loop.hold_after": FOR_EVER},
    )
    tau = column(result, "tau")
    assert np.isfinite(tau).all()
    assert np.all(np.abs(tau) <= 1.45 * robot.effort_limit)
    # Every tick has a command from the cache, and the cache only ages.
    cached = column(result, "source") == 1
    assert cached[10:].all()
    ages = column(result, "projector_age_ns")[520:]
    np.testing.assert_array_equal(np.diff(ages), 1 * MS)
    assert result.summary["task_seconds"] > 1.0


def test_a_robot_whose_link_is_cut_for_good_holds_its_joints_and_stands(play, cut):
    result = play(duration=2.0, push=[], **{"link.network": cut, "loop.hold_after": 0.1})
    # It sways by 2 cm. Entered late, after half a second of stale projectors, it may tip over.
    com_error = column(result, "com_error_m")
    assert not result.summary["fell"]
    assert com_error.max() < 0.04
    held = column(result, "source") == 2
    # From the limit on it is held for ever: no going back and forth.
    first = int(np.argmax(held & (column(result, "time_ns") >= 0)))
    assert held[first:].all()
    assert result.summary["commands"]["held"] > 1200


@pytest.mark.parametrize("controller", ["la", "pr"])
def test_half_a_second_of_holding_is_named_counted_and_stood(play, outage, controller):
    limit = 0.05
    result = play(
        duration=1.5,
        push=[],
        controller=controller,
        **{"link.network": outage, "loop.hold_after": limit},
    )
    summary = result.summary
    assert not summary["fell"]
    ages, held = column(result, "projector_age_ns"), column(result, "source") == 2
    in_task = column(result, "time_ns") >= 0
    # Held exactly where the projector is older than the limit.
    np.testing.assert_array_equal(held[in_task], ages[in_task] > limit * 1e9)
    assert summary["commands"]["held"] == int(held[in_task].sum())
    # 500 ms without a message, less the 50 ms limit, plus the round trip after it: about 460.
    assert 440 < summary["commands"]["held"] < 480
    # After the outage the answers are used again at once.
    assert not held[-300:].any()
    com = column(result, "com")[in_task]
    # A statue sways by millimetres; the support polygon ends 5 cm away.
    assert np.abs(com - com[0])[:, :2].max() < 0.02


@pytest.mark.parametrize(("robot_name", "slides"), [("romeo", 0.004), ("talos", 0.010)])
def test_a_long_hold_hardly_slides_does_not_topple_and_la_stands_after_it(play, robot_name, slides):
    # With gains that knew no inertia, Romeo slid by 10 mm a second, and Talos fell in the hold.
    # Half a second of an old projector lifts a foot of Talos. The hold sets it down 31 mm from its
    # place and, straightening the legs, draws it back by 8 mm.
    result = play(
        duration=3.0,
        push=[],
        **{
            "robot.name": robot_name,
            "link.network": "constant:2ms",
            "link.outage": ["2100ms@0.3s"],
        },
    )
    assert not result.summary["fell"]
    assert result.summary["commands"]["held"] > 1500
    held = np.flatnonzero((column(result, "source") == 2) & (column(result, "time_ns") > 0))
    slip = column(result, "foot_slip_m")[held[500:]]
    assert np.ptp(slip, axis=0).max() < slides
    assert column(result, "source")[-500:].max() != 2


def test_a_hold_in_the_middle_of_a_step_ends_the_walk_on_both_feet(play):
    # As a statue on one foot the robot fell in this hold.
    result = play(
        task="walk",
        duration=4.2,
        seed=4,
        **{"link.network": "constant:2ms", "link.outage": ["2050ms@0.9s"]},
    )
    assert not result.summary["fell"]
    mode, source = column(result, "mode"), column(result, "source")
    first = int(np.argmax((source == 2) & (column(result, "time_ns") > 0)))
    assert mode[first] != 0
    assert mode[-1] == 0
    # The plan stands at its end, and its CoM is above the feet where they are.
    assert column(result, "plan_time_ns")[-1] > column(result, "time_ns")[-1] + 1_000_000_000
    assert column(result, "com_error_m")[-1] < 0.03
    assert source[-500:].max() != 2


def test_during_an_outage_shorter_than_the_limit_nothing_is_held(play, outage):
    result = play(duration=1.5, push=[], **{"link.network": outage, "loop.hold_after": 0.6})
    assert result.summary["commands"]["held"] == 0
    assert not result.summary["fell"]
    assert result.summary["projector_age_ms"]["max"] > 480


def test_a_third_of_the_messages_may_be_lost(play):
    settings = {"link.network": "constant:20ms", "link.loss": 0.3}
    result = play(duration=1.5, push=["100N@0.2s:0.2s:+y"], **settings)
    assert not result.summary["fell"]
    for name in ("uplink", "downlink"):
        way = result.summary["link"][name]
        # Four standard deviations of the binomial.
        sent = way["sent"]
        assert abs(way["dropped_by_profile"] - 0.3 * sent) < 4 * np.sqrt(0.21 * sent)
        # Lost is what the receiver misses: the same but for messages on their way at the ends.
        assert way["lost"] == pytest.approx(way["dropped_by_profile"], abs=25)


def test_disorder_is_refused_as_stale_and_stood(play, trace):
    delays = np.ones((2, 2000))
    delays[:, ::3] = 6.0
    settings = {"link.network": trace(delays), "duration": 0.6, "push": []}
    overtaken = play(**settings, **{"link.keep_order": False})
    refused = overtaken.summary["link"]["downlink"]["refused"]
    assert set(refused) <= {"stale"}
    assert overtaken.summary["link"]["uplink"]["refused"]["stale"] > 100
    assert not overtaken.summary["fell"]
    ordered = play(**settings)
    assert ordered.summary["link"]["uplink"]["refused"] == {}
    # Whoever keeps order waits for the slowest: overtaking can only make answers younger.
    assert (
        overtaken.summary["projector_age_ms"]["max"] <= ordered.summary["projector_age_ms"]["max"]
    )


def test_ages_never_fall_back_to_an_older_answer(play, trace, rng):
    delays = rng.uniform(0.0, 20.0, size=(2, 2000))
    result = play(
        duration=0.6, push=[], **{"link.network": trace(delays), "link.keep_order": False}
    )
    in_task = column(result, "time_ns") >= 0
    stamps = column(result, "wall_ns")[in_task] - column(result, "projector_age_ns")[in_task]
    assert np.all(np.diff(stamps) >= 0)


def test_an_edge_that_answers_too_late_is_an_error_that_names_the_link(configured):
    config = configured(
        duration=0.2, **{"link.network": "constant:400ms", "loop.connect_timeout": 0.3}
    )
    with pytest.raises(LinkError, match=r"0\.3 s.*constant:400ms"):
        Lockstep(config).run()


def test_the_time_to_connect_is_just_enough_for_the_round_trip(play):
    result = play(
        duration=0.05, **{"link.network": "constant:100ms", "loop.connect_timeout": 0.102}
    )
    assert result.summary["task_seconds"] == 0.05


def test_a_profile_that_loses_everything_is_refused_before_the_trial(configured, trace):
    network = trace(np.full((2, 10), LOST))
    with pytest.raises(ProfileError, match="uplink messages that arrive, got only lost"):
        Lockstep(configured(**{"link.network": network}))


def test_a_fall_ends_the_trial(play):
    result = play(duration=5.0, push=["400N@0.05s:0.3s:+x"], **{"link.network": "direct"})
    assert result.summary["fell"]
    assert result.summary["task_seconds"] < 3.0
    assert len(result.rows) == round(result.summary["task_seconds"] * 1e3)


def test_a_robot_whose_answers_are_all_too_old_names_their_age_and_the_remedy(configured):
    config = configured(**{"link.network": "constant:600ms", "loop.connect_timeout": 0.7})
    expected = r"at most 500 ms .*the youngest was 60\d ms old; try --controller lc"
    trial = Lockstep(config)
    with pytest.raises(LinkError, match=expected):
        trial.run()
    # A live robot tells it from this age.
    assert trial.robot.youngest_answer_ns == pytest.approx(600.5 * MS, abs=MS)


def test_a_link_that_passes_nothing_is_named(configured):
    config = configured(**{"link.outage": ["cut@0s"], "loop.connect_timeout": 0.1})
    with pytest.raises(LinkError, match="the uplink lost 101 of 101 states, and none arrived"):
        Lockstep(config).run()


def test_the_summary_tells_the_span_of_the_profile_and_the_worst_outage_met(play, trace):
    delays = steady(4000)
    delays[0, 500:1000] = LOST
    network = trace(delays)
    result = play(duration=2.0, push=[], **{"link.network": network, "loop.hold_after": FOR_EVER})
    played, worst = result.summary["played"], result.summary["worst_outage"]
    # The profile is rotated, so that the run begins at its first row. The task begins 10 ms later.
    begins = result.summary["profile_begins_s"]
    assert (played["seconds"], played["share"]) == (2.0, 0.5)
    assert played["from_s"] == pytest.approx((begins + 0.010) % 4.0, abs=0.001)
    assert (worst["direction"], worst["over"]) == ("uplink", True)
    assert worst["ms"] == pytest.approx(500.0, abs=1.0)
    assert worst["at_s"] == pytest.approx(0.505 - 0.010, abs=0.001)
    assert worst["profile_at_s"] == pytest.approx((begins + 0.505) % 4.0, abs=0.001)
    words = summary_in_words(result.summary).splitlines()
    assert words[0].startswith("Stands after 2.00 s of balance with LA over ")
    assert words[1].startswith("  played 2.00 s of the profile's 4 s, from ")
    assert "worst outage met 500 ms (uplink, at 0." in words[1]
    assert "cached (an older answer, applied to fresh feedback)" in words[3]


def test_the_summary_tells_the_worst_outage_of_the_profile_that_was_not_met(play, trace):
    delays = steady(2000)
    delays[0, 500:520] = delays[1, 1100:1500] = LOST
    link = {"link.network": trace(delays), "loop.hold_after": FOR_EVER}
    summary = play(duration=1.0, push=[], **link).summary
    # The profile is rotated, so that the run begins at its first row.
    at_s = (summary["profile_begins_s"] + 1.105) % 2.0
    worst = summary["profile_worst_outage"]
    assert worst == {"direction": "downlink", "ms": 400.0, "at_s": pytest.approx(at_s)}
    assert summary["worst_outage"]["ms"] == pytest.approx(20.0, abs=1.0)
    assert summary_in_words(summary).splitlines()[2] == (
        f"  not met: the profile's worst outage, 400 ms (downlink, at {at_s:.2f} s of the "
        f"profile); try --network-start {max(0.0, at_s - 1.0):.2f}s"
    )
    whole = play(duration=1.6, push=[], **link).summary
    assert "not met" not in summary_in_words(whole)


def test_a_fall_has_its_reason(play, cut):
    result = play(
        duration=2.5, controller="pr", push=["100N@0.5s:0.2s:+y"], **{"link.network": cut}
    )
    reason = result.summary["fall_reason"]
    assert reason.startswith("pushed with 100 N to +y at 0.50 s; the torques in use were ")
    assert ", in an outage of the uplink from 0.50 s on that was not over" in reason
    words = summary_in_words(result.summary).splitlines()
    assert words[0].startswith("FELL after ")
    assert words[1] == f"  reason: {reason}"


def test_a_robot_that_has_only_held_its_joints_is_no_result_about_the_link(configured, trace):
    """The first answer is in time, and no later one."""
    delays = np.full((2, 4000), 2_000.0)
    delays[:, :3] = 1.0
    config = configured(duration=1.0, push=[], **{"link.network": trace(delays)})
    result = Lockstep(config).run()
    assert (result.summary["fell"], result.summary["valid"]) == (False, False)
    words = summary_in_words(result.summary)
    assert words.startswith("NO RESULT about the link: no answer was ever fresh enough: ")
    # No study counts it.
    record = play_trial(config, False)
    assert record["error"].startswith("no result about the link: no answer was ever fresh enough")
    assert outcome_of(record["error"], record["summary"]) == "error"


def test_a_sound_trial_is_a_result(play):
    summary = play(duration=0.05, **{"link.network": "constant:4ms"}).summary
    assert (summary["valid"], summary["invalid_reasons"], summary["fall_reason"]) == (
        True,
        [],
        None,
    )
    assert summary["worst_outage"]["ms"] == 0.0
    assert "met no outage above 10 ms" in summary_in_words(summary)
