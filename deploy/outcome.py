"""The summary and the recording of a run, made from the files of its services.

A service that was started again has left files of each of its lives, as `shared.telemetry.lives`
describes them, and all lives count together. A life that was killed leaves rows and no report: its
part is then made from the rows.
"""

from __future__ import annotations

import json
import shutil
import subprocess
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from deploy.neighbours import Neighbours
from deploy.process_stat import processor_seconds
from shared.commands import wbc
from shared.config.extensions import corrects
from shared.config.settings import RunConfig
from shared.file_lock import is_locked
from shared.output.link_met import link_met
from shared.output.report import discrepancy_report, edge_report, link_report, robot_report
from shared.output.summary import summary
from shared.output.validity import Machine, edge_ms, shim_ms, stalls_s
from shared.process.entry import python
from shared.process.realtime import usable_cores
from shared.telemetry.lives import KINDS, lives, recover
from shared.telemetry.parquet import read_parquet
from shared.telemetry.row_log import read_rows
from shared.telemetry.schema import SOLVE_SCHEMA, Schema
from shared.wbc.qp import QpStatus
from shared.wire.operator.events import EVENTS_FILE

SUMMARY = "summary.json"
_ROBOT, _EDGE, _LINK = "telemetry", "edge", "link"
# The stems of all files of rows. The robot writes its steps beside its ticks.
STEMS = (_ROBOT, "steps", _EDGE, _LINK)
# The recording's process is ended if it uses less than this share of a core for so long [s].
_IDLE_SECONDS, _IDLE_SHARE = 30.0, 0.005
# Only these columns are read: all columns of an hour do not fit into memory.
_COMPARED = ("tick", "time_ns", "wall_ns", "active_set", "com_error_m", "contact_violation_m_s2")


def summarise(
    run: Path,
    config: RunConfig,
    say: Callable[[str], None],
    *,
    services: dict[str, Any] | None = None,
    neighbours: Neighbours | None = None,
    failure: str | None = None,
) -> dict[str, Any] | None:
    """Return the summary, and write it to `summary.json` in place of the services' reports.

    `services` is the supervisor's part, `neighbours` the other work on this machine, None if it is
    unknown. `failure` tells which service has ended the run by its failure: such a run is no
    result. Rows of killed lives become Parquet. `say` gets a line for a file that cannot be
    written. Return None if the robot left neither a report nor rows.
    """
    result = _summary(run, config, services or {}, neighbours or Neighbours())
    if result is not None:
        if failure is not None:
            reasons = [failure, *result["invalid_reasons"]]
            result |= {"valid": False, "invalid_reasons": reasons}
        text = json.dumps(result, indent=2)
        try:
            (run / SUMMARY).write_text(text + "\n", encoding="utf-8")
        except OSError as error:
            say(f"cannot write {run / SUMMARY}: {error.strerror}; free space on the disk")
        else:
            for stem in STEMS:
                for name in lives(run, stem):
                    (run / f"{name}.json").unlink(missing_ok=True)
    for stem in STEMS:
        try:
            recover(run, stem)
        except OSError as error:
            say(
                f"cannot write all rows as Parquet into {run}: {error.strerror or error}; the rows "
                f"are in the files *.rows; free space, and {wbc(f'viewer open {run}')} tries again"
            )
            break
    return result


def _summary(
    run: Path, config: RunConfig, services: dict[str, Any], neighbours: Neighbours
) -> dict[str, Any] | None:
    robot = _whole(run, _ROBOT, _edge_report, _robot_from_rows)
    if robot is None:
        return None
    result = summary(
        config,
        robot=robot,
        edge=_whole(run, _EDGE, _edge_report, _edge_from_rows),
        link=_whole(run, _LINK, _link_report, partial(_link_from_rows, config.link.network)),
        **_joined(run, config, neighbours),
    )
    return {**result, "services": services}


def is_running(run: Path) -> bool:
    """Return whether a service still writes its rows into this folder."""
    return any(is_locked(run / f"{stem}.rows") for stem in STEMS)


def set_aside(run: Path) -> None:
    """Move the files of an earlier run into the folder `previous`, replacing its files."""
    kept = [run / f"{name}.{kind}" for stem in STEMS for name in lives(run, stem) for kind in KINDS]
    others = (run / SUMMARY, run / "recording.rrd", run / EVENTS_FILE)
    kept = [file for file in (*kept, *others) if file.exists()]
    if not kept:
        return
    previous = run / "previous"
    shutil.rmtree(previous, ignore_errors=True)
    previous.mkdir(exist_ok=True)
    for file in kept:
        file.replace(previous / file.name)


