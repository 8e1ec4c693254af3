"""The summary and the recording of a run, made from the files of its services.

A service that was started again has left files of each of its lives. Earlier lives are numbered,
and all lives count together. A life that was killed leaves no report.
"""

from __future__ import annotations

import json
import subprocess
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from shared.config.settings import RunConfig
from shared.output.report import discrepancy_report, edge_report, link_report, summary
from shared.process.entry import python
from shared.telemetry.parquet import read_parquet

SUMMARY = "summary.json"
_ROBOT, _EDGE, _LINK = "telemetry", "edge", "link"
# Only these columns are read: all columns of an hour do not fit into memory.
_COMPARED = ("tick", "time_ns", "active_set", "com_error_m", "contact_violation_m_s2")


def keep_report(run: Path, stem: str) -> None:
    """Number the files of a service's life, so that its next life does not replace them."""
    if not stem or not (run / f"{stem}.json").exists():
        return
    number = 1 + len(list(run.glob(f"{stem}.*.json")))
    for kind in ("json", "parquet"):
        (run / f"{stem}.{kind}").replace(run / f"{stem}.{number}.{kind}")


def summarise(run: Path, config: RunConfig) -> dict[str, Any] | None:
    """Return the summary, and write it to `summary.json` in place of the services' reports.

    Return None if the robot left no report.
    """
    robot = _report(run / f"{_ROBOT}.json")
    if robot is None:
        return None
    result = summary(
        config,
        robot=robot,
        edge=_whole(run, _EDGE, _edge_report),
        link=_whole(run, _LINK, _link_report),
        discrepancy=_discrepancy(run),
    )
    text = json.dumps(result, indent=2)
    (run / SUMMARY).write_text(text + "\n", encoding="utf-8")
    for stem in (_ROBOT, _EDGE, _LINK):
        for file in _lives(run, stem):
            file.unlink()
    return result


def record(run: Path, say: Callable[[str], None]) -> None:
    """Make the recording of a run from its files, if no viewer recorded the whole run."""
    command = python("-m", "viewer", "record", str(run))
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    for line in (done.stdout + done.stderr).splitlines():
        say(line)


def _lives(run: Path, stem: str) -> list[Path]:
    """Return the report files of a service, the earliest life first."""
    last = run / f"{stem}.json"
    numbered = sorted(run.glob(f"{stem}.*.json"), key=lambda file: int(file.suffixes[-2][1:]))
    return [*numbered, *([last] if last.exists() else [])]


def _whole(
    run: Path, stem: str, again: Callable[[np.ndarray, list[dict[str, Any]]], dict[str, Any]]
) -> dict[str, Any] | None:
    """Return one report of all lives; `again` makes it from their rows if there are several."""
    found = [_report(file) for file in _lives(run, stem)]
    reports = [report for report in found if report is not None]
    if len(reports) > 1:
        return again(_rows(run, stem), reports)
    return reports[0] if reports else None


def _rows(run: Path, stem: str) -> np.ndarray:
    """Return the rows of the lives that have a report. A table without one is incomplete."""
    tables = [file.with_suffix(".parquet") for file in _lives(run, stem)]
    return np.concatenate([read_parquet(table)[1] for table in tables])


def _edge_report(rows: np.ndarray, reports: list[dict[str, Any]]) -> dict[str, Any]:
    up = [report["link"]["uplink"] for report in reports]
    return edge_report(
        rows,
        statuses=_added(report["edge_solves"] for report in reports),
        sent=sum(report["link"]["downlink"]["sent"] for report in reports),
        received=sum(way["received"] for way in up),
        lost=sum(way["lost"] for way in up),
        refused=_added(way["refused"] for way in up),
    )


def _link_report(rows: np.ndarray, reports: list[dict[str, Any]]) -> dict[str, Any]:
    passes = sum(report["profile_passes"] for report in reports)
    return link_report(rows, profile=reports[-1]["profile"], passes=passes)


def _added(counts: Iterable[dict[str, int]]) -> dict[str, int]:
    total: Counter[str] = Counter()
    for each in counts:
        total.update(each)
    return dict(total)


def _discrepancy(run: Path) -> dict[str, Any] | None:
    """Return the report of the active set, from the ticks whose state the edge has solved."""
    if not _lives(run, _EDGE):
        return None
    schema, rows = read_parquet(run / f"{_ROBOT}.parquet", columns=_COMPARED)
    return discrepancy_report(schema, rows, _rows(run, _EDGE))


def _report(file: Path) -> dict[str, Any] | None:
    try:
        report: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return report
