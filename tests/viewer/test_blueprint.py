"""The layout: every robot is in the picture, and everything that is plotted has its place."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from shared.config.config_file import load_config
from shared.config.settings import RunConfig
from shared.robots import CATALOGUE, load_robot
from viewer.blueprint import compared_layout, layout
from viewer.camera import eye_and_target
from viewer.plots import LANES, LINKS, OVERRUN_PATH, SOLVE_SERIES, TICK_SERIES
from viewer.track import SIDE_BY_SIDE

# Of rerun's camera, from top to bottom; and of the picture, a little narrower than it is high.
FIELD_OF_VIEW = np.deg2rad(55.0)
ASPECT = 0.72


def config_of(robot: str, *, walk: float = 0.0, controller: str = "la") -> RunConfig:
    """A stand, or a walk of so many metres."""
    given = {"robot.name": robot, "controller": controller, "task": "walk" if walk else "balance"}
    return load_config(None, {**given, "walk.steps": 10, "walk.step_length": walk / 10})


def in_picture(points: np.ndarray, eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Points (n, 3) from −1 to 1, right and up, shape (n, 2)."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    seen = points - eye
    depth = seen @ forward
    scale = np.tan(FIELD_OF_VIEW / 2) * depth
    assert (depth > 0.0).all()
    return np.column_stack([seen @ right / (ASPECT * scale), seen @ up / scale])


@pytest.mark.parametrize("robot", CATALOGUE)
@pytest.mark.parametrize("count", [1, 2, 3, 6])
@pytest.mark.parametrize("walk", [0.0, 0.6, -0.6, 1.5])
def test_all_of_every_robot_is_seen_from_the_start_to_the_end(
    robot: str, count: int, walk: float
) -> None:
    eye, target = eye_and_target([config_of(robot, walk=walk)] * count)
    # One robot is followed.
    walk = 0.0 if count == 1 else walk
    base = load_robot(robot).q_standing[2]
    top, arms, apart = 1.75 * base, 0.95 * base, 0.42 * base
    middles = (np.arange(count) - (count - 1) / 2) * SIDE_BY_SIDE
    points = np.array(
        [
            [along, middle + side, up]
            for along in (0.0, walk)
            for middle in middles
            for side, up in ((-0.15, 0.0), (0.15, 0.0), (-apart, arms), (apart, arms), (0.0, top))
        ]
    )
    seen = in_picture(points, eye, target)
    assert np.abs(seen).max() < 1.0
    if not walk and count == 1:
        assert np.ptp(seen[:, 1]) > 1.2, "it fills most of the picture"


def views(part: Any) -> Iterator[Any]:
    """The views of a layout."""
    for each in getattr(part, "contents", ()):
        if hasattr(each, "origin"):
            yield each
        else:
            yield from views(each)


@pytest.mark.parametrize("controller", ["pr", "la", "lc"])
def test_everything_that_is_plotted_has_its_place(controller: str) -> None:
    every = list(
        views(layout(config_of("romeo", controller=controller), duration=None).root_container)
    )
    origins = [view.origin for view in every]
    assert len(origins) == len(set(origins))
    plotted = [
        *(series.path for series in (*TICK_SERIES, SOLVE_SERIES)),
        *(path for link in LINKS for path in (link.path, link.lost_path)),
        *(OVERRUN_PATH, "world/joints", "title"),
    ]
    (lanes,) = (view for view in every if view.origin == "/")
    assert lanes.contents == [f"/{lane.path}/**" for lane in LANES]
    origins.remove("/")
    without = [path for path in plotted if not path.startswith(tuple(origins))]
    correction = ["plots/correction/contraction", "plots/correction/staleness"]
    assert without == ([] if controller == "lc" else correction)


def test_a_comparison_is_of_the_robots_the_link_and_the_errors() -> None:
    both = compared_layout([config_of("romeo"), config_of("talos")], duration=5.0)
    origins = {view.origin for view in views(both.root_container)}
    errors = {"plots/com_error", "plots/contact_violation"}
    assert origins == {"world", "title", "/", "plots/delay/uplink", "plots/projector_age", *errors}
