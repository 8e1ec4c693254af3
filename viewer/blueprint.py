"""The layout of the view: the robot on the left, what explains it on the right.

Nothing needs to be opened or arranged by hand. A recording shows its whole length; a live view
follows the newest data and plots the last seconds.
"""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb

from viewer.plots import SOURCE_PATH
from viewer.scene import TIMELINE

LIVE_WINDOW = 20.0  # seconds

# Name, entities, and whether there are several lines to tell apart.
PLOTS = (
    ("Uplink delay [ms]", "plots/uplink", True),
    ("Downlink delay [ms]", "plots/downlink", True),
    ("Projector age [ms]", "plots/projector_age", False),
    ("Computation [ms]", "plots/compute", True),
    ("CoM error [cm]", "plots/com_error", False),
    ("Contact violation [m/s²]", "plots/contact_violation", False),
    ("Correction (LC)", "plots/correction", True),
)


def layout(*, live: bool) -> rrb.Blueprint:
    """The blueprint of a live view or of a finished recording."""
    plots = [_plot(name, path, legend=legend, live=live) for name, path, legend in PLOTS]
    source = rrb.StateTimelineView(
        origin=SOURCE_PATH,
        name="Source of the command",
        time_view=rrb.TimeAxis(link="LinkToGlobal"),
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Spatial3DView(
                origin="world",
                name="Robot",
                background=rrb.Background(color=(28, 30, 34)),
                line_grid=rrb.LineGrid3D(visible=True, spacing=0.25, color=(120, 125, 135, 90)),
                eye_controls=rrb.EyeControls3D(
                    position=(1.95, -0.85, 1.2), look_target=(0.0, 0.0, 0.65), eye_up=(0, 0, 1)
                ),
            ),
            rrb.Vertical(
                rrb.Horizontal(*plots[0:2]),
                rrb.Horizontal(*plots[2:4]),
                rrb.Horizontal(*plots[4:7]),
                source,
                row_shares=[3, 3, 3, 1.4],
            ),
            column_shares=[1, 1],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(
            state="collapsed",
            timeline=TIMELINE,
            play_state="following" if live else "playing",
        ),
        auto_views=False,
        auto_layout=False,
    )


def _plot(name: str, path: str, *, legend: bool, live: bool) -> rrb.TimeSeriesView:
    window = rrb.VisibleTimeRanges(timeline=TIMELINE, range=_recent())
    return rrb.TimeSeriesView(
        origin=path,
        name=name,
        plot_legend=rrb.PlotLegend(corner="lefttop", visible=legend),
        axis_x=rrb.TimeAxis(link="LinkToGlobal"),
        time_ranges=window if live else None,
    )


def _recent() -> rr.TimeRange:
    """From some seconds before the cursor on; a live run has nothing after it."""
    return rr.TimeRange(
        start=rr.TimeRangeBoundary.cursor_relative(seconds=-LIVE_WINDOW),
        end=rr.TimeRangeBoundary.infinite(),
    )
