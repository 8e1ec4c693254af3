"""Who plays trials: processes of this machine, or the workers of a Dask cluster.

Both take trials one at a time, while others are played, and give back records as they finish. What
fails in a trial is in its record; an exception says that nobody is there to play.
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
from typing import Any

from experiments.lockstep import Lockstep
from experiments.studies.code_identity import code_version
from experiments.studies.journal import Record
from experiments.studies.trial_sequence import Trial
from shared.config.settings import RunConfig
from shared.errors import ConfigError, UserError
from shared.output.versions import versions

EXAMPLE = "tcp://HOST:8786"
# A scheduler that answers at all answers within milliseconds; a worker may be just starting.
_SCHEDULER_WITHIN = 5.0
_WORKER_WITHIN = 20.0


class Players:
    """Whoever plays: `number` of them at the same time. `lost` says what ends them all."""

    def __init__(self, submit: Callable[[Trial], Any], *, number: int, lost: str) -> None:
        self.number = number
        self._submit, self._lost = submit, lost
        self._ended: queue.SimpleQueue[tuple[Trial, Any]] = queue.SimpleQueue()

    def submit(self, trial: Trial) -> None:
        """Have a trial played, after those submitted before it."""
        with self._still_there():
            future = self._submit(trial)
            future.add_done_callback(lambda future: self._ended.put((trial, future)))

    def finished(self) -> tuple[Trial, Record]:
        """The next trial to finish, and its record; waits for it."""
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
            raise ConfigError(f"{self._lost}; repeat to go on ({_in_a_line(error)})") from None


@contextlib.contextmanager
def players(workers: int, scheduler: str | None = None) -> Iterator[Players]:
    """`workers` processes of this machine or, given its address, the cluster of a scheduler.

    On leaving, nothing of it is played any more; a worker of a cluster ends the trial it is at.
    """
    with _local(workers) if scheduler is None else _cluster(scheduler) as them:
        yield them


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
        text = " ".join(str(exception).split())
        error = f"{type(exception).__name__}: {text} ({Path(at.filename).name}:{at.lineno})"
    return {"summary": summary, "error": error, "wall_seconds": time.perf_counter() - started}


@contextlib.contextmanager
def _local(workers: int) -> Iterator[Players]:
    context = multiprocessing.get_context("spawn")
    others = set(multiprocessing.active_children())
    executor = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin_worker)

    def submit(trial: Trial) -> Any:
        # The workers inherit it: Ctrl-C is for this process, which then ends them.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return executor.submit(play, trial.config, trial.all_active_sets)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    try:
        killed = "a worker process was killed, perhaps for want of memory: try fewer --workers"
        yield Players(submit, number=workers, lost=killed)
        executor.shutdown()
    finally:
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


@contextlib.contextmanager
def _cluster(address: str) -> Iterator[Players]:
    try:
        import distributed
    except ImportError:
        raise ConfigError(
            "--scheduler: needs the package distributed, as pip install '.[dask]' brings it"
        ) from None
    expected = f"--scheduler: expected a Dask scheduler, as {EXAMPLE}, got {address!r}"
    if not re.fullmatch(r"(tcp|tls)://.+:[0-9]+", address):
        raise ConfigError(expected)
    # What ends it is told in one line, below.
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
                f"--scheduler: {address} has no worker after {_WORKER_WITHIN:g} s; start some in a "
                f"checkout of this commit: ./deploy/python -m dask worker {address} --nthreads 1"
            ) from None
        makings = _makings()

        def submit(trial: Trial) -> Any:
            given = (trial.config, trial.all_active_sets, makings)
            return client.submit(_play_there, *given, pure=False)

        lost = (
            f"--scheduler: a trial was lost by {address} or its workers, which have to run in a "
            "checkout of this commit, by ./deploy/python -m dask worker"
        )
        yield Players(submit, number=number, lost=lost)
    finally:
        # It forgets what has not begun; a scheduler that is gone has nothing to forget.
        with contextlib.suppress(OSError, asyncio.TimeoutError):
            client.close()


def _play_there(config: RunConfig, all_active_sets: bool, makings: dict[str, str]) -> Record:
    """`play`, on a worker of a cluster; `ConfigError` where its rows could differ from ours."""
    import distributed

    worker, here = distributed.get_worker(), _makings()
    for name, expected in makings.items():
        if here[name] != expected:
            raise ConfigError(
                f"--scheduler: expected {name} {expected}, as here, on every worker, got "
                f"{here[name]} on {worker.address}; bring both to the same commit and "
                "requirements.lock, and start that worker anew by ./deploy/python -m dask worker"
            )
    if worker.state.nthreads != 1:
        raise ConfigError(
            f"--scheduler: expected workers of one thread, got {worker.state.nthreads} on "
            f"{worker.address}; start it with --nthreads 1, and --nworkers for more of them"
        )
    return play(config, all_active_sets)


def _makings() -> dict[str, str]:
    """What rows depend on beside the settings: the code, Python, packages, and how they round."""
    packages = {name: made for name, made in versions().items() if name != "platform"}
    return {"code": code_version(), **packages}


def _in_a_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
