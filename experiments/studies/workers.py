"""Players of trials: processes of this machine, or the workers of a Dask cluster.

Both accept trials while others are played, and return records in the order of finishing. An error
within a trial is in its record. An exception means that the workers or the cluster are lost. The
processes of this machine can play other items than trials.
"""

from __future__ import annotations

# isort: off
import shared.process.native_libraries  # noqa: F401

# isort: on
import asyncio
import contextlib
import logging
import multiprocessing
import os
import queue
import re
import signal
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, Generic, TypeVar

from experiments.lockstep import Lockstep
from experiments.studies.code_identity import code_version
from experiments.studies.journal import Record
from experiments.studies.trial_sequence import Trial
from shared.config.settings import RunConfig
from shared.errors import ConfigError, UserError
from shared.output.versions import versions

EXAMPLE = "tcp://HOST:8786"
# A reachable scheduler answers within milliseconds. A worker may still be starting.
_SCHEDULER_WITHIN = 5.0
_WORKER_WITHIN = 20.0


Item = TypeVar("Item")


class Players(Generic[Item]):
    """A team of `number` workers. `lost` is the error message if the whole team is lost."""

    def __init__(self, submit: Callable[[Item], Any], *, number: int, lost: str) -> None:
        self.number = number
        self._submit, self._lost = submit, lost
        self._ended: queue.SimpleQueue[tuple[Item, Any]] = queue.SimpleQueue()

    def submit(self, trial: Item) -> None:
        """Queue a trial behind those submitted before it."""
        with self._still_there():
            future = self._submit(trial)
            future.add_done_callback(lambda future: self._ended.put((trial, future)))

    def finished(self) -> tuple[Item, Record]:
        """Wait for the next trial to finish. Return it and its record."""
        trial, future = self._ended.get()
        with self._still_there():
            return trial, future.result()

    @contextlib.contextmanager
    def _still_there(self) -> Iterator[None]:
        try:
            yield
        except UserError:
            raise
        except Exception as error:  # a trial's own errors are in its record
            raise ConfigError(f"{self._lost}; repeat to continue ({_in_a_line(error)})") from None


@contextlib.contextmanager
def players(workers: int, scheduler: str | None = None) -> Iterator[Players[Trial]]:
    """Open `workers` processes of this machine or, if `scheduler` is an address, its cluster.

    On leaving, no more trials begin. A process of this machine is killed; a worker of a cluster
    ends its present trial.
    """
    if scheduler is None:
        with local_players(workers, _play_trial) as here:
            yield here
    else:
        with _cluster(scheduler) as there:
            yield there


def play(config: RunConfig, all_active_sets: bool) -> Record:
    """Play one trial. Return its summary, or the error that ended it.

    A trial that is no result about the link has both, so that no study counts it.
    """

    def summary() -> dict[str, Any]:
        result = Lockstep(config, all_active_sets=all_active_sets).run()
        return {key: value for key, value in result.summary.items() if key != "versions"}

    record = recorded(summary)
    played = record["summary"]
    if played is not None and not played["valid"]:
        record["error"] = f"no result about the link: {'; '.join(played['invalid_reasons'])}"
    return record


def recorded(play: Callable[[], dict[str, Any]]) -> Record:
    """Return the summary that `play` returns, or the error that ended it."""
    started = time.perf_counter()
    summary: dict[str, Any] | None = None
    error = None
    try:
        summary = play()
    except Exception as exception:
        at = traceback.extract_tb(exception.__traceback__)[-1]
        text = " ".join(str(exception).split())
        error = f"{type(exception).__name__}: {text} ({Path(at.filename).name}:{at.lineno})"
    return {"summary": summary, "error": error, "wall_seconds": time.perf_counter() - started}


def _play_trial(trial: Trial) -> Record:
    return play(trial.config, trial.all_active_sets)


@contextlib.contextmanager
def local_players(workers: int, play: Callable[[Item], Record]) -> Iterator[Players[Item]]:
    """Open `workers` processes of this machine that play items. On leaving, they are killed.

    `play` and the items must be picklable.
    """
    context = multiprocessing.get_context("spawn")
    others = set(multiprocessing.active_children())
    executor = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin_worker)

    def submit(trial: Item) -> Any:
        # The workers inherit the mask. Ctrl-C interrupts this process, which then ends them.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return executor.submit(play, trial)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    try:
        killed = "a worker process was killed, perhaps for lack of memory: try fewer --workers"
        yield Players(submit, number=workers, lost=killed)
        executor.shutdown()
    finally:
        for process in set(multiprocessing.active_children()) - others:
            process.kill()
        executor.shutdown(cancel_futures=True)


def _begin_worker() -> None:
    """Lower the priority of this worker, and end it when the process of the sweep ends."""
    os.nice(5)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


@contextlib.contextmanager
def _cluster(address: str) -> Iterator[Players[Trial]]:
    try:
        import distributed
    except ImportError:
        raise ConfigError(
            "--scheduler: expected the package distributed, got none; try pip install '.[dask]'"
        ) from None
    expected = f"--scheduler: expected a Dask scheduler, as {EXAMPLE}, got {address!r}"
    if not re.fullmatch(r"(tcp|tls)://.+:[0-9]+", address):
        raise ConfigError(expected)
    # Errors of the cluster are reported in one line, below.
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
    try:
        client = distributed.Client(address, timeout=_SCHEDULER_WITHIN, set_as_default=False)
    except (OSError, asyncio.TimeoutError) as error:
        raise ConfigError(f"{expected}: {_in_a_line(error)}") from None
    try:
        try:
            client.wait_for_workers(1, timeout=_WORKER_WITHIN)
            number = len(client.nthreads())
        except (OSError, asyncio.TimeoutError):
            raise ConfigError(
                f"--scheduler: {address} has no worker after {_WORKER_WITHIN:g} s; start one in a "
                f"checkout of this commit: ./deploy/python -m dask worker {address} --nthreads 1"
            ) from None
        makings = _makings()

        def submit(trial: Trial) -> Any:
            given = (trial.config, trial.all_active_sets, makings)
            return client.submit(_play_there, *given, pure=False)

        lost = (
            f"--scheduler: {address} or its workers lost a trial; start workers in a checkout of "
            "this commit by ./deploy/python -m dask worker"
        )
        yield Players(submit, number=number, lost=lost)
    finally:
        # The scheduler drops trials that have not begun. A scheduler that is gone raises here.
        with contextlib.suppress(OSError, asyncio.TimeoutError):
            client.close()


def _play_there(config: RunConfig, all_active_sets: bool, makings: dict[str, str]) -> Record:
    """Play a trial on a worker of a cluster; `ConfigError` for a worker with other versions."""
    import distributed

    worker, here = distributed.get_worker(), _makings()
    for name, expected in makings.items():
        if here[name] != expected:
            raise ConfigError(
                f"--scheduler: expected {name} {expected} on every worker, as on this machine, got "
                f"{here[name]} on {worker.address}; bring both to the same commit and "
                "requirements.lock, and restart that worker by ./deploy/python -m dask worker"
            )
    if worker.state.nthreads != 1:
        raise ConfigError(
            f"--scheduler: expected workers with one thread, got {worker.state.nthreads} on "
            f"{worker.address}; start it with --nthreads 1, and with --nworkers for more workers"
        )
    return play(config, all_active_sets)


def _makings() -> dict[str, str]:
    """The versions on which rows depend: the code, Python, packages, and rounding."""
    packages = {name: made for name, made in versions().items() if name != "platform"}
    return {"code": code_version(), **packages}


def _in_a_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
