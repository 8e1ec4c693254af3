"""The workers of a Dask cluster play what processes of this machine play, to the same rows."""

from __future__ import annotations

import subprocess
import sys

import pytest

from experiments.studies.study_file import read_study
from experiments.studies.sweep import sweep
from shared.errors import ConfigError
from shared.process.entry import python
from tests.processes import until

STUDY = """
seeds = 2
columns = ["fell", "com_error_m", "log_hash"]

[base]
duration = 0.05
push = []
link.network = "constant:0ms"

[bisect]
setting = "loop.edge_compute_ns"
value = 1000
high = 100
resolution = 50
"""


def started(process, log, line):
    """Wait for a line in the log of a process; its last word."""

    def word():
        assert process.poll() is None, f"{process.args} ended: {log.read_text()}"
        lines = log.read_text().splitlines(keepends=True)
        return next(
            (message.split()[-1] for message in lines if line in message and message[-1] == "\n"),
            None,
        )

    return until(word, lambda: f"{process.args} did not say {line!r}: {log.read_text()}")


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """The address of a scheduler with two workers, all processes of their own."""
    folder, processes = tmp_path_factory.mktemp("cluster"), []
    # Without a nanny a worker is one process, which can be ended by its number.
    one = ["--nthreads", "1", "--no-nanny", "--local-directory", str(folder)]

    def start(name, line, *arguments):
        log = folder / f"{name}.log"
        here = ["--host", "127.0.0.1", "--no-dashboard"]
        with log.open("w") as file:
            process = subprocess.Popen(
                python("-m", "dask", *arguments, *here),
                cwd=folder,
                stdout=file,
                stderr=subprocess.STDOUT,
            )
        processes.append(process)
        return started(process, log, line)

    try:
        address = start("scheduler", "Scheduler at:", "scheduler", "--port", "0")
        for k in range(2):
            start(f"worker-{k}", "Registered to:", "worker", address, *one)
        yield address
    finally:
        for process in reversed(processes):
            process.kill()
            process.wait()


@pytest.fixture
def study(study_of):
    return study_of(STUDY)


def test_a_cluster_gives_the_rows_of_local_processes(cluster, study, tmp_path):
    rows = sweep(study, out=tmp_path / "cluster", scheduler=cluster)
    assert [row["error"] for row in rows] == [None] * 2
    assert rows == sweep(study, out=tmp_path / "here", workers=1)
    # The journal is here: nothing is left to play, by whomever.
    assert sweep(study, out=tmp_path / "cluster", scheduler="tcp://127.0.0.1:9") == rows
    finer = read_study(tmp_path / "cluster", seeds=3)
    assert sweep(finer, out=tmp_path / "cluster", scheduler=cluster)[:2] == rows
    assert len((tmp_path / "cluster" / "trials.jsonl").read_text().splitlines()) == 3


def test_a_worker_of_other_code_or_packages_does_not_play(cluster, study, tmp_path, monkeypatch):
    monkeypatch.setattr("experiments.studies.workers.code_version", lambda: "another")
    with pytest.raises(ConfigError, match=r"code another on every worker, .* got [0-9a-f]{16} on"):
        sweep(study, out=tmp_path / "out", scheduler=cluster)
    assert (tmp_path / "out" / "trials.jsonl").read_text() == ""
    monkeypatch.undo()
    monkeypatch.setattr("experiments.studies.workers.versions", lambda: {"mujoco": "0.1"})
    with pytest.raises(ConfigError, match=r"expected mujoco 0\.1 on every worker"):
        sweep(study, out=tmp_path / "out", scheduler=cluster)


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("tcp://127.0.0.1:9", "got 'tcp://127.0.0.1:9': Timed out trying to connect"),
        ("127.0.0.1:8786", "expected a Dask scheduler, as tcp://HOST:8786, got '127.0.0.1:8786'"),
        ("udp://127.0.0.1:1", "got 'udp://127.0.0.1:1'"),
        ("", "got ''"),
    ],
)
def test_a_scheduler_that_is_not_there_is_an_error_in_one_line(
    study, tmp_path, monkeypatch, address, message
):
    monkeypatch.setattr("experiments.studies.workers._SCHEDULER_WITHIN", 0.5)
    with pytest.raises(ConfigError) as caught:
        sweep(study, out=tmp_path, scheduler=address)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_without_the_package_there_is_no_cluster(study, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ConfigError, match="expected the package distributed"):
        sweep(study, out=tmp_path, scheduler="tcp://127.0.0.1:9")
