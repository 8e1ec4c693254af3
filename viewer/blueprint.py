"""The layout of the view: the robot on the left, what explains it on the right.

Nothing needs to be opened or arranged by hand. Read from the top: what the link did, what the robot
made its commands of, what came of it, and what it took. A recording shows its whole length; a live
view follows the newest data and plots the last seconds.
"""

from __future__ import annotations

from collections.abc import Sequence

import rerun as rr
import rerun.blueprint as rrb

from shared.config import RunConfig
from viewer.plots import (
    ACTIVE_SET_HEIGHTS,
    ACTIVE_SET_PATH,
    MAX_COM_ERROR_CM,
    MAX_CONTACT_VIOLATION,
)
from viewer.recorder import TIMELINE

LIVE_WINDOW = 20.0  # seconds
_COM_ERROR = f"CoM error [cm], at most {MAX_COM_ERROR_CM:g} drawn"
_CONTACT_VIOLATION = f"Contact violation [m/s²], at most {MAX_CONTACT_VIOLATION:g}"
# Of a walk, this much of the way is looked at from the start [m].
_LOOK_AHEAD = 1.5


def layout(config: RunConfig, *, live: bool, picture: bool = False) -> rrb.Blueprint:
    """The blueprint of a live view, of a finished recording, or of a picture of one."""
    corrected = config.controller == "lc"
    compute = _plot("Computation [ms]", "plots/compute", legend=True, live=live)
    last = rrb.Horizontal(
        _plot(
            "Active set (friction, least force)",
            ACTIVE_SET_PATH,
            live=live,
            heights=(-1.0, float(ACTIVE_SET_HEIGHTS[-1]) + 1.0),
        ),
        _plot("Correction (LC)", "plots/correction", legend=True, live=live)
        if corrected
        else compute,
    )
    return _blueprint(
        _robot_view(config),
        rrb.Vertical(
            rrb.Horizontal(
                _plot("Link delay [ms]", "plots/delay", legend=True, live=live),
                _plot("Projector age [ms]", "plots/projector_age", live=live),
            ),
            _lanes(),
            rrb.Horizontal(
                _plot(_COM_ERROR, "plots/com_error", live=live),
                _plot(_CONTACT_VIOLATION, "plots/contact_violation", live=live),
            ),
            last,
            *([compute] if corrected else []),
            row_shares=[2.6, 3.9, 2.6, 2.6, 2.2] if corrected else [2.6, 3.3, 2.6, 2.6],
        ),
        live=live,
        picture=picture,
    )


def compared_layout(configs: Sequence[RunConfig], *, picture: bool = False) -> rrb.Blueprint:
    """The blueprint of several finished runs: robots side by side, their lines in one plot."""
    return _blueprint(
        _robot_view(configs[0], robots=len(configs)),
        rrb.Vertical(
            rrb.Horizontal(
                _plot("Link delay [ms]", "plots/delay", legend=True),
                _plot("Projector age [ms]", "plots/projector_age", legend=True),
            ),
            _lanes("lanes/command", "lanes/uplink"),
            rrb.Horizontal(
                _plot(_COM_ERROR, "plots/com_error", legend=True),
                _plot(_CONTACT_VIOLATION, "plots/contact_violation", legend=True),
            ),
            row_shares=[3.0, 0.7 + 0.9 * len(configs), 3.0],
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


def _robot_view(config: RunConfig, *, robots: int = 1) -> rrb.Spatial3DView:
    """From before the robots and a little from their right; of a walk, from where all of it is
    seen, or the beginning of a long one.
    """
    ahead = 0.0
    if config.task == "walk":
        ahead = config.walk.steps * config.walk.step_length / 2
        ahead = max(-_LOOK_AHEAD, min(ahead, _LOOK_AHEAD))
    back = 0.9 + 0.32 * (robots - 1) + 0.4 * abs(ahead)
    aside = -0.85 / robots
    target = (ahead, 0.0, 0.6)
    eye = (ahead + 1.95 * back, aside * back, 0.6 + 0.55 * back + abs(ahead))
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
    legend: bool = False,
    live: bool = False,
    heights: tuple[float, float] | None = None,
) -> rrb.TimeSeriesView:
    window = rrb.VisibleTimeRanges(timeline=TIMELINE, range=_recent())
    return rrb.TimeSeriesView(
        origin=path,
        name=name,
        plot_legend=rrb.PlotLegend(corner="righttop", visible=legend),
        axis_x=rrb.TimeAxis(link="LinkToGlobal"),
        axis_y=None if heights is None else rrb.ScalarAxis(range=heights),
        time_ranges=window if live else None,
    )


def _recent() -> rr.TimeRange:
    """From some seconds before the cursor on; a live run has nothing after it."""
    return rr.TimeRange(
        start=rr.TimeRangeBoundary.cursor_relative(seconds=-LIVE_WINDOW),
        end=rr.TimeRangeBoundary.infinite(),
    )
