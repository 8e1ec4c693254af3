"""Faults of processes, machines and users, on live stacks.

Each fault waits for events and never for a number of seconds. Afterwards the state, the files and
the processes of the stack are compared with what happened.
"""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.faults.cases import Case, Draw, Parameters
from benchmarks.faults.stacks import (
    Command,
    Stacks,
    agrees_after,
    agrees_while_running,
    has_fallen,
    is_clean,
    is_readable,
    pid_of,
    rows_in,
    stacks,
    state_of,
    until,
)
from benchmarks.link_paths import free_endpoints
from benchmarks.real_path.namespaces import two_machines
from deploy.keys import make
from shared.errors import UserError
from shared.process.cli import EXIT_FELL, EXIT_STANDING
from shared.process.entry import EXIT_ERROR, EXIT_INTERRUPTED, python

_NOBODY = 65534
_MIB = 2**20
_SILENT, _BACK = "no answer for", "new answers again"

Outcome = dict[str, Any]
Play = Callable[[Stacks, Parameters], Outcome]


class _NotHereError(Exception):
    """The machine does not allow a fault; the text is the reason."""


def play(case: Case) -> Outcome:
    """Play a case on new stacks. `skipped` is the reason if the machine does not allow it."""
    with tempfile.TemporaryDirectory(prefix="wbc-faults-") as name, stacks(Path(name)) as them:
        try:
            return _PLAYS[case.fault](them, case.parameters)
        except _NotHereError as reason:
            return {"skipped": str(reason)}


def _up(them: Stacks, given: Parameters, *more: str, out: str = "run", **how: Any) -> Command:
    flags = ("--controller", given["controller"], "--push", "none", "--view", "off")
    where = ("--out", str(them.folder / out))
    return them.start("deploy", "up", *flags, *where, *more, **how)


def _begun(them: Stacks, given: Parameters, *more: str) -> tuple[Command, Path]:
    """Start a stack, and wait until its robot has stood for `ticks` ticks of its task."""
    up = _up(them, given, "--network", "constant:10ms", "--duration", "3600", *more)
    run = them.folder / "run"
    _wait_for_ticks(up, run, given["ticks"])
    return up, run


def _wait_for_ticks(up: Command, run: Path, ticks: int) -> None:
    up.wait_for("the task begins")
    rows = run / "telemetry.rows"
    before = rows_in(rows)
    until(lambda: rows_in(rows) > before + ticks or up.popen.poll() is not None, "ticks")


def _interrupted(up: Command) -> int:
    up.signal(signal.SIGINT)
    return up.wait()


def _checked(
    them: Stacks,
    runs: dict[Path, int | None],
    *,
    during: bool = True,
    told: bool,
) -> Outcome:
    """Compare the files, processes and outputs of the runs, by their exit codes, with the truth."""
    outcome: Outcome = {
        "agrees": during and all(agrees_after(run, code=code) for run, code in runs.items()),
        "readable": all(is_readable(run) for run in runs),
        "clean": is_clean(them, *runs),
        "one_line": all(each.says_errors_in_one_line for each in them.commands),
        "told": told,
    }
    if not all(outcome.values()):
        outcome["output"] = [each.output[-3000:] for each in them.commands]
    return outcome


def _ended(them: Stacks, up: Command, run: Path, *, during: bool, told: str = "") -> Outcome:
    """Interrupt a run that goes on, and check it. `told` is a text that its output has to have."""
    code = _interrupted(up)
    fell = has_fallen(run)
    expected = EXIT_FELL if fell else EXIT_INTERRUPTED
    said = fell is not None and code == expected and told in up.output
    return _checked(them, {run: code}, during=during, told=said)


def _failed(them: Stacks, up: Command, run: Path, *, told: str) -> Outcome:
    """Check a run that must end by itself, with an error that contains `told`."""
    code = up.wait()
    return _checked(them, {run: code}, told=code == EXIT_ERROR and told in up.output)


def _kill(service: str) -> Play:
    def play(them: Stacks, given: Parameters) -> Outcome:
        up, run = _begun(them, given)
        os.kill(pid_of(run, service), signal.SIGKILL)
        if service != "edge":
            return _failed(them, up, run, told=f"error: {service} ended (signal 9)")
        until(lambda: _restarts(run, service) == 1, "a restart")
        during = agrees_while_running(run)
        return _ended(them, up, run, during=during, told="edge started again 1 ×")

    return play


