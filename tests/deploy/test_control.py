"""`ps`, `logs` and `down` on stacks that are no more than a lock, a state and a process."""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import stat
import subprocess
from pathlib import Path

import pytest

from deploy.background import control, registry, state
from deploy.background.registry import Registry
from deploy.background.state import (
    ENDED,
    READY,
    WAITING,
    ServiceState,
    StackFolder,
    StackState,
)
from deploy.process_stat import process_started
from shared.errors import ConfigError, LinkError
from shared.file_lock import lock
from shared.process.entry import python
from tests.members import replace_members

# A stack that ends at a signal as one does: with a state that says so, then without its lock.
STANDS_IN = """
import dataclasses, pathlib, signal, sys
from deploy.background.state import ENDED, StackFolder
stack = StackFolder(pathlib.Path(sys.argv[1]))
with stack.claim():
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM])
    print("READY", flush=True)
    signal.sigwait([signal.SIGTERM])
    end = {"state": ENDED, "outcome": "stopped", "exit_code": 130}
    stack.write(dataclasses.replace(stack.read(), **end))
"""
SERVICES = (ServiceState("edge", 11, READY, 5.0, 2, None),)


@pytest.fixture(autouse=True)
def known(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Registry:
    folder = tmp_path / "stacks"
    monkeypatch.setattr(control, "Registry", lambda: Registry(folder))
    return Registry(folder)


def written(run: Path, **changes) -> StackFolder:
    """A stack that has ended, unless told otherwise; nobody holds its lock."""
    first = {"pid": 1, "robot": "romeo", "named": ("edge", "robot"), "state": ENDED, "since": 9.0}
    run.mkdir(exist_ok=True)
    stack = StackFolder(run)
    stack.claim().close()
    ended = {"services": SERVICES, "outcome": "it fell", "exit_code": 3}
    stack.write(StackState(**{**first, **ended, **changes}))
    return stack


@pytest.fixture
def running(tmp_path: Path):
    """A stack that runs, in a process of its own."""
    started = []

    def start(name: str = "run", **changes) -> StackFolder:
        changes = {"state": READY, "outcome": "", "exit_code": None, **changes}
        stack = written(tmp_path / name, **changes)
        process = subprocess.Popen(python("-c", STANDS_IN, str(stack.run)), stdout=subprocess.PIPE)
        started.append(process)
        assert process.stdout is not None
        assert process.stdout.readline() == b"READY\n"
        stack.write(dataclasses.replace(stack.read(), pid=process.pid))
        return stack

    yield start
    for process in started:
        process.kill()
        process.wait()
        process.stdout.close()


def asked(**changes) -> argparse.Namespace:
    return argparse.Namespace(
        **{"name": None, "run": None, "service": None, "format": "text", **changes}
    )


def test_with_nothing_there_ps_and_down_say_so_and_logs_is_an_error(capsys):
    assert control.run_ps(asked()) == 0
    assert control.run_down(asked()) == 0
    assert capsys.readouterr().out == "nothing is running\n" * 2
    with pytest.raises(ConfigError, match="up -d starts one"):
        control.run_logs(asked(follow=False))


def test_ps_shows_every_service_of_a_stack_that_runs(known, running, capsys):
    stack = running(named=("edge", "robot"))
    known.add(stack.run, robot="romeo", services=("edge", "robot"))
    assert control.run_ps(asked()) == 0
    message = capsys.readouterr().out
    assert "romeo, ready since" in message
    assert "  edge          11  ready " in message
    assert message.splitlines()[2].endswith(" 2")
    assert "  robot          -  not started" in message


def test_ps_as_json_has_every_stack_and_service(known, running, capsys):
    assert control.run_ps(asked(format="json")) == 0
    assert json.loads(capsys.readouterr().out) == []
    stack = running(named=("edge", "robot"))
    known.add(stack.run, robot="romeo", services=("edge", "robot"))
    assert control.run_ps(asked(format="json")) == 0
    (shown,) = json.loads(capsys.readouterr().out)
    assert (shown["run"], shown["alive"], shown["state"]) == (str(stack.run), True, READY)
    assert [service["name"] for service in shown["services"]] == ["edge"]


def test_ps_and_down_say_how_a_stack_ended_by_itself(known, tmp_path, capsys):
    known.add(written(tmp_path / "run").run, robot="romeo", services=("edge", "robot"))
    assert control.run_ps(asked()) == 0
    assert control.run_down(asked()) == 3
    message = capsys.readouterr().out
    assert message.count("nothing is running") == 2
    assert message.count("(exit 3): it fell") == 2


def test_ps_shows_what_has_killed_a_service(known, tmp_path, capsys):
    killed = (ServiceState("edge", 11, ENDED, 5.0, 2, -9),)
    known.add(written(tmp_path / "run", services=killed).run, robot="romeo", services=("edge",))
    assert control.run_ps(asked()) == 0
    assert "  edge           -  ended (signal 9) " in capsys.readouterr().out


def test_down_ends_what_runs_and_that_is_no_failure(known, running, capsys):
    stack = running()
    known.add(stack.run, robot="romeo", services=("edge", "robot"))
    pid = stack.read().pid
    assert control.run_down(asked()) == 0
    assert not stack.alive
    assert "(exit 130): stopped" in capsys.readouterr().out
    assert os.waitpid(pid, 0)[1] == 0


def test_a_stack_whose_supervisor_was_killed_is_an_error(known, tmp_path, capsys):
    stack = written(tmp_path / "run", state=READY, exit_code=None)
    known.add(stack.run, robot="romeo", services=("edge",))
    assert control.run_ps(asked()) == 0
    assert control.run_down(asked()) == 2
    message = capsys.readouterr().out
    assert "its supervisor was killed" in message
    assert " 11  ready" not in message


def test_a_robot_has_one_stack_of_a_kind_and_others_have_their_own(known, running):
    first = running("first", robot="amy", named=("edge", "robot"))
    known.add(first.run, robot="amy", services=("edge", "robot"))
    with pytest.raises(ConfigError, match=rf"edge of amy run already .*{first.run}"):
        known.add(first.run.parent / "other", robot="amy", services=("edge",))
    second = running("second", robot="ben")
    known.add(second.run, robot="ben", services=("edge", "robot"))
    third = running("third", robot="amy", named=("viewer",))
    known.add(third.run, robot="amy", services=("viewer",))
    assert len(known.current()) == 3
    assert {stack.run for stack, _ in known.current(robot="amy")} == {first.run, third.run}


def test_one_that_has_ended_makes_room_and_a_folder_that_is_gone_is_forgotten(known, tmp_path):
    known.add(written(tmp_path / "old").run, robot="romeo", services=("edge",))
    new = written(tmp_path / "new", since=10.0)
    known.add(new.run, robot="romeo", services=("edge",))
    assert [stack.run for stack, _ in known.current()] == [new.run]
    known.add(tmp_path / "gone", robot="amy", services=("edge",))
    assert known.found(robot="amy") == []


def test_while_one_runs_those_that_have_ended_are_not_meant(known, running, tmp_path):
    known.add(written(tmp_path / "old").run, robot="amy", services=("edge",))
    stack = running(robot="ben")
    known.add(stack.run, robot="ben", services=("edge", "robot"))
    assert [each.run for each, _ in known.current()] == [stack.run]


def test_of_several_stacks_one_has_to_be_named(known, running):
    for name in ("amy", "ben"):
        known.add(running(name, robot=name).run, robot=name, services=("edge", "robot"))
    with pytest.raises(ConfigError, match="with --name or --run"):
        control.run_logs(asked(follow=False))
    with pytest.raises(ConfigError, match="expected one of edge, robot, got 'viewer'"):
        control.run_logs(asked(follow=False, name="amy", service="viewer"))
    with pytest.raises(ConfigError, match="expected one of edge, netem"):
        control.run_logs(asked(follow=False, service="eggs"))


def test_logs_are_shown_as_they_were_said(tmp_path, capsys):
    stack = written(tmp_path / "run")
    stack.log.write_text("run folder: x\n  edge | READY\nStands after\n")
    (stack.run / "edge.log").write_text("READY\nlast, without an end")
    assert control.run_logs(asked(follow=True, run=stack.run)) == 0
    assert capsys.readouterr().out == stack.log.read_text()
    assert control.run_logs(asked(follow=True, run=stack.run, service="edge")) == 0
    assert capsys.readouterr().out == "  edge | READY\n  edge | last, without an end\n"
    assert control.run_logs(asked(follow=False, run=stack.run, service="robot")) == 0


def test_logs_that_are_followed_end_with_the_stack(running, capsys):
    stack = running()
    stack.log.write_text("    up | ready\n")
    os.kill(stack.read().pid, 15)
    assert control.run_logs(asked(follow=True, run=stack.run)) == 0
    assert not stack.alive
    assert capsys.readouterr().out == "    up | ready\n"


def test_a_restart_needs_a_stack_that_runs_and_answers(tmp_path, running):
    with pytest.raises(ConfigError, match="nothing is running"):
        control.run_restart(asked(service="edge", run=written(tmp_path / "old").run))
    with pytest.raises(LinkError, match="does not answer"):
        control.run_restart(asked(service="edge", run=running().run))


def test_a_stack_is_this_users_alone(tmp_path, known):
    stack = written(tmp_path / "run")
    known.add(stack.run, robot="romeo", services=("edge",))
    for folder in (stack.folder, tmp_path / "stacks"):
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
        files = [file for file in folder.iterdir() if not file.is_symlink()]
        assert files
        assert all(stat.S_IMODE(file.stat().st_mode) == 0o600 for file in files)


def test_the_state_of_another_user_is_refused(tmp_path, monkeypatch):
    stack = written(tmp_path / "run")
    replace_members(monkeypatch, state, "os", geteuid=lambda: os.getuid() + 1)
    with pytest.raises(ConfigError, match="expected a run of this user"):
        control.run_down(asked(run=stack.run))
    with pytest.raises(ConfigError, match="of another user"):
        stack.claim()


def test_a_process_that_has_the_number_of_a_stack_is_not_signalled(tmp_path, running, monkeypatch):
    stack = running()
    other = subprocess.Popen(python("-c", "__import__('time').sleep(3600)"))
    try:
        wrong = {"pid": other.pid, "started": process_started(stack.read().pid)}
        stack.write(dataclasses.replace(stack.read(), **wrong))
        with pytest.raises(LinkError, match="is held, and not by the stack"):
            control.run_down(asked(run=stack.run))
        assert other.poll() is None
    finally:
        other.kill()
        other.wait()


def test_the_start_of_a_process_tells_it_from_others():
    started = process_started(os.getpid())
    assert started == process_started(os.getpid())
    parent = process_started(os.getppid())
    assert started is not None
    assert parent is not None
    assert parent <= started
    assert process_started(2**22 + 1) is None


def test_a_lock_that_another_process_holds_is_waited_for_with_an_end(
    tmp_path, running, monkeypatch
):
    monkeypatch.setattr(state, "_LOCK_SECONDS", 0.1)
    with pytest.raises(ConfigError, match="another stack uses"):
        running().claim()
    monkeypatch.setattr(registry, "_LOCK_SECONDS", 0.1)
    folder = tmp_path / "stacks"
    folder.mkdir()
    with (folder / ".lock").open("w") as held:
        assert lock(held, within=0.0)
        with pytest.raises(ConfigError, match="another process has held"):
            Registry(folder).add(tmp_path, robot="romeo", services=("edge",))


def test_a_state_changes_on_a_full_disk(tmp_path, monkeypatch):
    stack = written(tmp_path / "run")
    blocks = (stack.folder / "state").stat().st_blocks
    stack.write(dataclasses.replace(stack.read(), outcome="it stands " * 50))
    assert stack.read().outcome == "it stands " * 50
    stack.write(dataclasses.replace(stack.read(), outcome="short"))
    assert stack.read().outcome == "short"
    # It has not grown, so it needed no room.
    assert (stack.folder / "state").stat().st_blocks == blocks


def test_links_that_lead_to_themselves_are_no_stacks(known, tmp_path, capsys):
    known.add(written(tmp_path / "run").run, robot="romeo", services=("edge",))
    (tmp_path / "stacks/amy.edge").symlink_to(tmp_path / "stacks/amy.edge")
    assert control.run_ps(asked()) == 0
    assert "it fell" in capsys.readouterr().out


def test_ps_shows_a_degraded_service(known, running, capsys):
    degraded = (ServiceState("edge", 11, WAITING, 5.0, 4, 4, degraded=True, degraded_seconds=3.0),)
    stack = running(services=degraded)
    known.add(stack.run, robot="romeo", services=("edge", "robot"))
    assert control.run_ps(asked()) == 0
    shown = capsys.readouterr().out
    assert "ready (edge degraded) since" in shown
    assert "waiting, degraded" in shown


def test_a_folder_that_is_no_run_is_an_error(tmp_path):
    with pytest.raises(ConfigError, match="folder of a run"):
        control.run_ps(asked(run=tmp_path))
