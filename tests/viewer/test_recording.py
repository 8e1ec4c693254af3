"""`record`: a run's folder becomes a recording, or one line that says what is wrong with it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from shared.config.config_file import dump_config
from shared.config.settings import RunConfig
from shared.errors import UserError
from shared.process.entry import python
from shared.robots import Robot
from shared.telemetry.parquet import write_parquet
from tests.processes import played
from tests.viewer.reading import entities, logged, static
from tests.viewer.synthetic import link_rows, solve_rows, step_rows, tick_rows
from viewer.meshes import load_meshes
from viewer.recording import record
from viewer.run_folder import read_run


@pytest.fixture(autouse=True)
def own_cache(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))


@pytest.fixture
def run(robot: Robot, tmp_path: Path) -> Path:
    """The folder of a short run, with all of its tables."""
    config = dump_config(RunConfig(), versions={})
    (tmp_path / "config.toml").write_text(config, encoding="utf-8")
    write_parquet(*tick_rows(robot, 300, waiting=50), tmp_path / "telemetry.parquet")
    write_parquet(*link_rows(300, lost_every=100), tmp_path / "link.parquet")
    write_parquet(*solve_rows(300), tmp_path / "edge.parquet")
    return tmp_path


def test_a_run_becomes_a_recording_with_robot_plots_and_layout(run: Path, robot: Robot) -> None:
    recorded = record(run)
    assert recorded.path == run / "recording.rrd"
    assert recorded.size_bytes == recorded.path.stat().st_size > 1_000_000, "meshes are in it"
    assert recorded.rows == 300 + 600 + 300
    expected = {
        *("/world/joints", "/world/contact_forces", "/world/support_polygon", "/world/com"),
        *("/world/com_reference", "/world/push", "/world/ghost_joints", "/world/friction_cones"),
        *("/world/centre_of_pressure", "/plots/delay/uplink", "/plots/delay/downlink/lost"),
        *("/plots/projector_age", "/plots/compute/solve", "/soles_at_a_limit/left_foot"),
        *("/robot/command", "/robot/planned_contact", "/link/uplink", "/link/downlink"),
    }
    assert expected <= entities(recorded.path)
    assert len(RrdReader(recorded.path).blueprints()) == 1
    assert not (run / "recording.rrd.partial").exists()


def test_every_mesh_hangs_on_the_joint_that_carries_it(run: Path, robot: Robot) -> None:
    path = record(run).path
    for mesh in load_meshes(robot):
        entity = f"/world/robot/{mesh.name}"
        (parent,) = static(path, entity, "Transform3D:parent_frame")
        assert parent == [f"world/robot/{robot.model.names[mesh.joint]}"]
        (blob,) = static(path, entity, "Asset3D:blob")
        assert bytes(blob[0]) == mesh.glb


def test_a_run_without_a_link_or_an_edge_is_recorded_too(run: Path) -> None:
    (run / "link.parquet").unlink()
    (run / "edge.parquet").unlink()
    assert record(run).rows == 300


def test_a_run_with_footprints_has_them_in_its_recording(run: Path) -> None:
    write_parquet(*step_rows(), run / "steps.parquet")
    recorded = record(run)
    assert recorded.rows == 300 + 600 + 300 + 8
    # Within the 250 ms of the task; before it the robot waits.
    times, soles = logged(recorded.path, "/world/landed_soles", "LineStrips3D:strips")
    assert times[-1] == 100_000_000
    assert len(soles[-1]) == 3


def test_the_rows_of_a_long_run_are_read_in_parts(run: Path) -> None:
    schema, rows = link_rows(300)
    write_parquet(schema, np.tile(rows, (100, 1)), run / "link.parquet")
    read = read_run(run)
    chunks = [len(rows) for _, rows in read.chunks()]
    assert sum(chunks) == read.rows == 300 + 60_000 + 300
    assert max(chunks) <= 20_000


def spoil_config(run: Path) -> None:
    (run / "config.toml").write_text("[robot]\nname = 'c3po'\n")


def remove_telemetry(run: Path) -> None:
    (run / "telemetry.parquet").unlink()


def spoil_telemetry(run: Path) -> None:
    (run / "telemetry.parquet").write_bytes(b"no table")


def spoil_columns(run: Path) -> None:
    # What says how long the table is comes last, and is whole.
    table = bytearray((run / "link.parquet").read_bytes())
    table[4:400] = bytes(396)
    (run / "link.parquet").write_bytes(table)


def swap_tables(run: Path) -> None:
    write_parquet(*solve_rows(3), run / "telemetry.parquet")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (spoil_config, "robot: expected one of g1, icub, romeo"),
        (remove_telemetry, "got one without telemetry.parquet"),
        (spoil_telemetry, "cannot read"),
        (spoil_columns, "cannot read"),
        (swap_tables, "expected the rows of a romeo as this version records them, found no tick"),
    ],
)
def test_a_spoilt_run_is_refused_in_one_line_and_leaves_no_recording(
    run: Path, spoil: Callable[[Path], None], message: str
) -> None:
    spoil(run)
    with pytest.raises(UserError, match=message) as refused:
        record(run)
    assert "\n" not in str(refused.value)
    assert not list(run.glob("recording.rrd*"))


def test_the_command_line_prints_one_line_and_exits_with_two(tmp_path: Path) -> None:
    done = played(*python("-m", "viewer", "record", str(tmp_path / "nothing")))
    assert done.returncode == 2
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1
    assert "expected the folder of a run" in done.stderr
