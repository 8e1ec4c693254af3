"""The layout of the view: the robot on the left, the plots on the right.

The user opens and arranges nothing by hand. The plots show, from the top: the link, the sources of
the robot's commands, the errors, and the computing times. A recording shows its whole length; a
live view follows the newest data and plots the last seconds.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from shared.config.extensions import corrects
from shared.config.settings import RunConfig
from shared.robots import load_robot
from viewer.plots import (
    ACTIVE_SET_HEIGHTS,
    ACTIVE_SET_PATH,
    MAX_COM_ERROR_CM,
    MAX_CONTACT_VIOLATION,
)
from viewer.recorder import TIMELINE
from viewer.track import SIDE_BY_SIDE

LIVE_WINDOW = 20.0  # seconds
_COM_ERROR = f"CoM error [cm], at most {MAX_COM_ERROR_CM:g} drawn"
_CONTACT_VIOLATION = f"Contact violation [m/s²], at most {MAX_CONTACT_VIOLATION:g}"
_LEFT, _RIGHT = rrb.Corner2D.LeftTop, rrb.Corner2D.RightTop
# The camera shows at most this part of the way of a walk, to either side of its target [m].
_LOOK_AHEAD = 1.5
# The height of a humanoid over that of its base, and its width with its arms over its height.
_HEIGHT, _WIDTH = 1.75, 0.6


def layout(config: RunConfig, *, live: bool, picture: bool = False) -> rrb.Blueprint:
    """Return the blueprint of a live view, of a finished recording, or of a picture of one."""
    correction = _plot("Correction (LC)", "plots/correction", legend=_LEFT, live=live)
    corrected = corrects(config.controller)
    return _blueprint(
        _robot_view([config]),
        rrb.Vertical(
            rrb.Horizontal(
                _plot("Link delay [ms]", "plots/delay", legend=_RIGHT, live=live),
                _plot("Projector age [ms]", "plots/projector_age", live=live),
            ),
            _lanes(),
            rrb.Horizontal(
                _plot(_COM_ERROR, "plots/com_error", live=live),
                _plot(_CONTACT_VIOLATION, "plots/contact_violation", live=live),
            ),
            rrb.Horizontal(
                _plot(
                    "Active set",
                    ACTIVE_SET_PATH,
                    live=live,
                    heights=(-1.0, float(ACTIVE_SET_HEIGHTS[-1]) + 1.0),
                ),
                *([correction] if corrected else []),
                _plot("Computation [ms]", "plots/compute", legend=_RIGHT, live=live),
                column_shares=[0.8, 1.0, 1.1] if corrected else None,
            ),
            # With these shares, all lanes fit the screen of a small laptop.
            row_shares=[2.4, 3.4, 2.4, 2.4],
        ),
        live=live,
        picture=picture,
    )


def compared_layout(configs: Sequence[RunConfig], *, picture: bool = False) -> rrb.Blueprint:
    """Return the blueprint of several finished runs: robots side by side, lines in one plot."""
    return _blueprint(
        _robot_view(configs),
        rrb.Vertical(
            rrb.Horizontal(
                _plot("Link delay [ms]", "plots/delay", legend=_RIGHT),
                _plot("Projector age [ms]", "plots/projector_age", legend=_RIGHT),
            ),
            _lanes("lanes/command", "lanes/uplink"),
            rrb.Horizontal(
                _plot(_COM_ERROR, "plots/com_error", legend=_RIGHT),
                _plot(_CONTACT_VIOLATION, "plots/contact_violation", legend=_RIGHT),
            ),
            row_shares=[3.0, 0.8 + 1.05 * len(configs), 3.0],
        ),
        live=False,
        picture=picture,
    )


def _blueprint(
    robots: rrb.Spatial3DView, plots: rrb.Vertical, *, live: bool, picture: bool
) -> rrb.Blueprint:
    return rrb.Blueprint(
        rrb.Horizontal(robots, plots, column_shares=[1, 1.15]),
        *([rrb.TopPanel(state="hidden")] if picture else []),
        rrb.BlueprintPanel(state="hidden" if picture else "collapsed"),
        rrb.SelectionPanel(state="hidden" if picture else "collapsed"),
        rrb.TimePanel(
            state="collapsed",
            timeline=TIMELINE,
            play_state="paused" if picture else "following" if live else "playing",
        ),
        auto_views=False,
        auto_layout=False,
    )


def camera(configs: Sequence[RunConfig]) -> tuple[np.ndarray, np.ndarray]:
    """Return the camera's position and target, each (3,) [m, world], for robots side by side.

    The camera stands in front of the robots, a little to their right, and shows all of them. It
    shows the whole way of a walk, or the beginning of a long one.
    """
    height = _HEIGHT * max(load_robot(each.robot.name).q_standing[2] for each in configs)
    width = _WIDTH * height + (len(configs) - 1) * SIDE_BY_SIDE
    ahead = max((_half_way(each) for each in configs), key=abs)
    distance = max(1.35 * height, 1.2 * width) + 0.9 * abs(ahead)
    towards = np.array([1.95, -0.85 / len(configs), 0.55])
    target = np.array([ahead, 0.0, 0.41 * height])
    eye = target + distance * towards / np.linalg.norm(towards) + [0.0, 0.0, abs(ahead)]
    return eye, target


def _half_way(config: RunConfig) -> float:
    """Return the distance to the middle of a walk, or of the beginning of a long one [m]."""
    if config.task != "walk":
        return 0.0
    half = config.walk.steps * config.walk.step_length / 2
    return max(-_LOOK_AHEAD, min(half, _LOOK_AHEAD))


def _robot_view(configs: Sequence[RunConfig]) -> rrb.Spatial3DView:
    eye, target = camera(configs)
    return rrb.Spatial3DView(
        origin="world",
        name="Robot",
        background=rrb.Background(color=(28, 30, 34)),
        line_grid=rrb.LineGrid3D(visible=True, spacing=0.25, color=(120, 125, 135, 90)),
        eye_controls=rrb.EyeControls3D(position=eye, look_target=target, eye_up=(0, 0, 1)),
    )


def _lanes(*paths: str) -> rrb.StateTimelineView:
    contents = [f"/{path}/**" for path in paths] if paths else "$origin/**"
    return rrb.StateTimelineView(
        origin="lanes",
        contents=contents,
        name="Command from, contact, link",
        time_view=rrb.TimeAxis(link="LinkToGlobal"),
    )


def _plot(
    name: str,
    path: str,
    *,
    legend: rrb.Corner2D | None = None,
    live: bool = False,
    heights: tuple[float, float] | None = None,
) -> rrb.TimeSeriesView:
    window = rrb.VisibleTimeRanges(timeline=TIMELINE, range=_recent())
    return rrb.TimeSeriesView(
        origin=path,
        name=name,
        plot_legend=rrb.PlotLegend(corner=legend, visible=legend is not None),
        axis_x=rrb.TimeAxis(link="LinkToGlobal"),
        axis_y=None if heights is None else rrb.ScalarAxis(range=heights),
        time_ranges=window if live else None,
    )


def _recent() -> rr.TimeRange:
    """Return the range from `LIVE_WINDOW` before the cursor on. A live run has no later data."""
    return rr.TimeRange(
        start=rr.TimeRangeBoundary.cursor_relative(seconds=-LIVE_WINDOW),
        end=rr.TimeRangeBoundary.infinite(),
    )
