"""Plays a study: many lockstep trials on all cores, kept as they finish, in one table at the end.

`trials.jsonl` gets a line per finished trial: its identity, a hash of the complete configuration,
the version of the code, and its whole summary. The same command goes on after an interruption, and
plays again what ended with an error. Lines of other settings, or of other code, stay in the file
and are left out of `trials.parquet`, which has the columns that the study asks for.
"""

from __future__ import annotations

# isort: off
import shared.single_thread  # noqa: F401

# isort: on
import argparse
import contextlib
import datetime
import fcntl
import hashlib
import itertools
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any, BinaryIO

import tomli_w

from experiments.course import Trial
from experiments.dealing import Study
from experiments.lockstep import Lockstep
from experiments.study import read_study
from experiments.trial_table import row_of, table_in_words, write_trials
from shared.cli import EXIT_STANDING
from shared.config import RunConfig
from shared.errors import ConfigError
from shared.report import cpu_name, versions

_ROOT = Path(__file__).parents[1]
# What a trial runs through; studies and pictures can change without making trials void.
_CODE = ("shared", "robot_node", "edge_node", "netem", "experiments/lockstep.py")

Record = dict[str, Any]


def add_sweep_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `sweep`."""
    parser.add_argument("study", metavar="STUDY", help="a shipped study or a TOML file")
    parser.add_argument("--seeds", type=int, metavar="N", help="instead of the study's")
    parser.add_argument("--workers", type=int, metavar="N", help="processes; default: all cores")
    parser.add_argument("--out", type=Path, metavar="DIR", help="default runs/sweep-STUDY")
    parser.add_argument(
        "--only",
        action="append",
        metavar="NAME",
        help="play this cell or controller=la; repeatable",
    )
    parser.add_argument("--table", type=Path, metavar="FILE", help="write the table there as well")
    parser.add_argument("--keep-code", action="store_true", help="take trials of other code too")


def run_sweep(arguments: argparse.Namespace) -> int:
    """Play a study and print its table."""
    study = read_study(arguments.study, seeds=arguments.seeds)
    workers = arguments.workers
    if workers is None:
        workers = len(os.sched_getaffinity(0))
    if workers < 1:
        raise ConfigError(f"--workers: expected at least 1, got {workers}")
    out = arguments.out or Path("runs") / f"sweep-{study.name}"
    only = arguments.only or ()
    rows = sweep(study, out=out, workers=workers, only=only, keep_code=arguments.keep_code)
    table = table_in_words(rows, list(study.cells[0].shown))
    print(table)
    if arguments.table is not None:
        _write_table(arguments.table, table, study, out)
    return EXIT_STANDING


def sweep(
    study: Study, *, out: Path, workers: int = 1, only: Sequence[str] = (), keep_code: bool = False
) -> list[dict[str, Any]]:
    """Rows of the finished trials, by cell and seed, having played those missing in `out`.

    `only` names the cells to play, all if empty.
    """
    trials, chosen, code = study.trials, study.only(only), code_version()
    try:
        out.mkdir(parents=True, exist_ok=True)
        study_text = tomli_w.dumps(study.table)
        with _opened(out / "trials.jsonl") as file:
            (out / "study.toml").write_text(study_text, encoding="utf-8")
            records = _usable(file, trials, code=code, keep_code=keep_code)
            missing = [
                trial
                for trial in trials
                if trial.identity not in records and (not only or trial.cell in chosen)
            ]
            started, progress = time.perf_counter(), _Progress(records, len(missing))
            with contextlib.closing(_played(missing, workers=workers)) as played:
                for trial, record in played:
                    known = {"trial": trial.identity, "code": code, "label": trial.label}
                    record = known | record
                    file.write(json.dumps(record).encode() + b"\n")
                    file.flush()
                    records[trial.identity] = record
                    row_of(trial, record, study.columns)  # an unknown column ends it here
                    progress.finished(record)
        by_cell = sorted(trials, key=lambda trial: trial.cell)
        finished = [trial for trial in by_cell if trial.identity in records]
        rows = [row_of(trial, records[trial.identity], study.columns) for trial in finished]
        write_trials(rows, out)
        if missing:
            about = _about(study, code=code, played=len(missing), started=started, workers=workers)
            about["trial_seconds"] = sum(record["wall_seconds"] for record in records.values())
            (out / "about.json").write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        where = error.filename or out
        raise ConfigError(f"out: cannot write {where}: {error.strerror}") from None
    except KeyboardInterrupt:
        print(f"interrupted; the same command goes on with {out}", file=sys.stderr)
        raise
    return rows


def _write_table(path: Path, table: str, study: Study, out: Path) -> None:
    """The table with how and where it was made."""
    try:
        about = json.loads((out / "about.json").read_text(encoding="utf-8"))
        made = about["versions"]
        packages = ", ".join(f"{name} {made[name]}" for name in ("python", "mujoco", "pin", "daqp"))
        lines = [
            about["description"],
            f"python -m experiments sweep {study.name} --seeds {study.seeds}",
            f"{about['machine']['cpu']}; {packages}; commit {str(about['commit'])[:10]}, "
            f"{about['date'][:10]}; means over the trials that finished standing",
            "",
            table,
        ]
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"table: cannot write {path}: {error.strerror}") from None


def code_version() -> str:
    """Hash of the sources that a trial runs through."""
    digest = hashlib.sha256()
    parts = [_ROOT / name for name in _CODE]
    files = [[part] if part.is_file() else part.rglob("*.py") for part in parts]
    for path in sorted(itertools.chain(*files)):
        digest.update(path.relative_to(_ROOT).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    """The file of finished trials, for one sweep alone, without a half-written last line."""
    with path.open("a+b") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ConfigError(
                f"out: another sweep writes to {path.parent}; wait for it or give another --out"
            ) from None
        file.seek(0)
        file.truncate(file.read().rfind(b"\n") + 1)
        yield file


def _usable(
    file: BinaryIO, trials: Sequence[Trial], *, code: str, keep_code: bool
) -> dict[str, Record]:
    """Finished trials of the study, by identity; says how many lines are of no use to it."""
    file.seek(0)
    try:
        records = [json.loads(line) for line in file]
        known = {trial.identity for trial in trials}
        wanted = [record for record in records if record["trial"] in known]
        # Of two, the one of this code.
        wanted.sort(key=lambda record: record["code"] == code)
        taken = [record for record in wanted if keep_code or record["code"] == code]
    except (ValueError, LookupError, TypeError) as error:
        raise ConfigError(f"out: {file.name} has a line that is no trial: {error}") from None
    if len(taken) < len(records):
        print(
            f"trials of {file.name} left out: {len(records) - len(wanted)} of other settings or "
            f"seeds, {len(wanted) - len(taken)} of other code (--keep-code takes these)",
            file=sys.stderr,
        )
    return {record["trial"]: record for record in taken if record["error"] is None}


def _played(
    trials: Sequence[Trial], *, workers: int
) -> Generator[tuple[Trial, Record], None, None]:
    """Trials and their records, as worker processes finish them."""
    context = multiprocessing.get_context("spawn")
    others = set(multiprocessing.active_children())
    executor = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin_worker)
    # The workers inherit it: Ctrl-C is for this process, which then ends them.
    heard = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        playing = {
            executor.submit(play, trial.config, trial.all_active_sets): trial for trial in trials
        }
        signal.signal(signal.SIGINT, heard)
        for future in as_completed(playing):
            yield playing[future], future.result()
        executor.shutdown()
    except BrokenProcessPool:
        raise ConfigError(
            "a worker process was killed, perhaps for want of memory; repeat to go on, with fewer "
            "--workers"
        ) from None
    finally:
        signal.signal(signal.SIGINT, heard)
        for process in set(multiprocessing.active_children()) - others:
            process.kill()
        executor.shutdown(cancel_futures=True)


def _begin_worker() -> None:
    """Give way to everything else, and do not outlive the sweep, however it ends."""
    os.nice(5)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


def play(config: RunConfig, all_active_sets: bool) -> Record:
    """What one trial came to: its summary, or the error that ended it."""
    started = time.perf_counter()
    summary: dict[str, Any] | None = None
    error = None
    try:
        result = Lockstep(config, all_active_sets=all_active_sets).run()
        summary = {key: value for key, value in result.summary.items() if key != "versions"}
    except Exception as exception:
        at = traceback.extract_tb(exception.__traceback__)[-1]
        said = " ".join(str(exception).split())
        error = f"{type(exception).__name__}: {said} ({Path(at.filename).name}:{at.lineno})"
    return {"summary": summary, "error": error, "wall_seconds": time.perf_counter() - started}


class _Progress:
    """How far it is, in one line: rewritten in place on a terminal, else every ten seconds."""

    def __init__(self, records: dict[str, Record], missing: int) -> None:
        self._kept, self._missing, self._played = len(records), missing, 0
        self._falls = sum(record["summary"]["fell"] for record in records.values())
        self._started = self._printed = time.perf_counter()

    def finished(self, record: Record) -> None:
        """One more."""
        self._played += 1
        self._falls += bool(record["summary"] and record["summary"]["fell"])
        now, terminal = time.perf_counter(), sys.stderr.isatty()
        last = self._played == self._missing
        if not (terminal or last or now - self._printed >= 10):
            return
        self._printed = now
        rate = self._played / (now - self._started)
        left = round((self._missing - self._played) / rate)
        line = (
            f"trials {self._kept + self._played}/{self._kept + self._missing}, "
            f"{self._falls} falls, {60 * rate:.1f}/min, {left // 60}:{left % 60:02} left"
        )
        start, end = ("\r\x1b[K", "" if not last else "\n") if terminal else ("", "\n")
        print(f"{start}{line}", end=end, file=sys.stderr, flush=True)


def _about(study: Study, *, code: str, played: int, started: float, workers: int) -> dict[str, Any]:
    seconds = time.perf_counter() - started
    status = _git("status", "--porcelain")
    return {
        "study": study.name,
        "description": study.table.get("description", ""),
        "date": datetime.datetime.now().astimezone().isoformat(timespec="seconds"),
        "machine": {"cpu": cpu_name(), "cores": os.cpu_count()},
        "versions": versions(),
        "commit": _git("rev-parse", "HEAD"),
        "dirty": None if status is None else bool(status),
        "code": code,
        "seeds": study.seeds,
        "workers": workers,
        "played": played,
        "wall_seconds": round(seconds, 1),
        "trials_per_minute": round(60 * played / seconds, 2),
    }


def _git(*arguments: str) -> str | None:
    command = ["git", "-C", str(_ROOT), *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()
