"""The outages that a run has met, from the shim's rows."""

from __future__ import annotations

import numpy as np
import pytest

from shared.output.link_met import DIRECTIONS, LinkMet, link_met
from shared.telemetry.schema import LINK_SCHEMA, SOLVE_SCHEMA, tick_schema

TICKS = tick_schema(nq=38, nv=37)
MS = 1_000_000
LOST = -1
# The robot waits for its first answer for 5 ms, and its clock began long ago.
BEGUN, WAITED = 7_000_000 * MS, 5


def robot(ticks: int = 1000) -> np.ndarray:
    rows = np.zeros((ticks + WAITED, TICKS.width))
    k = np.arange(len(rows))
    rows[:, TICKS.slices["wall_ns"]] = (BEGUN + k * MS)[:, None]
    rows[:, TICKS.slices["time_ns"]] = np.where(k < WAITED, -1, (k - WAITED) * MS)[:, None]
    return rows


def sent(direction: int, at_ms: np.ndarray, delay_ms: np.ndarray) -> np.ndarray:
    rows = np.zeros((len(at_ms), LINK_SCHEMA.width))
    rows[:, LINK_SCHEMA.slices["direction"]] = direction
    rows[:, LINK_SCHEMA.slices["wall_ns"]] = (BEGUN + at_ms * MS)[:, None]
    ns = np.where(delay_ms < 0, LOST, delay_ms * MS)
    rows[:, LINK_SCHEMA.slices["achieved_ns"]] = ns[:, None]
    return rows


def link(uplink_ms: np.ndarray, downlink_ms: np.ndarray) -> np.ndarray:
    """A message each way in each millisecond, with these delays; NaN: still under way."""
    rows = []
    for direction, delays in enumerate((uplink_ms, downlink_ms)):
        known = np.flatnonzero(np.isfinite(delays))
        rows.append(sent(direction, known, delays[known]))
    return np.concatenate(rows)


def solves(count: int = 1005) -> np.ndarray:
    rows = np.zeros((count, SOLVE_SCHEMA.width))
    rows[:, SOLVE_SCHEMA.slices["wall_ns"]] = (BEGUN + np.arange(count) * MS)[:, None]
    return rows


def sound() -> np.ndarray:
    return np.full(1005, 2.0)


def stalled(begin: int, end: int) -> np.ndarray:
    """A sound direction in which messages wait for the end of an outage [ms]."""
    delays = sound()
    waiting = np.arange(begin, min(end, len(delays)))
    delays[waiting] = end - waiting + 2.0
    return delays


def lost(begin: int, end: int) -> np.ndarray:
    delays = sound()
    delays[begin:end] = LOST
    return delays


def met(uplink: np.ndarray, downlink: np.ndarray, *, steady: bool = True) -> LinkMet:
    found = link_met(TICKS, robot(), link(uplink, downlink), solves(), steady=steady)
    assert found is not None
    return found


def spans(found: LinkMet) -> list[tuple[str, float, float, bool]]:
    return [(o.direction, o.begin_ns / MS, o.end_ns / MS, o.over) for o in found.outages]


def test_a_sound_link_has_no_outage_and_the_task_its_place_in_the_profile() -> None:
    found = met(sound(), sound())
    assert (found.outages, found.worst) == ((), None)
    assert (found.task_begins_ns, found.lasted_ns) == (WAITED * MS, 1000 * MS)


@pytest.mark.parametrize("outage", [stalled, lost])
@pytest.mark.parametrize("direction", [0, 1])
def test_an_outage_is_met_whether_messages_wait_or_are_lost(outage, direction: int) -> None:
    ways = [sound(), sound()]
    ways[direction] = outage(300, 400)
    [(name, begin, end, over)] = spans(met(*ways))
    assert (name, over) == (DIRECTIONS[direction], True)
    # Times are of the task. A message takes 2 ms, and one is sent each millisecond.
    assert begin == pytest.approx(300 + 2 - WAITED, abs=1)
    assert end == pytest.approx(400 + 2 - WAITED, abs=1)


@pytest.mark.parametrize("rest", [np.nan, float(LOST)])
@pytest.mark.parametrize("direction", [0, 1])
def test_an_outage_that_lasts_until_the_end_is_not_over(direction: int, rest: float) -> None:
    ways = [sound(), sound()]
    ways[direction][600:] = rest
    [(name, begin, end, over)] = spans(met(*ways))
    assert (name, over, end) == (DIRECTIONS[direction], False, 1000)
    assert begin == pytest.approx(600 + 2 - WAITED, abs=1)


def test_a_message_that_came_after_the_end_does_not_make_the_outage_longer_than_the_run() -> None:
    [(_, _, end, over)] = spans(met(stalled(900, 1500), sound()))
    assert (end, over) == (1000, False)


def test_the_worst_outage_is_the_longest() -> None:
    found = met(stalled(300, 400), stalled(500, 650))
    assert found.worst is not None
    assert found.worst.direction == "downlink"


def test_jitter_is_no_outage() -> None:
    assert met(stalled(300, 309), sound()).outages == ()


def test_a_long_delay_is_no_outage_at_the_end() -> None:
    """With 300 ms of delay the last 300 states are still under way, as at every other moment."""
    slow = np.full(1005, 300.0)
    slow[705:] = np.nan
    assert met(slow, sound()).outages == ()


def test_an_edge_that_has_nothing_to_send_is_no_outage() -> None:
    """LC gets few answers."""
    few = np.full(1005, np.nan)
    few[[10, 700]] = 2.0
    rows = link(sound(), few)
    found = link_met(TICKS, robot(), rows, solves()[[10, 700]], steady=False)
    assert found is not None
    assert found.outages == ()


def test_without_messages_or_without_a_task_nothing_is_met() -> None:
    rows = link(sound(), sound())
    assert link_met(TICKS, robot(), rows[:0], solves(), steady=True) is None
    assert link_met(TICKS, robot(0), rows, solves(), steady=True) is None
