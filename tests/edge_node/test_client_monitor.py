from __future__ import annotations

import pytest

from edge_node.client_monitor import ClientMonitor

MS = 1_000_000


@pytest.fixture
def monitor() -> ClientMonitor:
    return ClientMonitor()


def test_a_robot_is_announced_once_when_it_comes(monitor):
    assert monitor.look(0, heard=False, refused={}) == []
    assert monitor.look(1 * MS, heard=True, refused={}) == ["a robot is sending states"]
    assert monitor.look(2 * MS, heard=True, refused={}) == []


def test_a_pause_shorter_than_a_second_is_no_departure(monitor):
    monitor.look(0, heard=True, refused={})
    assert monitor.look(999 * MS, heard=False, refused={}) == []
    assert monitor.look(1000 * MS, heard=True, refused={}) == []


def test_after_a_second_of_silence_it_has_gone_and_the_next_one_is_announced(monitor):
    monitor.look(0, heard=True, refused={})
    (gone,) = monitor.look(1001 * MS, heard=False, refused={})
    assert "waiting for a robot" in gone
    assert monitor.look(3000 * MS, heard=False, refused={}) == []
    assert monitor.look(4000 * MS, heard=True, refused={}) == ["a robot is sending states"]


def test_each_reason_for_refusing_is_told_once_a_visit_with_what_to_do(monitor):
    monitor.look(0, heard=True, refused={})
    (message,) = monitor.look(1 * MS, heard=True, refused={"config": 1})
    assert "refuses a robot's states (config)" in message
    assert "use one --config at both ends" in message
    assert monitor.look(2 * MS, heard=True, refused={"config": 2}) == []
    (message,) = monitor.look(3 * MS, heard=True, refused={"config": 3, "shape": 1})
    assert "(shape)" in message


def test_what_an_earlier_visitor_did_is_not_told_of_the_next(monitor):
    monitor.look(0, heard=True, refused={"config": 5})
    monitor.look(2000 * MS, heard=False, refused={"config": 5})
    assert len(monitor.look(3000 * MS, heard=True, refused={"config": 5})) == 1
    assert len(monitor.look(3001 * MS, heard=True, refused={"config": 6})) == 1


def test_two_robots_of_one_name_are_reported_each_time_that_they_meet(monitor):
    monitor.look(0, heard=True, refused={})
    for _ in range(2):
        lines = monitor.look(1 * MS, heard=True, refused={}, shared=1)
    assert lines == []
    (line,) = monitor.look(2 * MS, heard=True, refused={}, shared=2)
    assert "two robots send states under this name" in line
    assert "--name" in line


def test_a_session_that_begins_anew_is_reported_once(monitor):
    monitor.look(0, heard=True, refused={})
    (line,) = monitor.look(1 * MS, heard=True, refused={}, renewed=1)
    assert "far ahead" in line
    assert monitor.look(2 * MS, heard=True, refused={}, renewed=2) == []


@pytest.mark.parametrize("reason", ["limits", "ahead", "crowded"])
def test_refusals_of_states_that_cannot_be_have_a_hint(monitor, reason):
    monitor.look(0, heard=True, refused={})
    (line,) = monitor.look(1 * MS, heard=True, refused={reason: 1})
    assert f"({reason})" in line
    assert "docs/wire.md" not in line
