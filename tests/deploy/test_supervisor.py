"""Real but tiny processes: what they print decides, never how long they take."""

from __future__ import annotations

import asyncio
import dataclasses
import errno
import os
from pathlib import Path

import pytest

from deploy import process, supervisor
from deploy.background.state import ENDED, READY, WAITING
from deploy.services import load_services
from deploy.supervisor import Launch, Supervisor
from shared.errors import ConfigError, LinkError
from shared.process.entry import python
from tests.members import replace_members
from tests.processes import PATIENCE_SECONDS

FAILS = "print('READY', flush=True); raise SystemExit(4)"
# Fails in its first life and serves in its second.
FAILS_ONCE = (
    "import pathlib; p = pathlib.Path('{0}'); again = p.exists(); p.touch(); "
    "print('READY', flush=True); __import__('time').sleep(3600 if again else 0); "
    "raise SystemExit(4)"
)
SLEEPS = "print('READY', flush=True); __import__('time').sleep(3600)"
# Never ready, and deaf to a termination signal.
DEAF = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); time.sleep(3600)"


# Loads, and goes on when its input ends.
HELD = (
    "import sys; print('loaded', flush=True); sys.stdin.read(); print('READY', flush=True); "
    "__import__('time').sleep(3600)"
)


class Run:
    """A supervisor, and what it said and did."""

    def __init__(self, folder: Path) -> None:
        self.output: list[str] = []
        self.supervisor = Supervisor(
            folder,
            lambda name, line: self.output.append(f"{name}: {line}"),
            changed=lambda: None,
        )

    async def start(self, name: str, code: str, **changes) -> None:
        await self.supervisor.start(launch(name, code, **changes))

    async def wait_for(self, line: str) -> None:
        while line not in self.output:
            await asyncio.sleep(0.01)

    async def signalled_by_stop(self, monkeypatch: pytest.MonkeyPatch) -> list[int]:
        """Stop the supervisor. Return the process groups that it signals, and signal none."""
        signalled: list[int] = []
        replace_members(
            monkeypatch, process, "os", killpg=lambda pid, number: signalled.append(pid)
        )
        await self.supervisor.stop()
        monkeypatch.undo()
        return signalled

    def state(self, name: str) -> str:
        return next(each.state for each in self.supervisor.states() if each.name == name)


def launch(name: str, code: str, *, ready_seconds: float = PATIENCE_SECONDS, **changes) -> Launch:
    service = dataclasses.replace(load_services()[name], **changes)
    return Launch(service, tuple(python("-c", code)), ready_seconds)


def played(folder: Path, scenario):
    """The result of a scenario; whatever it started has ended."""

    async def play():
        run = Run(folder)
        try:
            return await asyncio.wait_for(scenario(run), PATIENCE_SECONDS)
        finally:
            await run.supervisor.stop()
            for each in run.supervisor.states():
                with pytest.raises(ProcessLookupError):
                    os.killpg(each.pid, 0)
                assert each.state == ENDED

    return asyncio.run(play())


def test_a_service_is_ready_with_its_line_and_its_output_is_kept(tmp_path: Path):
    async def scenario(run: Run):
        await run.start("edge", "print('hello'); " + SLEEPS)
        assert run.state("edge") == READY
        assert run.output == ["edge: hello", "edge: READY"]

    played(tmp_path, scenario)
    assert (tmp_path / "edge.log").read_text() == "hello\nREADY\n"


def test_services_load_at_once_and_become_ready_one_after_the_other(tmp_path: Path):
    async def scenario(run: Run):
        launches = [launch(name, HELD) for name in ("edge", "netem")]
        for each in launches:
            await run.supervisor.load(each)
        await run.wait_for("edge: loaded")
        await run.wait_for("netem: loaded")
        for each in launches:
            await run.supervisor.start(each)
        assert run.output[2:] == ["edge: READY", "netem: READY"]

    played(tmp_path, scenario)


def test_a_service_that_ends_while_it_is_held_is_told_when_it_is_its_turn(tmp_path: Path):
    async def scenario(run: Run):
        await run.supervisor.load(launch("netem", "print('error: no room'); raise SystemExit(2)"))
        await run.start("edge", HELD)
        with pytest.raises(LinkError, match=r"netem did not start \(exit 2\): no room"):
            await run.start("netem", "")

    played(tmp_path, scenario)


def test_services_that_are_still_held_end_with_the_others(tmp_path: Path):
    async def scenario(run: Run):
        await run.supervisor.load(launch("robot", HELD))
        await run.start("edge", HELD)
        await run.wait_for("robot: loaded")

    played(tmp_path, scenario)
    assert "READY" not in (tmp_path / "robot.log").read_text()


def test_a_service_that_ends_before_it_is_ready_is_told_with_its_last_line(tmp_path: Path):
    async def scenario(run: Run):
        with pytest.raises(LinkError, match=r"edge did not start \(exit 2\): no port"):
            await run.start("edge", "print('error: no port'); raise SystemExit(2)")

    played(tmp_path, scenario)


