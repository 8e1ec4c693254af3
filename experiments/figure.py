"""A figure of a study: the part of trials that stood, or a column's mean, over one of its settings.

`./wbc figure DIR --x correction.posture_error --by cell --panels task --out FILE`. With `--polar`
the figure shows a study of pushes from above, each push at its force in its direction.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from experiments.studies.study import value_in_words
from experiments.studies.trial_table import errors_in_words, read_trials, wilson_interval
from shared.config.quantities import parse_push
from shared.errors import ConfigError, one_of
from shared.output.figure import save_figure
from shared.process.cli import EXIT_STANDING

mpl.use("Agg")
from matplotlib import pyplot as plt

STOOD, FELL = "stood", "fell"
_PARTS = {STOOD: "RdYlGn", FELL: "RdYlGn_r"}

Row = dict[str, Any]


def add_figure_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `figure`."""
    parser.add_argument("study", type=Path, metavar="DIR", help="folder of a finished sweep")
    parser.add_argument("--x", required=True, metavar="SETTING", help="setting on the x axis")
    parser.add_argument(
        "--y",
        action="append",
        metavar="COLUMN",
        help=f"on the y axis: {STOOD} (default), {FELL}, or a column's mean over standing trials; "
        "repeatable",
    )
    parser.add_argument(
        "--by", metavar="SETTING", help="draw a line, or a row of the map, for each value"
    )
    parser.add_argument("--map", action="store_true", help="draw a map of squares instead of lines")
    parser.add_argument(
        "--polar", action="store_true", help="draw the pushes of --x push in their directions"
    )
    parser.add_argument("--panels", metavar="SETTING", help="draw a panel for each value")
    parser.add_argument(
        "--out", type=Path, required=True, metavar="FILE.png", help="picture to write"
    )


def run_figure(arguments: argparse.Namespace) -> int:
    """Draw one figure. Return 0."""
    rows = read_trials(arguments.study).to_pylist()
    columns = arguments.y or [STOOD]
    for name in (arguments.x, arguments.by, arguments.panels, *columns):
        if name not in (None, STOOD) and name not in rows[0]:
            raise ConfigError(f"figure: {one_of(rows[0], name)}")
    if arguments.polar:
        if arguments.x != "push":
            raise ConfigError(f"figure: expected --x push with --polar, got {arguments.x!r}")
        draw_pushes(rows, panels=arguments.panels, out=arguments.out)
        print(arguments.out)
        return EXIT_STANDING
    draw_figure(
        rows,
        columns,
        x=arguments.x,
        by=arguments.by,
        panels=arguments.panels,
        as_map=arguments.map,
        out=arguments.out,
    )
    print("\n".join([*errors_in_words(rows), str(arguments.out)]))
    return EXIT_STANDING


def draw_figure(
    rows: Sequence[Row],
    columns: Sequence[str],
    *,
    x: str,
    by: str | None,
    panels: str | None,
    as_map: bool,
    out: Path,
) -> None:
    """Draw a row of panels for each of `columns`, with a line or a map row for each value of `by`.

    Values keep the order that they have in `rows`. Raise ConfigError if `out` cannot be written.
    """
    chosen_by_panel = _groups(rows, panels)
    figure, axes = plt.subplots(
        len(columns),
        len(chosen_by_panel),
        figsize=(5.5 * len(chosen_by_panel), 3.8 * len(columns)),
        squeeze=False,
        sharey="row",
    )
    for line, column in zip(axes, columns, strict=True):
        for axis, (panel, chosen) in zip(line, chosen_by_panel.items(), strict=True):
            lines = {name: _groups(group, x) for name, group in _groups(chosen, by).items()}
            axis.set(title=panel if panels is None else f"{panels} {panel}", xlabel=x)
            xs = list(dict.fromkeys(name for groups in lines.values() for name in groups))
            if as_map:
                _draw_map(axis, xs, lines, column)
                continue
            for name, groups in lines.items():
                _draw(axis, xs, groups, column, name)
            axis.grid(alpha=0.3)
        if as_map:
            line[0].set_ylabel(by)
        else:
            line[0].set_ylabel(f"part that {column}, 95 % interval" if column in _PARTS else column)
    if by and not as_map:
        axes[0, 0].legend(fontsize=8, title=by, title_fontsize=8)
    save_figure(figure, out, what="figure")


