"""Rows in, recording out: read back from the file and held against the rows."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from shared.config.settings import RunConfig
from shared.errors import UserError
from shared.robots import Robot
from shared.telemetry.schema import Column, Schema, Source, tick_schema
from tests.viewer.reading import entities, logged, static
from tests.viewer.synthetic import link_rows, solve_rows, step_rows, tick_rows
from viewer.colours import FORCE, LIMIT
from viewer.footholds import PRINT_HEIGHT
from viewer.recording import new_recording
from viewer.scene import Scene
from viewer.track import Track
from viewer.world import MAX_FORCE, NEWTONS_PER_METRE

MILLISECOND = 1_000_000
Rows = tuple[Schema, np.ndarray]


@pytest.fixture
def draw(robot: Robot, config: RunConfig, tmp_path: Path) -> Callable[..., Path]:
    """Draws batches of rows, in order, into a file."""

    def build(*batches: Rows, finished: bool = False, config: RunConfig = config) -> Path:
        path = tmp_path / "scene.rrd"
        recording = new_recording("test")
        recording.save(path)
        scene = Scene(recording, robot, config, meshes=())
        for schema, rows in batches:
            scene.log_rows(schema, rows)
        scene.look_for_silence(patience_ns=50 * MILLISECOND)
        if finished:
            scene.finish()
        recording.disconnect()
        return path

    return build


def test_the_scene_is_drawn_fifty_times_a_second_across_batches(
    robot: Robot, draw: Callable[..., Path]
) -> None:
    batches = [tick_rows(robot, 130, start=130 * k) for k in range(4)]
    times, placements = logged(draw(*batches), "/world/joints", "Transform3D:translation")
    np.testing.assert_array_equal(times, np.arange(26) * 20 * MILLISECOND)
    schema, rows = batches[1]
    drawn = {int(time): placement for time, placement in zip(times, placements, strict=True)}
    # The base is the first joint; the recording has float32.
    base = drawn[140 * MILLISECOND][0]
    np.testing.assert_allclose(base, schema.column(rows, "q")[10, :3], atol=1e-6)


def test_force_arrows_add_up_to_the_forces_of_the_row(
    robot: Robot, draw: Callable[..., Path]
) -> None:
    schema, rows = tick_rows(robot, 20)
    path = draw((schema, rows))
    times, arrows = logged(path, "/world/contact_forces", "Arrows3D:vectors")
    assert len(times) == 1
    assert len(arrows[0]) == 8
    drawn = NEWTONS_PER_METRE * np.sum(arrows[0], axis=0)
    commanded = schema.column(rows, "f")[0].reshape(8, 3).sum(axis=0)
    np.testing.assert_allclose(drawn, commanded, atol=0.05)
    origins = logged(path, "/world/contact_forces", "Arrows3D:origins")[1][0]
    np.testing.assert_allclose(np.array(origins)[:, 2], 0.0, atol=1e-5)


def test_unloaded_points_and_absent_pushes_have_no_arrow(
    robot: Robot, draw: Callable[..., Path]
) -> None:
    schema, rows = tick_rows(robot, 1240)
    rows[:, schema.slices["f"]][:, :12] = 0.0
    path = draw((schema, rows))
    assert {len(each) for each in logged(path, "/world/contact_forces", "Arrows3D:vectors")[1]} == {
        4
    }
    times, labels = logged(path, "/world/push", "Arrows3D:labels")
    pushed = times[[len(each) > 0 for each in labels]]
    assert pushed.min() == 1_000 * MILLISECOND
    assert pushed.max() == 1_180 * MILLISECOND
    assert {label for each in labels for label in each} == {"100 N"}


def test_plots_keep_the_peak_of_every_signal(robot: Robot, draw: Callable[..., Path]) -> None:
    schema, rows = tick_rows(robot, 500)
    rows[333, schema.slices["tick_ns"]] = 9e6
    times, values = logged(draw((schema, rows)), "/plots/compute/tick", "Scalars:scalars")
    ticks = np.array(values)[:, 0]
    assert ticks.max() == pytest.approx(9.0)
    assert times[ticks.argmax()] == 333 * MILLISECOND
    assert len(times) < 250


def test_messages_wait_for_the_first_row_of_the_robot_and_share_its_time(
    robot: Robot, draw: Callable[..., Path]
) -> None:
    path = draw(link_rows(300, lost_every=150), solve_rows(300), tick_rows(robot, 300, waiting=100))
    times, delays = logged(path, "/plots/delay/downlink", "Scalars:scalars")
    assert times[0] == 0, "what came before the task began is not plotted"
    assert times[-1] == 199 * MILLISECOND
    np.testing.assert_allclose(delays[0], [30.1])
    lost_at, lost = logged(path, "/plots/delay/uplink/lost", "Scalars:scalars")
    np.testing.assert_array_equal(lost_at, [50 * MILLISECOND])
    np.testing.assert_allclose(lost, [[15.0]])
    assert logged(path, "/plots/compute/solve", "Scalars:scalars")[0][0] == 0


def test_states_are_logged_when_they_change_only(robot: Robot, draw: Callable[..., Path]) -> None:
    batches = [tick_rows(robot, 100, start=100 * k) for k in range(6)]
    path = draw(*batches)
    assert logged(path, "/robot/planned_contact", "StateChange:state")[1] == [["both feet"]]
    times, names = logged(path, "/robot/command", "StateChange:state")
    assert names == [["cached"], ["fresh"], ["cached"]]
    np.testing.assert_array_equal(times, np.array([0, 250, 500]) * MILLISECOND)


def test_after_a_fall_nothing_is_drawn_as_held(robot: Robot, draw: Callable[..., Path]) -> None:
    schema, rows = tick_rows(robot, 200)
    rows[150:, schema.slices["com"]] *= 0.5
    rows[150:, schema.slices["source"]] = Source.HELD
    path = draw((schema, rows), finished=True)
    assert logged(path, "/robot/command", "StateChange:state")[1] == [["cached"], ["fallen"]]
    times, states = logged(path, "/robot/planned_contact", "StateChange:state")
    assert states[-1] == [""]
    assert times[1] == 150 * MILLISECOND


def test_the_lanes_of_a_finished_run_end_with_it(robot: Robot, draw: Callable[..., Path]) -> None:
    path = draw(tick_rows(robot, 100), finished=True)
    for lane in ("/robot/command", "/robot/planned_contact"):
        times, states = logged(path, lane, "StateChange:state")
        assert (times[-1], states[-1]) == (99 * MILLISECOND, [""])


def test_the_verdict_is_that_of_the_last_row(robot: Robot, config: RunConfig) -> None:
    scene = Scene(new_recording("test"), robot, config, meshes=())
    assert scene.verdict == "waits for the edge"
    schema, rows = tick_rows(robot, 100)
    scene.log_rows(schema, rows[:50])
    assert scene.verdict == "stands"
    rows[70:, schema.slices["com"]] *= 0.5
    scene.log_rows(schema, rows[50:])
    assert scene.verdict == "fell at 0.07 s"


def test_a_source_that_this_viewer_does_not_know_is_shown_by_its_number(
    robot: Robot, draw: Callable[..., Path]
) -> None:
    schema, rows = tick_rows(robot, 10)
    rows[:, schema.slices["source"]] = 17
    assert logged(draw((schema, rows)), "/robot/command", "StateChange:state")[1] == [["number 17"]]


def test_a_force_beyond_its_friction_and_its_pyramid_are_red(
    robot: Robot, draw: Callable[..., Path]
) -> None:
    schema, rows = tick_rows(robot, 1)
    f = np.tile([0.0, 0.0, 50.0], (8, 1))
    f[6] = [26.0, 0.0, 50.0]
    rows[0, schema.slices["f"]] = f.ravel()
    path = draw((schema, rows))
    (colours,) = logged(path, "/world/contact_forces", "Arrows3D:colors")[1]
    rgb = [tuple(int(colour).to_bytes(4, "big")[:3]) for colour in colours]
    assert rgb == [FORCE] * 6 + [LIMIT] + [FORCE]
    (strips,) = logged(path, "/world/friction_cones", "LineStrips3D:strips")[1]
    assert len(strips) == 2 * 8


def test_the_boundless_forces_of_a_fall_stay_in_the_picture(
    robot: Robot, draw: Callable[..., Path]
) -> None:
    schema, rows = tick_rows(robot, 1)
    rows[0, schema.slices["f"]] = 1e7
    (arrows,) = logged(draw((schema, rows)), "/world/contact_forces", "Arrows3D:vectors")[1]
    lengths = np.linalg.norm(np.array(arrows), axis=1)
    np.testing.assert_allclose(lengths, MAX_FORCE / NEWTONS_PER_METRE, rtol=1e-5)


def test_an_overrun_is_marked_at_its_tick(robot: Robot, draw: Callable[..., Path]) -> None:
    schema, rows = tick_rows(robot, 100)
    rows[70:, schema.slices["overruns"]] = 1.0
    rows[70, schema.slices["tick_ns"]] = 2.5e6
    times, marks = logged(draw((schema, rows)), "/plots/compute/tick/overrun", "Scalars:scalars")
    np.testing.assert_array_equal(times, [70 * MILLISECOND])
    np.testing.assert_allclose(marks, [[2.5]])


def test_overruns_of_the_wait_are_not_marked_in_the_task(
    robot: Robot, draw: Callable[..., Path]
) -> None:
    schema, rows = tick_rows(robot, 100, waiting=20)
    # As the robot counts: it begins anew with the second tick of the task.
    rows[10:21, schema.slices["overruns"]] = 7.0
    rows[60:, schema.slices["overruns"]] = 1.0
    times, _ = logged(draw((schema, rows)), "/plots/compute/tick/overrun", "Scalars:scalars")
    np.testing.assert_array_equal(times, [40 * MILLISECOND])


def test_a_link_that_is_cut_shows_as_an_outage_without_an_end(
    robot: Robot, draw: Callable[..., Path]
) -> None:
    path = draw(tick_rows(robot, 400), link_rows(200))
    times, states = logged(path, "/link/uplink", "StateChange:state")
    assert states == [["passing"], ["outage"]]
    assert times[1] == pytest.approx((199 + 15.1) * MILLISECOND)
    assert logged(path, "/link/downlink", "StateChange:state")[1][-1] == ["nothing sent"]


def test_everything_has_its_time_on_the_clock_too(robot: Robot, draw: Callable[..., Path]) -> None:
    path = draw(tick_rows(robot, 300, waiting=100), link_rows(300))
    for entity, component in (
        ("/world/joints", "Transform3D:translation"),
        ("/plots/com_error", "Scalars:scalars"),
        ("/plots/delay/uplink", "Scalars:scalars"),
    ):
        task, _ = logged(path, entity, component)
        wall, _ = logged(path, entity, component, timeline="wall_time")
        in_task = task >= 0
        np.testing.assert_array_equal(wall[in_task], task[in_task] + 100 * MILLISECOND)


def test_of_several_runs_each_has_its_own_entities_and_place(
    robot: Robot, config: RunConfig, tmp_path: Path
) -> None:
    path = tmp_path / "several.rrd"
    recording = new_recording("test")
    recording.save(path)
    for k, name in enumerate(("slow link", "pr")):
        track = Track(name, (1, 2, 3), (0.0, float(k), 0.0))
        Scene(recording, robot, config, meshes=(), track=track).log_rows(*tick_rows(robot, 20))
    recording.disconnect()
    found = entities(path)
    assert {"/world/pr/joints", "/world/slow_link/joints", "/plots/com_error/pr"} <= found
    assert not [each for each in found if "ghost" in each]
    (place,) = static(path, "/world/pr", "Transform3D:translation")
    np.testing.assert_allclose(place, [[0.0, 1.0, 0.0]])
    frames = logged(path, "/world/pr/joints", "Transform3D:parent_frame")[1]
    assert frames[0] == ["tf#/world/pr"]


def test_a_robot_that_waits_is_shown_once_a_batch(robot: Robot, draw: Callable[..., Path]) -> None:
    path = draw(tick_rows(robot, 100, waiting=1000))
    times, _ = logged(path, "/world/joints", "Transform3D:translation")
    np.testing.assert_array_equal(times, [-1])
    assert len(logged(path, "/plots/com_error", "Scalars:scalars")[0]) == 0


def test_a_configuration_that_is_not_finite_is_not_drawn(
    robot: Robot, draw: Callable[..., Path]
) -> None:
    schema, rows = tick_rows(robot, 100)
    rows[40:, schema.slices["q"]] = np.nan
    times, _ = logged(draw((schema, rows)), "/world/joints", "Transform3D:translation")
    assert times.max() == 20 * MILLISECOND


def test_rows_of_another_robot_are_refused_by_name_and_width(
    robot: Robot, draw: Callable[..., Path]
) -> None:
    other = tick_schema(nq=30, nv=29)
    with pytest.raises(UserError, match=r"not of the robot romeo.*q \(30 instead of 38\)"):
        draw((other, np.zeros((1, other.width))))
    with pytest.raises(UserError, match="missing"):
        draw((Schema(Column("temperature")), np.zeros((1, 1))))


def test_a_plan_is_ahead_until_it_is_stepped_on_replaced_or_void(
    robot: Robot, draw: Callable[..., Path]
) -> None:
    path = draw(step_rows(), tick_rows(robot, 130))
    toe = robot.soles[0].corners()[:, 0].max()
    ahead = []
    for entity in ("planned_soles", "chosen_sole", "landed_soles"):
        times, strips = logged(path, f"/world/{entity}", "LineStrips3D:strips")
        np.testing.assert_array_equal(times, np.arange(6) * 20 * MILLISECOND)
        fronts = [[max(x for x, _, _ in sole) - toe for sole in soles] for soles in strips]
        ahead.append([[round(front, 3) for front in each] for each in fronts])
    planned, chosen, landed = ahead
    assert planned == [[], [0.1, 0.2], [0.1, 0.2], [0.2], [0.3], []]
    assert chosen == [[], [], [0.15], [], [], [0.35]]
    assert landed == 3 * [[0.0, 0.0]] + 3 * [[0.0, 0.0, 0.14]]
    _, strips = logged(path, "/world/planned_soles", "LineStrips3D:strips")
    heights = [sole[0][2] for sole in strips[1]]
    np.testing.assert_allclose(heights, [PRINT_HEIGHT, 0.06 + PRINT_HEIGHT], atol=1e-6)


def test_a_robot_that_steps_by_touch_has_no_ghost(
    robot: Robot, draw: Callable[..., Path], configured: Callable[..., RunConfig]
) -> None:
    """The motion of its settings is a stand, wherever it walks."""
    stepping = configured(**{"stepping.mode": "on", "wbc.balance.law": "dcm"})
    assert "/world/ghost_joints" in entities(draw(tick_rows(robot, 20)))
    drawn = entities(draw(tick_rows(robot, 20), config=stepping))
    assert "/world/joints" in drawn
    assert not [each for each in drawn if "ghost" in each]