def test_a_service_that_is_not_ready_in_time_is_ended(tmp_path: Path):
    async def scenario(run: Run):
        with pytest.raises(LinkError, match=r"edge was not ready within 0\.5 s"):
            await run.start("edge", DEAF, ready_seconds=0.5, stop_seconds=0.1)
        assert run.state("edge") == ENDED
        assert not run.supervisor.running("edge")

    played(tmp_path, scenario)


def test_output_that_finds_no_room_on_the_disk_is_shown_all_the_same(tmp_path: Path):
    (tmp_path / "edge.log").symlink_to("/dev/full")

    async def scenario(run: Run):
        await run.start("edge", "print('hello'); " + SLEEPS)
        assert run.output == ["edge: hello", "edge: READY"]

    played(tmp_path, scenario)


def test_a_line_without_end_is_dropped_and_the_next_one_is_read(tmp_path: Path):
    async def scenario(run: Run):
        await run.start("edge", "print('x' * 500_000); print('after'); " + SLEEPS)
        assert run.output[-2:] == ["edge: after", "edge: READY"]

    played(tmp_path, scenario)


def test_a_log_that_cannot_be_opened_is_left_out(tmp_path: Path):
    (tmp_path / "edge.log").mkdir()

    async def scenario(run: Run):
        await run.start("edge", SLEEPS)
        assert run.output == ["edge: READY"]

    played(tmp_path, scenario)


def test_a_service_that_ends_ends_the_run_with_its_exit_code(tmp_path: Path):
    async def scenario(run: Run):
        await run.start("netem", FAILS)
        return await run.supervisor.wait()

    service, code = played(tmp_path, scenario)
    assert (service.name, code) == ("netem", 4)


def test_the_end_of_a_view_is_not_the_end_of_the_run(tmp_path: Path):
    async def scenario(run: Run):
        await run.start("viewer", FAILS)
        await run.start("robot", FAILS)
        return await run.supervisor.wait()

    service, _ = played(tmp_path, scenario)
    assert service.name == "robot"


def test_a_service_that_fails_again_and_again_is_degraded_and_the_run_goes_on(tmp_path: Path):
    async def scenario(run: Run):
        await run.start("edge", FAILS, restart="on-failure:2/60s")
        await run.start("robot", SLEEPS)
        # One more than the failures that are no reason to wait.
        await run.wait_for("edge: ended (exit 4): starts again in 1 s (degraded), failure 3")
        edge = run.supervisor.states()[0]
        # On a slow machine it may have started again by now.
        assert edge.state in (WAITING, READY)
        assert edge.restarts >= 2
        assert edge.degraded
        await run.wait_for("edge: ended (exit 4): starts again in 2 s (degraded), failure 4")
        edge = run.supervisor.states()[0]
        assert edge.degraded_seconds >= 1.0
        assert run.supervisor.running("robot")
        # It need not wait for the next start.
        await run.supervisor.restart("edge")

    played(tmp_path, scenario)


def test_the_end_of_a_run_does_not_wait_for_the_next_start(tmp_path: Path, monkeypatch):
    async def scenario(run: Run):
        await run.start("edge", FAILS, restart="on-failure:1/60s")
        await run.wait_for("edge: ended (exit 4): starts again in 1 s (degraded), failure 2")
        # The number of the process that has ended may be another process's by now.
        assert await run.signalled_by_stop(monkeypatch) == []

    played(tmp_path, scenario)


def test_a_service_that_runs_for_its_window_is_no_longer_degraded(tmp_path: Path):
    async def scenario(run: Run):
        code = FAILS_ONCE.format(tmp_path / "first")
        await run.start("edge", code, restart="on-failure:1/1s")
        await run.wait_for("edge: has run for 1 s: earlier failures no longer count")
        edge = run.supervisor.states()[0]
        assert (edge.state, edge.restarts, edge.degraded) == (READY, 1, False)

    played(tmp_path, scenario)


def test_a_start_that_fails_is_tried_again(tmp_path: Path):
    code = (
        f"import pathlib; p = pathlib.Path('{tmp_path / 'lives'}'); "
        "n = len(p.read_text()) if p.exists() else 0; p.write_text('x' * (n + 1)); "
        "n == 1 and exit('error: no port'); print('READY', flush=True); "
        "__import__('time').sleep(3600 if n else 0); exit(4)"
    )

    async def scenario(run: Run):
        await run.start("edge", code)
        await run.wait_for("edge: edge did not start (exit 1): no port: starts again, failure 2")
        while not any("ready again" in line for line in run.output):
            await asyncio.sleep(0.01)
        assert run.supervisor.states()[0].restarts == 2

    played(tmp_path, scenario)


def test_a_service_that_came_back_goes_on(tmp_path: Path):
    async def scenario(run: Run):
        await run.start("edge", FAILS_ONCE.format(tmp_path / "first"))
        while not any("ready again" in line for line in run.output):
            await asyncio.sleep(0.01)
        assert run.state("edge") == READY
        assert run.supervisor.running("edge")

    played(tmp_path, scenario)