def _restarts(run: Path, service: str) -> int:
    state = state_of(run)
    found = () if state is None else state.services
    return sum(each.restarts for each in found if each.name == service)


def _pause(service: str) -> Play:
    def play(them: Stacks, given: Parameters) -> Outcome:
        up, run = _begun(them, given)
        pid = pid_of(run, service)
        os.kill(pid, signal.SIGSTOP)
        try:
            up.wait_for("no states for" if service == "robot" else _SILENT)
            during = agrees_while_running(run)
        finally:
            os.kill(pid, signal.SIGCONT)
        if service != "robot":
            up.wait_for(_BACK)
        return _ended(them, up, run, during=during)

    return play


def _restart(service: str) -> Play:
    def play(them: Stacks, given: Parameters) -> Outcome:
        up, run = _begun(them, given)
        code, text = them.play("deploy", "restart", service, "--run", str(run))
        during = agrees_while_running(run)
        if service == "robot":
            outcome = _ended(them, up, run, during=during)
            refused = code == EXIT_ERROR and len(text.splitlines()) == 1
            return {**outcome, "told": outcome["told"] and refused}
        outcome = _ended(them, up, run, during=during, told=f"{service} started again 1 ×")
        return {**outcome, "told": outcome["told"] and code == EXIT_STANDING}

    return play


def _kill_supervisor(them: Stacks, given: Parameters) -> Outcome:
    up, run = _begun(them, given)
    up.signal(signal.SIGKILL)
    up.wait()
    return _recovered(them, run)


def _kill_all(them: Stacks, given: Parameters) -> Outcome:
    up, run = _begun(them, given)
    state = state_of(run)
    assert state is not None
    for service in state.services:
        os.kill(service.pid, signal.SIGKILL)
    up.signal(signal.SIGKILL)
    up.wait()
    return _recovered(them, run)


def _recovered(them: Stacks, run: Path) -> Outcome:
    """Check that the next command sums up a run whose supervisor was killed."""
    until(lambda: not them.left(), "the end of the services")
    # A socket file stays behind a killed process, as every user of sockets knows.
    (run / "stack/control").unlink(missing_ok=True)
    code, text = them.play("deploy", "ps", "--run", str(run))
    told = code == EXIT_STANDING and "its supervisor was killed" in text
    told = told and (run / "telemetry.parquet").exists()
    return _checked(them, {run: EXIT_ERROR}, told=told)


def _partition(them: Stacks, given: Parameters) -> Outcome:
    with contextlib.ExitStack() as stack:
        try:
            machines = stack.enter_context(two_machines(rate="1gbit"))
        except UserError as error:
            raise _NotHereError(str(error)) from None
        # Before the machines are removed.
        stack.callback(them.end)
        endpoint = f"tcp/{machines.edge.address}:7460"
        secure: tuple[str, ...] = ()
        if given["secure"]:
            endpoint, secure = endpoint.replace("tcp/", "tls/"), ("--secure", f"{them.folder}/keys")
            make(them.folder / "keys", robots=["romeo"], hosts=[machines.edge.address])
        edge = _up(
            them, given, "--only", "edge", "--listen", endpoint, *secure,
            out="edge", prefix=tuple(machines.edge.command()),
        )  # fmt: skip
        edge.wait_for("READY")
        up = _up(
            them, given, "--only", "robot", "--edge", endpoint, *secure, "--duration", "3600",
            prefix=tuple(machines.robot.command()),
        )  # fmt: skip
        run = them.folder / "run"
        _wait_for_ticks(up, run, given["ticks"])
        machines.cut()
        up.wait_for(_SILENT)
        if given["mended"]:
            # For 3 s, in which TCP waits twice as long after every attempt.
            _wait_for_ticks(up, run, 3000)
            machines.mend()
            up.wait_for(_BACK)
        during = agrees_while_running(run) and agrees_while_running(them.folder / "edge")
        codes: dict[Path, int | None] = {
            run: _interrupted(up),
            them.folder / "edge": _interrupted(edge),
        }
        expected = EXIT_FELL if has_fallen(run) else EXIT_INTERRUPTED
        told = [*codes.values()] == [expected, EXIT_STANDING]
        outcome = _checked(them, codes, during=during, told=told)
        # Measured, and not promised: how long the robot was without an answer.
        return {**outcome, "silence": [line for line in up.output.splitlines() if _BACK in line]}


