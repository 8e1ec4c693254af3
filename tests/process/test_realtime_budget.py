"""A loop stays below the share of a core that the kernel, or its machine, leaves it."""

from __future__ import annotations

import os

import pytest

from shared.process import realtime
from shared.process.realtime import (
    RealtimeBudget,
    RealtimeShare,
    just_above_ordinary,
    realtime_share,
)
from tests.members import replace_members

MS = 1_000_000


class Core:
    """A core's clock, on which a thread works or sleeps."""

    def __init__(self) -> None:
        self.now_ns = self.used_ns = 0
        self.slept_ns: list[int] = []

    def work(self, duration_ns: int) -> None:
        self.now_ns += duration_ns
        self.used_ns += duration_ns

    def sleep(self, seconds: float) -> None:
        self.slept_ns.append(round(seconds * 1e9))
        self.now_ns += self.slept_ns[-1]


@pytest.fixture
def core(monkeypatch: pytest.MonkeyPatch) -> Core:
    core = Core()
    replace_members(
        monkeypatch,
        realtime,
        "time",
        monotonic_ns=lambda: core.now_ns,
        thread_time_ns=lambda: core.used_ns,
        sleep=core.sleep,
    )
    return core


def turns(
    core: Core, budget: RealtimeBudget | RealtimeShare, *, work_ns: int, idle_ns: int
) -> None:
    for _ in range(10_000):
        core.work(work_ns)
        core.now_ns += idle_ns
        budget.keep(core.now_ns)


def test_a_loop_without_a_pause_leaves_its_share_in_short_pauses(monkeypatch, core):
    monkeypatch.setattr(realtime, "realtime_share", lambda: 0.95)
    turns(core, RealtimeBudget(), work_ns=MS, idle_ns=0)
    assert core.used_ns / core.now_ns < 0.95
    assert core.used_ns / core.now_ns > 0.92
    assert max(core.slept_ns) < 3 * MS


def test_a_loop_with_pauses_of_its_own_is_left_alone(monkeypatch, core):
    monkeypatch.setattr(realtime, "realtime_share", lambda: 0.95)
    turns(core, RealtimeBudget(), work_ns=9 * MS // 10, idle_ns=MS // 10)
    assert core.slept_ns == []


def test_without_a_limit_no_loop_is_paused(monkeypatch, core):
    monkeypatch.setattr(realtime, "realtime_share", lambda: 1.0)
    turns(core, RealtimeBudget(), work_ns=MS, idle_ns=0)
    assert core.slept_ns == []


@pytest.mark.parametrize(
    ("policy", "runtime", "share"),
    [("SCHED_FIFO", "950000", 0.95), ("SCHED_FIFO", "-1", 1.0), ("SCHED_OTHER", "950000", 1.0)],
)
def test_the_share_is_the_kernels_for_real_time_threads(
    monkeypatch, tmp_path, policy, runtime, share
):
    files = tmp_path / "runtime", tmp_path / "period"
    for file, text in zip(files, (runtime, "1000000"), strict=True):
        file.write_text(text + "\n")
    monkeypatch.setattr(realtime, "_RUNTIME", files[0])
    monkeypatch.setattr(realtime, "_PERIOD", files[1])
    replace_members(monkeypatch, realtime, "os", sched_getscheduler=lambda pid: getattr(os, policy))
    assert realtime_share() == share


@pytest.fixture
def policies(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, int]]:
    """The thread's scheduling by now, the newest last: policy and priority."""
    found = [(os.SCHED_FIFO, 10)]

    def put(pid: int, policy: int, parameters: os.sched_param) -> None:
        found.append((policy, parameters.sched_priority))

    replace_members(
        monkeypatch,
        realtime,
        "os",
        sched_getscheduler=lambda pid: found[-1][0],
        sched_getparam=lambda pid: os.sched_param(found[-1][1]),
        sched_setscheduler=put,
    )
    return found


def test_a_busy_loop_has_real_time_priority_for_its_share_of_every_window(core, policies):
    share, realtime_ns = RealtimeShare(0.2), 0
    for _ in range(10_000):
        core.work(MS)
        realtime_ns += MS if policies[-1][0] == os.SCHED_FIFO else 0
        share.keep(core.now_ns)
    # A turn may begin within the share and end beyond it.
    assert 0.2 <= realtime_ns / core.now_ns <= 0.26
    assert set(policies) == {(os.SCHED_FIFO, 10), (os.SCHED_OTHER, 0)}


def test_a_loop_within_its_share_keeps_its_priority(core, policies):
    share = RealtimeShare(0.2)
    for _ in range(1_000):
        core.work(MS)
        core.now_ns += 9 * MS
        share.keep(core.now_ns)
    assert policies == [(os.SCHED_FIFO, 10)]


def test_without_real_time_scheduling_a_share_changes_nothing(core, policies):
    policies[:] = [(os.SCHED_OTHER, 0)]
    turns(core, RealtimeShare(0.2), work_ns=MS, idle_ns=0)
    assert policies == [(os.SCHED_OTHER, 0)]


def test_threads_of_a_context_start_just_above_ordinary_ones(policies):
    policies[:] = [(os.SCHED_OTHER, 0)]
    with just_above_ordinary():
        assert policies[-1] == (os.SCHED_FIFO, 1)
    assert policies[-1] == (os.SCHED_OTHER, 0)
