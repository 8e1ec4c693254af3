"""A figure of a study: how many trials stood, or the mean of a column, over one of its settings.

`python -m experiments figure DIR --x correction.posture_error --by cell --panels task --out FILE`.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl

from experiments.studies import value_in_words
from experiments.trial_table import read_trials, wilson_interval
from shared.cli import EXIT_STANDING
from shared.errors import ConfigError

mpl.use("Agg")
from matplotlib import pyplot as plt

STOOD = "stood"

Row = dict[str, Any]


def add_figure_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `figure`."""
    parser.add_argument("study", type=Path, metavar="DIR", help="folder of a finished sweep")
    parser.add_argument("--x", required=True, metavar="SETTING", help="along the axis")
    parser.add_argument(
        "--y",
        action="append",
        metavar="COLUMN",
        help=f"{STOOD} (default), or a column, averaged over those standing; repeatable",
    )
    parser.add_argument("--by", metavar="SETTING", help="a line for each value")
    parser.add_argument("--panels", metavar="SETTING", help="a panel for each value")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.png")


def run_figure(arguments: argparse.Namespace) -> int:
    """Draw one figure; 0."""
    rows = read_trials(arguments.study).to_pylist()
    columns = arguments.y or [STOOD]
    for name in (arguments.x, arguments.by, arguments.panels, *columns):
        if name not in (None, STOOD) and name not in rows[0]:
            raise ConfigError(f"figure: expected one of {', '.join(rows[0])}, got {name!r}")
    panels = _groups(rows, arguments.panels)
    figure, axes = plt.subplots(
        len(columns),
        len(panels),
        figsize=(5.5 * len(panels), 3.8 * len(columns)),
        squeeze=False,
        sharey="row",
    )
    for line, column in zip(axes, columns, strict=True):
        for axis, (panel, chosen) in zip(line, panels.items(), strict=True):
            for name, group in _groups(chosen, arguments.by).items():
                _draw(axis, _groups(group, arguments.x), column, name)
            axis.set(title=panel, xlabel=arguments.x)
            axis.grid(alpha=0.3)
        line[0].set_ylabel("part that stood, 95 %" if column == STOOD else column)
    if arguments.by:
        axes[0, 0].legend(fontsize=8)
    figure.tight_layout()
    try:
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(arguments.out, dpi=110)
    except (OSError, ValueError) as error:
        raise ConfigError(f"figure: cannot write {arguments.out}: {error}") from None
    plt.close(figure)
    print(arguments.out)
    return EXIT_STANDING


def _groups(rows: Sequence[Row], name: str | None) -> dict[str, list[Row]]:
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault("" if name is None else value_in_words(row[name]), []).append(row)
    return groups


def _draw(axis: Any, groups: dict[str, list[Row]], column: str, label: str) -> None:
    xs, ys, low, high = [], [], [], []
    for x, rows in groups.items():
        played = [row for row in rows if row["error"] is None]
        standing = [row for row in played if not row["fell"]]
        if column == STOOD:
            y = len(standing) / len(played)
            bounds = wilson_interval(len(standing), len(played))
        else:
            values = [row[column] for row in standing if row[column] is not None]
            if not values:
                continue
            y, bounds = sum(values) / len(values), (min(values), max(values))
        xs.append(x)
        ys.append(y)
        low.append(y - bounds[0])
        high.append(bounds[1] - y)
    axis.errorbar(xs, ys, yerr=[low, high], marker="o", capsize=3, label=label)
