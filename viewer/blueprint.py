"""The layout of the view: the title, the robot on the left, the plots on the right.

The user opens and arranges nothing by hand. The plots show, from the top: the link, the lanes of
states, the errors, and the correction and computation. A plot has one line, or a line and a fainter
one. The title names the lines, so that no legend hides data. A recording shows its whole length; a
live view follows the newest data and plots the last seconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import rerun as rr
import rerun.blueprint as rrb

from shared.config.extensions import corrects
from shared.config.settings import RunConfig
from viewer.camera import DEFAULT, eye_and_target
from viewer.plots import (
    LANES,
    LINK_LANES,
    MAX_COM_ERROR_CM,
    MAX_CONTACT_VIOLATION,
    SOURCE_LANE,
    Lane,
)
from viewer.recorder import TIMELINE
from viewer.title import PATH as TITLE_PATH

LIVE_WINDOW = 20.0  # seconds
# The entity that the camera follows.
FOLLOWED = "world/focus"
_COM_ERROR = f"CoM error [cm], up to {MAX_COM_ERROR_CM:g}"
_CONTACT_VIOLATION = f"Contact violation [m/s²], up to {MAX_CONTACT_VIOLATION:g}"
_TITLE_SHARE = 0.06


@dataclass(frozen=True)
class Picture:
    """The parts of a picture: the camera by its name, and whether it shows the scene alone."""

    camera: str = DEFAULT
    scene_only: bool = False


def layout(
    config: RunConfig, *, duration: float | None, picture: Picture | None = None
) -> rrb.Blueprint:
    """Return the blueprint of a finished run of `duration` [s], or of a live one (None)."""
    live = duration is None
    details = [
        ("Robot tick [ms], ×: overrun", "plots/compute/tick"),
        ("Edge solve [ms]", "plots/compute/solve"),
    ]
    if corrects(config.controller):
        details = [
            ("Contraction", "plots/correction/contraction"),
            ("Staleness [rad]", "plots/correction/staleness"),
            *details,
        ]
    span = _recent() if duration is None else _whole(duration)
    return _blueprint(
        [config],
        rrb.Vertical(
            rrb.Horizontal(
                _plot("Uplink delay [ms], ×: lost", "plots/delay/uplink", span),
                _plot("Downlink delay [ms], ×: lost", "plots/delay/downlink", span),
                _plot("Age of the answer in use [ms]", "plots/projector_age", span),
            ),
            _lanes(LANES, span),
            rrb.Horizontal(
                _plot(_COM_ERROR, "plots/com_error", span),
                _plot(_CONTACT_VIOLATION, "plots/contact_violation", span),
                rrb.Tabs(*(_plot(name, path, span) for name, path in details)),
            ),
            row_shares=_row_shares(len(LANES)),
        ),
        live=live,
        picture=picture,
    )


def compared_layout(
    configs: Sequence[RunConfig], *, duration: float, picture: Picture | None = None
) -> rrb.Blueprint:
    """Return the blueprint of several finished runs: robots side by side, lines in one plot."""
    span = _whole(duration)
    return _blueprint(
        configs,
        rrb.Vertical(
            rrb.Horizontal(
                _plot("Uplink delay [ms], ×: lost", "plots/delay/uplink", span),
                _plot("Age of the answer in use [ms]", "plots/projector_age", span),
            ),
            _lanes((LINK_LANES[0], SOURCE_LANE), span),
            rrb.Horizontal(
                _plot(_COM_ERROR, "plots/com_error", span),
                _plot(_CONTACT_VIOLATION, "plots/contact_violation", span),
            ),
            row_shares=_row_shares(2 * len(configs)),
        ),
        live=False,
        picture=picture,
    )


def _blueprint(
    configs: Sequence[RunConfig],
    plots: rrb.Vertical,
    *,
    live: bool,
    picture: Picture | None,
) -> rrb.Blueprint:
    shown = Picture() if picture is None else picture
    robots = _robot_view(configs, camera=shown.camera)
    title = rrb.TextDocumentView(origin=TITLE_PATH, name="Run", titlebar=False)
    panel = rrb.PanelState.Collapsed if picture is None else rrb.PanelState.Hidden
    body = rrb.Horizontal(robots, plots, column_shares=[1, 1.5 if len(configs) == 1 else 1.15])
    return rrb.Blueprint(
        robots if shown.scene_only else rrb.Vertical(title, body, row_shares=[_TITLE_SHARE, 1]),
        *([] if picture is None else [rrb.TopPanel(state="hidden")]),
        rrb.BlueprintPanel(state=panel),
        rrb.SelectionPanel(state=panel),
        rrb.TimePanel(
            state="hidden" if shown.scene_only else "collapsed",
            timeline=TIMELINE,
            play_state="paused" if picture else "following" if live else "playing",
        ),
        auto_views=False,
        auto_layout=False,
    )


def _robot_view(configs: Sequence[RunConfig], *, camera: str) -> rrb.Spatial3DView:
    eye, target = eye_and_target(configs, name=camera)
    return rrb.Spatial3DView(
        origin="world",
        name="Robot",
        titlebar=False,
        background=rrb.Background(color=(28, 30, 34)),
        line_grid=rrb.LineGrid3D(visible=True, spacing=0.25, color=(120, 125, 135, 90)),
        eye_controls=rrb.EyeControls3D(
            position=eye,
            look_target=target,
            eye_up=(0, 0, 1),
            tracking_entity=FOLLOWED if len(configs) == 1 else None,
        ),
    )


def _lanes(lanes: Sequence[Lane], span: rr.TimeRange) -> rrb.StateTimelineView:
    return rrb.StateTimelineView(
        origin="/",
        contents=[f"/{lane.path}/**" for lane in lanes],
        name="Link, command, contact, limits",
        time_view=rrb.TimeAxis(view_range=span),
    )


def _row_shares(lanes: int) -> list[float]:
    """Return the heights of the plots, the lanes and the plots below.

    With these, all lanes fit the screen of a small laptop.
    """
    return [2.4, 0.5 + 0.37 * lanes, 2.4]


def _plot(name: str, path: str, span: rr.TimeRange) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=path,
        name=name,
        plot_legend=rrb.PlotLegend(visible=False),
        axis_x=rrb.TimeAxis(view_range=span),
        time_ranges=rrb.VisibleTimeRanges(timeline=TIMELINE, range=span),
    )


def _whole(duration: float) -> rr.TimeRange:
    """Return the range of a whole run [s]."""
    return rr.TimeRange(
        start=rr.TimeRangeBoundary.absolute(seconds=0.0),
        end=rr.TimeRangeBoundary.absolute(seconds=duration),
    )


def _recent() -> rr.TimeRange:
    """Return the range of the last `LIVE_WINDOW` before the cursor."""
    return rr.TimeRange(
        start=rr.TimeRangeBoundary.cursor_relative(seconds=-LIVE_WINDOW),
        end=rr.TimeRangeBoundary.cursor_relative(seconds=0.0),
    )