def test_a_restart_is_another_process_and_no_end(tmp_path: Path):
    async def scenario(run: Run):
        await run.start("netem", SLEEPS)
        first = run.supervisor.states()[0].pid
        await run.supervisor.restart("netem")
        (state,) = run.supervisor.states()
        assert state.pid != first
        assert (state.state, state.restarts) == (READY, 1)
        with pytest.raises(ProcessLookupError):
            os.killpg(first, 0)
        await run.start("robot", FAILS)
        service, _ = await run.supervisor.wait()
        assert service.name == "robot"

    played(tmp_path, scenario)
    assert (tmp_path / "netem.log").read_text() == "READY\nREADY\n"


def test_of_two_restarts_at_a_time_one_is_refused(tmp_path: Path):
    async def scenario(run: Run):
        await run.start("netem", SLEEPS)
        both = [run.supervisor.restart("netem") for _ in range(2)]
        first, second = await asyncio.gather(*both, return_exceptions=True)
        assert first is None
        assert isinstance(second, ConfigError)
        assert "netem is stopping already" in str(second)
        assert run.supervisor.states()[0].restarts == 1

    played(tmp_path, scenario)


def test_a_view_that_has_ended_can_be_started_again(tmp_path: Path):
    async def scenario(run: Run):
        await run.start("viewer", FAILS_ONCE.format(tmp_path / "first"))
        while run.state("viewer") != ENDED:
            await asyncio.sleep(0.01)
        await run.supervisor.restart("viewer")
        assert run.state("viewer") == READY

    played(tmp_path, scenario)


def test_the_number_of_what_has_ended_may_be_another_process(tmp_path: Path, monkeypatch):
    async def scenario(run: Run):
        await run.start("viewer", FAILS)
        while run.state("viewer") != ENDED:
            await asyncio.sleep(0.01)
        assert await run.signalled_by_stop(monkeypatch) == []

    played(tmp_path, scenario)


def test_a_restart_that_does_not_come_back_is_an_error_and_the_end(tmp_path: Path):
    code = (
        f"import pathlib; p = pathlib.Path('{tmp_path / 'second'}'); "
        f"p.exists() and exit('error: cannot'); p.touch(); {SLEEPS}"
    )

    async def scenario(run: Run):
        await run.start("netem", code)
        with pytest.raises(LinkError, match="netem did not start"):
            await run.supervisor.restart("netem")
        service, exit_code = await run.supervisor.wait()
        assert (service.name, exit_code) == ("netem", 1)

    played(tmp_path, scenario)


def test_a_restart_of_an_edge_that_fails_is_an_error_and_tried_again(tmp_path: Path):
    code = (
        f"import pathlib; p = pathlib.Path('{tmp_path / 'lives'}'); "
        "n = len(p.read_text()) if p.exists() else 0; p.write_text('x' * (n + 1)); "
        f"n == 1 and exit('error: cannot'); {SLEEPS}"
    )

    async def scenario(run: Run):
        await run.start("edge", code)
        with pytest.raises(LinkError, match="edge did not start"):
            await run.supervisor.restart("edge")
        while run.state("edge") != READY:
            await asyncio.sleep(0.01)
        assert run.supervisor.states()[0].restarts == 2

    played(tmp_path, scenario)


def test_a_process_that_the_system_refuses_is_an_error(tmp_path: Path, monkeypatch):
    async def refuse(*arguments, **options):
        raise OSError(errno.EAGAIN, "Resource temporarily unavailable")

    async def scenario(run: Run):
        await run.start("edge", FAILS_ONCE.format(tmp_path / "first"), restart="on-failure:1/60s")
        monkeypatch.setattr(supervisor, "start_process", refuse)
        reason = "edge cannot be started: Resource temporarily unavailable"
        await run.wait_for(f"edge: {reason}: starts again in 1 s (degraded), failure 2")
        monkeypatch.undo()
        while run.state("edge") != READY:
            await asyncio.sleep(0.01)

    played(tmp_path, scenario)


@pytest.mark.parametrize(
    ("name", "message"), [("viewer", "expected one of robot"), ("robot", "run ends with robot")]
)
def test_what_cannot_be_started_again_says_why(tmp_path: Path, name: str, message: str):
    async def scenario(run: Run):
        await run.start("robot", SLEEPS)
        with pytest.raises(ConfigError, match=message):
            await run.supervisor.restart(name)
        assert run.supervisor.running("robot")

    played(tmp_path, scenario)


def test_a_stop_that_takes_long_says_what_it_waits_for_and_can_be_cut_short(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(supervisor, "_TELL_SECONDS", 0.05)

    async def scenario(run: Run):
        await run.start("netem", SLEEPS)
        # Deaf before it is ready, so that no signal comes too early.
        ready = "print('READY', flush=True); time.sleep"
        await run.start("edge", DEAF.replace("time.sleep", ready))
        stopping = asyncio.create_task(run.supervisor.stop())
        waits = "up: waits for edge (pid "
        while not any(line.startswith(waits) for line in run.output):
            await asyncio.sleep(0.01)
        assert "to end, at most 60 s; Ctrl-C ends all at once" in run.output[-1]
        run.supervisor.kill()
        await stopping

    played(tmp_path, scenario)