def record(run: Path, say: Callable[[str], None]) -> None:
    """Make the recording of a run from its files, if no viewer recorded the whole run.

    Rerun may wait for ever if it cannot write. A process without progress is ended.
    """
    with subprocess.Popen(
        python("-m", "viewer", "record", str(run)),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as making:
        used = -1.0
        while True:
            try:
                output, _ = making.communicate(timeout=_IDLE_SECONDS)
                break
            except subprocess.TimeoutExpired:
                before, used = used, processor_seconds(making.pid)
                if used - before < _IDLE_SHARE * _IDLE_SECONDS:
                    making.kill()
                    making.communicate()
                    (run / "recording.rrd.partial").unlink(missing_ok=True)
                    output = (
                        "no recording: expected rerun to write one, got no progress; "
                        f"{wbc(f'viewer record {run}')} tries again"
                    )
                    break
    for line in output.splitlines():
        say(line)


_Rows = tuple[Schema, np.ndarray]


def _whole(
    run: Path,
    stem: str,
    join: Callable[[np.ndarray, list[dict[str, Any]]], dict[str, Any]],
    from_rows: Callable[[_Rows], dict[str, Any]],
) -> dict[str, Any] | None:
    """Return one report of all lives; `join` makes it from their rows if there are several.

    `from_rows` makes the report of a life that was killed. The robot's last life counts alone,
    because each of its lives is a run.
    """
    names = lives(run, stem)[-1 if stem == _ROBOT else 0 :]
    if len(names) == 1 and (report := _report(run / f"{names[0]}.json")) is not None:
        return report
    reports, tables = [], []
    for name in names:
        report, rows = _report(run / f"{name}.json"), _rows(run, name)
        if report is None and rows is not None:
            report = from_rows(rows)
        if report is not None:
            reports.append(report)
            tables += [] if rows is None else [rows[1]]
    if len(reports) > 1 and tables:
        return join(np.concatenate(tables), reports)
    return reports[-1] if reports else None


def _rows(run: Path, name: str, *, columns: Sequence[str] | None = None) -> _Rows | None:
    """Return the rows of a life, from Parquet or from its rows; None if it left neither."""
    try:
        return read_parquet(run / f"{name}.parquet", columns=columns)
    except (OSError, ValueError, pa.ArrowException):
        pass
    try:
        return read_rows(run / f"{name}.rows")
    except (OSError, ValueError):
        return None


def _robot_from_rows(rows: _Rows) -> dict[str, Any]:
    schema, table = rows
    return robot_report(
        schema,
        table,
        fell=None,
        wall_seconds=float(np.ptp(schema.column(table, "wall_ns"))) * 1e-9 if len(table) else 0.0,
        sent=len(table),
        received=None,
        lost=None,
        refused=None,
        answers=None,
        sensor_faults=None,
        base_estimate=None,
        torque_limits={},
    )


def _edge_from_rows(rows: _Rows) -> dict[str, Any]:
    schema, table = rows
    status = schema.column(table, "status").astype(int)
    return edge_report(
        table,
        statuses={
            each.value: int(np.sum(status == index))
            for index, each in enumerate(QpStatus)
            if np.any(status == index)
        },
        sent=None,
        received=None,
        lost=None,
        refused=None,
    )


def _link_from_rows(profile: str, rows: _Rows) -> dict[str, Any]:
    return link_report(rows[1], profile={"profile": profile}, passes=0)


def _edge_report(rows: np.ndarray, reports: list[dict[str, Any]]) -> dict[str, Any]:
    up = [report["link"]["uplink"] for report in reports]
    return edge_report(
        rows,
        statuses=_added(report["edge_solves"] for report in reports),
        sent=_sum(report["link"]["downlink"]["sent"] for report in reports),
        received=_sum(way["received"] for way in up),
        lost=_sum(way["lost"] for way in up),
        refused=_added(way["refused"] or {} for way in up),
    )


def _link_report(rows: np.ndarray, reports: list[dict[str, Any]]) -> dict[str, Any]:
    """The report of several lives. Each life began the profile anew, so the report has no place in
    the profile.
    """
    passes = sum(report["profile_passes"] for report in reports)
    profile = {key: reports[-1][key] for key in ("profile", "profile_worst_outage")}
    return link_report(rows, profile=profile, passes=passes)


def _sum(counts: Iterable[int | None]) -> int | None:
    """Return the sum of the known counts; None if all are unknown."""
    known = [count for count in counts if count is not None]
    return sum(known) if known else None


def _added(counts: Iterable[dict[str, int]]) -> dict[str, int]:
    total: Counter[str] = Counter()
    for each in counts:
        total.update(each)
    return dict(total)


def _joined(run: Path, config: RunConfig, neighbours: Neighbours) -> dict[str, Any]:
    """Return the parts of the summary that need the rows of several services."""
    ticks = _rows(run, _ROBOT, columns=_COMPARED)
    solve_rows, link_rows = (_all_rows(run, stem) for stem in (_EDGE, _LINK))
    discrepancy = met = response = stalls = None
    if ticks is not None and solve_rows is not None:
        discrepancy = discrepancy_report(*ticks, solve_rows)
        # Without a shim here, only a direct link has no delay.
        if link_rows is not None or config.link.network == "direct":
            response = edge_ms(*ticks, link_rows, solve_rows)
    if ticks is not None and link_rows is not None:
        solves = np.empty((0, SOLVE_SCHEMA.width)) if solve_rows is None else solve_rows
        met = link_met(*ticks, link_rows, solves, steady=not corrects(config.controller))
        if _lived_once(run, _LINK):
            stalls = stalls_s(*ticks, link_rows, solve_rows if _lived_once(run, _EDGE) else None)
    lateness = None if link_rows is None else shim_ms(link_rows)
    machine = Machine(
        usable_cores(),
        neighbours.most,
        response,
        lateness,
        other_cores=neighbours.cores,
        stalls_s=stalls,
    )
    return {"discrepancy": discrepancy, "met": met, "machine": machine}


def _lived_once(run: Path, stem: str) -> bool:
    """Return whether a service ran from its beginning to its report.

    A service that was started again, or that was killed, stood still for that reason.
    """
    return len(lives(run, stem)) == 1 and _report(run / f"{stem}.json") is not None


def _all_rows(run: Path, stem: str) -> np.ndarray | None:
    """Return the rows of all lives of a service; None if it left none."""
    tables = [rows[1] for name in lives(run, stem) if (rows := _rows(run, name)) is not None]
    return np.concatenate(tables) if tables else None


def _report(file: Path) -> dict[str, Any] | None:
    try:
        report: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return report
