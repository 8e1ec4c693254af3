from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from deploy.keys import make
from shared.errors import ConfigError
from shared.process import service
from shared.process.service import ServiceLog, add_identity_arguments, identity_from
from shared.telemetry.parquet import read_parquet
from shared.telemetry.schema import Column, Schema


@pytest.fixture
def parse():
    parser = argparse.ArgumentParser()
    add_identity_arguments(parser)
    return lambda *arguments: parser.parse_args(list(arguments))


def test_a_robot_without_a_name_has_that_of_its_kind_and_nothing_is_secured(parse):
    me = identity_from(parse(), role="edge", kind="romeo")
    assert (me.robot, me.credentials) == ("romeo", None)


def test_a_name_is_on_the_link_and_in_the_robots_certificate(parse, tmp_path: Path):
    make(tmp_path, robots=["amy"])
    me = identity_from(parse("--name", "amy", "--secure", str(tmp_path)), role=None, kind="romeo")
    assert me.robot == "amy"
    assert me.credentials is not None
    assert (me.credentials.role, me.credentials.robots) == ("robot-amy", ("amy",))


def test_a_name_that_cannot_be_in_a_key_is_refused_even_without_certificates(parse):
    with pytest.raises(ConfigError, match="name: expected"):
        identity_from(parse("--name", "a/**"), role="edge", kind="romeo")


def test_a_log_that_is_full_takes_no_more_rows(monkeypatch, tmp_path: Path):
    monkeypatch.setattr(service, "_MAX_ROWS", 3)
    log = ServiceLog("edge", Schema(Column("n")), out=tmp_path, telemetry=None, key="k")
    for number in range(10):
        log.row()[0] = number
    log.finish(lambda rows: {"rows": len(rows)})
    _, rows = read_parquet(tmp_path / "edge.parquet")
    assert rows[:, 0].tolist() == [0.0, 1.0, 2.0]


@pytest.mark.parametrize("full", ["edge.rows", "edge.parquet", "edge.json"])
def test_a_full_disk_is_told_in_one_line_after_what_could_be_done(full: str, tmp_path: Path):
    (tmp_path / full).symlink_to("/dev/full")
    log = ServiceLog("edge", Schema(Column("n")), out=tmp_path, telemetry=None, key="k")
    log.row()[0] = 1.0
    with pytest.raises(ConfigError, match=r"out: cannot write all of edge's .* No space left"):
        log.finish(lambda rows: {"rows": len(rows)})
    assert not Path(log._temporary.name).exists()
