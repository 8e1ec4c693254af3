from __future__ import annotations

import pytest

from edge_node.client_monitor import Visits

MS = 1_000_000


@pytest.fixture
def visits() -> Visits:
    return Visits()


def test_a_robot_is_announced_once_when_it_comes(visits):
    assert visits.look(0, heard=False, refused={}) == []
    assert visits.look(1 * MS, heard=True, refused={}) == ["a robot is sending states"]
    assert visits.look(2 * MS, heard=True, refused={}) == []


def test_a_pause_shorter_than_a_second_is_no_departure(visits):
    visits.look(0, heard=True, refused={})
    assert visits.look(999 * MS, heard=False, refused={}) == []
    assert visits.look(1000 * MS, heard=True, refused={}) == []


def test_after_a_second_of_silence_it_has_gone_and_the_next_one_is_announced(visits):
    visits.look(0, heard=True, refused={})
    (gone,) = visits.look(1001 * MS, heard=False, refused={})
    assert "waiting for a robot" in gone
    assert visits.look(3000 * MS, heard=False, refused={}) == []
    assert visits.look(4000 * MS, heard=True, refused={}) == ["a robot is sending states"]


def test_each_reason_for_refusing_is_told_once_a_visit_with_what_to_do(visits):
    visits.look(0, heard=True, refused={})
    (told,) = visits.look(1 * MS, heard=True, refused={"config": 1})
    assert "refuses a robot's states (config)" in told
    assert "use one --config at both ends" in told
    assert visits.look(2 * MS, heard=True, refused={"config": 2}) == []
    (told,) = visits.look(3 * MS, heard=True, refused={"config": 3, "shape": 1})
    assert "(shape)" in told


def test_what_an_earlier_visitor_did_is_not_told_of_the_next(visits):
    visits.look(0, heard=True, refused={"config": 5})
    visits.look(2000 * MS, heard=False, refused={"config": 5})
    assert len(visits.look(3000 * MS, heard=True, refused={"config": 5})) == 1
    assert len(visits.look(3001 * MS, heard=True, refused={"config": 6})) == 1
