from __future__ import annotations

import argparse
import errno
import json
import os
from pathlib import Path

import pytest

from deploy.keys import make
from shared.errors import ConfigError
from shared.process import service
from shared.process.service import ServiceLog, add_identity_arguments, identity_from
from shared.telemetry.parquet import read_parquet
from shared.telemetry.row_log import read_rows
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
    monkeypatch.setattr(service, "MAX_ROWS", 3)
    log = ServiceLog("edge", Schema(Column("n")), out=tmp_path, telemetry=None, key="k")
    for number in range(10):
        log.row()[0] = number
    log.finish(lambda rows: {"rows": len(rows)})
    _, rows = read_parquet(tmp_path / "edge.parquet")
    assert rows[:, 0].tolist() == [0.0, 1.0, 2.0]


def test_a_service_may_have_another_log_beside_its_own(tmp_path: Path):
    log = ServiceLog("robot", Schema(Column("n")), out=tmp_path, telemetry=None, key="k")
    other = log.beside("steps", Schema(Column("n"), Column("m", 2)), key="l")
    log.row()[0] = 1.0
    other.row()[:] = 2.0
    assert (tmp_path / "steps.rows").exists()
    log.finish(lambda rows: {"rows": len(rows)})
    assert read_parquet(tmp_path / "robot.parquet")[1].tolist() == [[1.0]]
    assert read_parquet(tmp_path / "steps.parquet")[1].tolist() == [[2.0, 2.0, 2.0]]
    assert {file.name for file in tmp_path.iterdir()} == {
        "robot.json",
        "robot.parquet",
        "steps.parquet",
    }


def full_disk(monkeypatch: pytest.MonkeyPatch, name: str, *, times: int = 10**9) -> None:
    """Let writing of a file fail, the first times."""
    left = [times]
    write_text = Path.write_text

    def refuse(path: Path, *arguments, **options):
        if path.name == name and left[0] > 0:
            left[0] -= 1
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        return write_text(path, *arguments, **options)

    monkeypatch.setattr(Path, "write_text", refuse)


def test_a_disk_without_room_for_the_table_keeps_the_report_and_the_rows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "edge.parquet.part").symlink_to("/dev/full")
    log = ServiceLog("edge", Schema(Column("n")), out=tmp_path, telemetry=None, key="k")
    log.row()[0] = 1.0
    assert log.finish(lambda rows: {"rows": len(rows)}) == {"rows": 1}
    (line,) = capsys.readouterr().out.splitlines()
    assert "cannot write all of edge's files" in line
    assert "No space left on device; free space" in line
    assert json.loads((tmp_path / "edge.json").read_text()) == {"rows": 1}
    assert read_rows(tmp_path / "edge.rows")[1].tolist() == [[1.0]]
    assert not (tmp_path / "edge.parquet").exists()
    assert not Path(log._temporary.name).exists()


def test_rows_give_way_to_the_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    full_disk(monkeypatch, "edge.json", times=1)
    monkeypatch.setattr(service, "_ROOM_BYTES", 16)
    log = ServiceLog("edge", Schema(Column("n")), out=tmp_path, telemetry=None, key="k")
    for number in range(10):
        log.row()[0] = number
    log.finish(lambda rows: {"rows": len(rows)})
    assert json.loads((tmp_path / "edge.json").read_text()) == {"rows": 10}
    _, rows = read_parquet(tmp_path / "edge.parquet")
    assert rows[:, 0].tolist() == list(range(8))


def test_a_disk_without_any_room_still_gives_the_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    full_disk(monkeypatch, "edge.json")
    log = ServiceLog("edge", Schema(Column("n")), out=tmp_path, telemetry=None, key="k")
    log.row()[0] = 1.0
    assert log.finish(lambda rows: {"rows": len(rows)}) == {"rows": 1}
    assert len(capsys.readouterr().out.splitlines()) == 1


def test_the_next_process_keeps_the_files_of_the_one_before(tmp_path: Path):
    for life in (1.0, 2.0):
        log = ServiceLog("edge", Schema(Column("n")), out=tmp_path, telemetry=None, key="k")
        log.row()[0] = life
        log.finish(lambda rows: {"rows": len(rows)})
    for name, life in (("edge.1", 1.0), ("edge", 2.0)):
        assert read_parquet(tmp_path / f"{name}.parquet")[1].tolist() == [[life]]
        assert (tmp_path / f"{name}.json").exists()


def test_an_edge_may_have_several_names_and_a_robot_has_one(parse):
    me = identity_from(parse("--name", "amy, ben,amy"), role="edge", kind="romeo", several=True)
    assert me.robots == ("amy", "ben")
    for name in ("amy,ben", "amy,"):
        with pytest.raises(ConfigError, match="name"):
            identity_from(parse("--name", name), role=None, kind="romeo")
    with pytest.raises(ConfigError, match="name"):
        identity_from(parse("--name", "amy,"), role="edge", kind="romeo", several=True)