@contextlib.contextmanager
def _disk(folder: Path, *, size_kb: int) -> Iterator[None]:
    folder.mkdir()
    mount = ("mount", "-t", "tmpfs", "-o", f"size={size_kb}k", "tmpfs", str(folder))
    try:
        made = subprocess.run(mount, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        raise _NotHereError("no `mount` command") from None
    if made.returncode != 0:
        raise _NotHereError(f"no disk of limited size: {made.stderr.strip()}")
    try:
        yield
    finally:
        subprocess.run(("umount", "--lazy", str(folder)), check=True)


def _full_disk(them: Stacks, given: Parameters) -> Outcome:
    with _disk(them.folder / "disk", size_kb=given["size_kb"]):
        up = _up(them, given, "--network", "constant:10ms", "--duration", "4", out="disk/run")
        run = them.folder / "disk/run"
        code = up.wait()
        fell = EXIT_FELL if "FELL after" in up.output else EXIT_STANDING
        told = code == fell and "No space left on device" in up.output
        return _checked(them, {run: code}, told=told)


def _limit(which: int) -> Play:
    """Play a run under a limit. Either it gives its result, or it is refused in one line."""

    def play(them: Stacks, given: Parameters) -> Outcome:
        run = them.folder / "run"
        network = ("--network", "constant:10ms", "--duration", "2")
        up = _up(them, given, *network, limits={which: given["limit"]})
        code = up.wait()
        if code == EXIT_ERROR and not (run / "stack/state").exists():
            outcome = _checked(them, {}, told="error: " in up.output)
            return {**outcome, "clean": outcome["clean"] and not (run / "stack/lock").exists()}
        told = code == EXIT_ERROR and "error: " in up.output
        told = told or (code == EXIT_STANDING and "Stands after" in up.output)
        return _checked(
            them, {run: code}, told=told or (code, has_fallen(run)) == (EXIT_FELL, True)
        )

    return play


def _wrong_edge(them: Stacks, given: Parameters) -> Outcome:
    settings = them.folder / "other.toml"
    settings.write_text("[wbc]\nfriction = 0.55\n", encoding="utf-8")
    impatient = them.folder / "impatient.toml"
    impatient.write_text("[loop]\nconnect_timeout = 3.0\n", encoding="utf-8")
    (endpoint,) = free_endpoints(1)
    edge = _up(
        them, given, "--only", "edge", "--listen", endpoint, "--config", str(settings), out="edge"
    )
    edge.wait_for("READY")
    up = _up(them, given, "--only", "robot", "--edge", endpoint, "--config", str(impatient))
    code, run = up.wait(), them.folder / "run"
    during = agrees_while_running(them.folder / "edge")
    ended = _interrupted(edge)
    told = (code, ended) == (EXIT_ERROR, EXIT_STANDING)
    told = told and "refuses a robot's states (config)" in edge.output
    return _checked(them, {run: code, them.folder / "edge": ended}, during=during, told=told)


def _behind_router(them: Stacks, given: Parameters, *, edges: int) -> tuple[Command, list[Command]]:
    """Start a router, edges and a robot behind it. Return the robot's stack and the others."""
    (endpoint,) = free_endpoints(1)
    others = [_up(them, given, "--only", "router", "--listen", endpoint, out="router")]
    others[0].wait_for("READY")
    for number in range(edges):
        flags = ("--only", "edge", "--router", endpoint)
        others.append(_up(them, given, *flags, out=f"edge.{number}"))
        others[-1].wait_for("READY")
    up = _up(them, given, "--only", "robot", "--edge", endpoint, "--duration", "3600")
    _wait_for_ticks(up, them.folder / "run", given["ticks"])
    return up, others


def _all_ended(
    them: Stacks, up: Command, others: list[Command], *, during: bool, told: bool
) -> Outcome:
    """Interrupt a robot's run and the stacks that it uses, and check them all."""
    runs = [them.folder / "run"]
    runs += sorted(each for each in them.folder.glob("*") if (each / "stack").exists())
    runs = list(dict.fromkeys(runs))
    codes: dict[Path, int | None] = dict.fromkeys(runs)
    codes[runs[0]] = _interrupted(up)
    expected = EXIT_FELL if has_fallen(runs[0]) else EXIT_INTERRUPTED
    ended = [_interrupted(each) for each in reversed(others)]
    told = told and codes[runs[0]] == expected and not any(ended)
    return _checked(them, codes, during=during, told=told)


def _kill_router(them: Stacks, given: Parameters) -> Outcome:
    up, others = _behind_router(them, given, edges=1)
    os.kill(pid_of(them.folder / "router", "router"), signal.SIGKILL)
    up.wait_for(_SILENT)
    up.wait_for(_BACK)
    during = agrees_while_running(them.folder / "router")
    told = (
        "router started again" in others[0].output
        or _restarts(them.folder / "router", "router") == 1
    )
    return _all_ended(them, up, others, during=during, told=told)


def _two_edges(them: Stacks, given: Parameters) -> Outcome:
    up, others = _behind_router(them, given, edges=2)
    _, first, _ = others
    code = _interrupted(first)
    _wait_for_ticks(up, them.folder / "run", 2000)
    during = agrees_while_running(them.folder / "run")
    others.remove(first)
    told = code == EXIT_STANDING and (_SILENT not in up.output or _BACK in up.output)
    return _all_ended(them, up, others, during=during, told=told)


def _may_read_the_project(user: int) -> bool:
    command = python("-c", "import shared")
    try:
        done = subprocess.run(command, user=user, extra_groups=[], capture_output=True, check=False)
    except PermissionError:
        return False
    return done.returncode == 0


def _second_user(them: Stacks, given: Parameters) -> Outcome:
    if os.geteuid() != 0:
        raise _NotHereError("only root can be another user")
    # The other user may enter the case's folder, and read the project.
    them.folder.chmod(0o755)
    if not _may_read_the_project(_NOBODY):
        raise _NotHereError("another user cannot read this copy of the project")
    up, run = _begun(them, given)
    code, text = them.play("deploy", given["command"], "--run", str(run), user=_NOBODY)
    refused = code == EXIT_ERROR and len(text.splitlines()) == 1
    lock = subprocess.run(
        ("cat", str(run / "stack/lock")), user=_NOBODY, extra_groups=[], capture_output=True,
        check=False,
    )  # fmt: skip
    during = agrees_while_running(run)
    outcome = _ended(them, up, run, during=during)
    return {**outcome, "told": outcome["told"] and refused and lock.returncode != 0}


def _drawn(**choices: tuple[Any, ...]) -> Draw:
    """Draw the controller, the tick of the fault, and one of each of the `choices`, in turn."""

    def parameters(turn: int, rng: np.random.Generator) -> Parameters:
        of_fault = {name: values[turn % len(values)] for name, values in choices.items()}
        controller = ("lc", "la")[turn % 2]
        return {"controller": controller, "ticks": int(rng.integers(100, 1500)), **of_fault}

    return parameters


# The short campaign has the first one.
_FAULTS: dict[str, tuple[Draw, Play]] = {
    "kill -9 of the edge": (_drawn(), _kill("edge")),
    "kill -9 of the supervisor": (_drawn(), _kill_supervisor),
    "a full disk": (_drawn(size_kb=(1500, 900, 3000, 2000)), _full_disk),
    "kill -9 of netem": (_drawn(), _kill("netem")),
    "kill -9 of the robot": (_drawn(), _kill("robot")),
    "kill -9 of all": (_drawn(), _kill_all),
    "SIGSTOP of the edge": (_drawn(), _pause("edge")),
    "SIGSTOP of netem": (_drawn(), _pause("netem")),
    "SIGSTOP of the robot": (_drawn(), _pause("robot")),
    "restart of the edge": (_drawn(), _restart("edge")),
    "restart of netem": (_drawn(), _restart("netem")),
    "restart of the robot": (_drawn(), _restart("robot")),
    "a partition": (
        _drawn(secure=(False, True, False, True), mended=(False, True, True, False)),
        _partition,
    ),
    "a limit of file sizes": (
        _drawn(limit=(_MIB, 200_000, 50_000, 1000)),
        _limit(resource.RLIMIT_FSIZE),
    ),
    "a limit of open files": (_drawn(limit=(20, 40, 64, 12)), _limit(resource.RLIMIT_NOFILE)),
    "a limit of memory": (
        _drawn(limit=(1024 * _MIB, 512 * _MIB, 2048 * _MIB, 256 * _MIB)),
        _limit(resource.RLIMIT_AS),
    ),
    "a wrong edge": (_drawn(), _wrong_edge),
    "kill -9 of the router": (_drawn(), _kill_router),
    "the end of one of two edges": (_drawn(), _two_edges),
    "a second user": (_drawn(command=("down", "ps", "logs")), _second_user),
}
DRAWS: dict[str, Draw] = {fault: draw for fault, (draw, _) in _FAULTS.items()}
_PLAYS: dict[str, Play] = {fault: play for fault, (_, play) in _FAULTS.items()}