def draw_pushes(rows: Sequence[Row], *, panels: str | None, out: Path) -> None:
    """Draw the part of trials that stood each push, seen from above, x forward and y to the left.

    Raise ConfigError if a trial has not one push in the plane, or `out` cannot be written.
    """
    by_panel = _groups(rows, panels)
    figure, axes = plt.subplots(
        1,
        len(by_panel),
        figsize=(4.6 * len(by_panel), 4.8),
        squeeze=False,
        subplot_kw={"projection": "polar"},
    )
    for axis, (panel, chosen) in zip(axes[0], by_panel.items(), strict=True):
        for push, group in _groups(chosen, "push").items():
            x, y = _push_in_the_plane(push)
            value = _value(group, STOOD)
            if value is None:
                continue
            at = (np.arctan2(y, x), np.hypot(x, y))
            axis.scatter(*at, s=420, c=[value[0]], cmap=_PARTS[STOOD], vmin=0.0, vmax=1.0)
            clear = "black" if 0.25 < value[0] < 0.75 else "white"
            axis.annotate(value[2], at, ha="center", va="center", fontsize=7, color=clear)
        # Forward is up, left is left.
        axis.set_theta_zero_location("N")
        axis.set_thetagrids(range(0, 360, 45), ["+x", "", "+y", "", "−x", "", "−y", ""])
        axis.set_rlabel_position(22.5)
        axis.set_axisbelow(True)
        axis.set_rmax(1.15 * axis.get_rmax())
        axis.set_rmin(0.0)
        axis.set_title(panel, fontsize=9)
    figure.suptitle("trials that stood, by push [N]", fontsize=10)
    save_figure(figure, out, what="figure")


def _push_in_the_plane(text: str) -> tuple[float, float]:
    """Force (x, y) of the only push of a trial [N]."""
    pushes = text.split(",")
    x, y, z = parse_push(pushes[0]).force
    if len(pushes) != 1 or z != 0.0:
        raise ConfigError(f"figure: expected one push in the plane with --polar, got {text!r}")
    return x, y


def _groups(rows: Sequence[Row], name: str | None) -> dict[str, list[Row]]:
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault("" if name is None else value_in_words(row[name]), []).append(row)
    return groups


def _value(rows: Sequence[Row], column: str) -> tuple[float, tuple[float, float], str] | None:
    """The value of a group, its bounds and its label; None for a group without a value."""
    played = [row for row in rows if row["error"] is None]
    standing = [row for row in played if not row["fell"]]
    if column in _PARTS:
        n, of = len(standing), len(played)
        n = n if column == STOOD else of - n
        return (n / of, wilson_interval(n, of), f"{n}/{of}") if of else None
    values = [row[column] for row in standing if row[column] is not None]
    if not values:
        return None
    mean = sum(values) / len(values)
    return mean, (min(values), max(values)), f"{mean:.3g}"


def _draw(
    axis: Any, xs: Sequence[str], groups: dict[str, list[Row]], column: str, label: str
) -> None:
    """Draw a line over `xs` with a gap where a group has no value."""
    nothing = (np.nan, (np.nan, np.nan), "")
    points = [_value(groups.get(x, []), column) or nothing for x in xs]
    ys = [value for value, _, _ in points]
    low = [value - bounds[0] for value, bounds, _ in points]
    high = [bounds[1] - value for value, bounds, _ in points]
    axis.errorbar(range(len(xs)), ys, yerr=[low, high], marker="o", capsize=3, label=label)
    _name_ticks(axis, xs)


def _draw_map(
    axis: Any, xs: Sequence[str], lines: dict[str, dict[str, list[Row]]], column: str
) -> None:
    colours = np.full((len(lines), len(xs)), np.nan)
    for i, groups in enumerate(lines.values()):
        for k, x in enumerate(xs):
            if value := _value(groups.get(x, []), column):
                colours[i, k] = value[0]
                dark = column in _PARTS and abs(value[0] - 0.5) > 0.35
                axis.text(
                    k,
                    i,
                    value[2],
                    color="white" if dark else "black",
                    ha="center",
                    va="center",
                    fontsize=8,
                )
    limits = {"vmin": 0.0, "vmax": 1.0} if column in _PARTS else {}
    axis.imshow(colours, cmap=_PARTS.get(column, "viridis"), aspect="auto", **limits)
    _name_ticks(axis, xs)
    axis.set_yticks(range(len(lines)), list(lines))


def _name_ticks(axis: Any, xs: Sequence[str]) -> None:
    long = any(len(x) > 8 for x in xs)
    axis.set_xticks(
        range(len(xs)), xs, rotation=25 if long else 0, ha="right" if long else "center"
    )
