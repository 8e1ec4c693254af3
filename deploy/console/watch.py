"""Watch a run whose services run elsewhere: telemetry hub, status line and summary.

`python -m deploy.console.watch --listen unixsock-stream/FILE` opens the hub that robot, shim and
viewer connect to. Other users have no access to it. `./deploy/up` contains a hub already. End this
program after the services: it writes the summary from the files in `--out`. Files of an earlier run
go to the folder `previous`.
"""

from __future__ import annotations

from remote_wbc import begin

begin(__name__)

import contextlib
import os
import re
import tempfile
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from deploy.console.status import Status
from deploy.console.terminal import Terminal
from deploy.outcome import STEMS, SUMMARY, is_running, set_aside, summarise
from shared.bus.base import Delivery
from shared.bus.zenoh_bus import ZenohBus
from shared.commands import python_module
from shared.config.settings import RunConfig
from shared.errors import LinkError, MessageRefused, writing
from shared.output.summary import summary_in_words
from shared.process.cli import EXIT_STANDING, Parser, run
from shared.process.realtime import just_above_ordinary
from shared.process.run_options import add_run_arguments, config_from
from shared.process.service import StopSignal
from shared.robots import load_robot
from shared.telemetry.lives import lives
from shared.telemetry.schema import tick_schema
from shared.wire.channels import LINK_KEY, TICKS_KEY
from shared.wire.operator.events import EVENTS_FILE
from shared.wire.operator.messages import EVENTS_KEY, decode_event

_SOCKET = "unixsock-stream/"
# The system allows 107 characters. Zenoh adds a file with five more.
_MAX_SOCKET_PATH = 100
_PLAIN_PATH = re.compile(r"[\w./+-]+", re.ASCII)
_PERIOD_SECONDS = 0.1


def main() -> int:
    parser = Parser(prog=python_module("deploy.console.watch"), description=__doc__)
    parser.add_argument(
        "--listen",
        metavar="ENDPOINT",
        required=True,
        help=f"the hub: {_SOCKET}FILE",
    )
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        help="folder of the services' files, to sum them up at the end",
    )
    add_run_arguments(parser)
    arguments = parser.parse_args()
    config = config_from(arguments)
    if arguments.out is not None:
        _put_away(arguments.out, config)
    stop = StopSignal()
    status, terminal = status_of(config), Terminal()
    hub = open_hub(arguments.listen, status, config.robot.label, out=arguments.out)
    print(f"READY {arguments.listen}", flush=True)
    while not stop.requested:
        tell(status, terminal)
        time.sleep(_PERIOD_SECONDS)
    terminal.clear()
    if arguments.out is not None:
        _sum_up(arguments.out, config)
    if words := status.events.in_words():
        print(words, flush=True)
    hub.close()
    return EXIT_STANDING


def _put_away(out: Path, config: RunConfig) -> None:
    """Put the files of an earlier run away. If it was killed, sum it up before.

    Files of services that run already are those of this run.
    """
    if is_running(out):
        return
    with writing(out, what="out"):
        if not (out / SUMMARY).exists() and any(lives(out, stem) for stem in STEMS):
            print("the previous run was killed:", flush=True)
            _sum_up(out, config)
        set_aside(out)


def _sum_up(out: Path, config: RunConfig) -> None:
    result = summarise(out, config, partial(print, flush=True))
    words = summary_in_words(result) if result else "no summary: the robot left no report"
    print(words, flush=True)


def status_of(config: RunConfig, *, stays: bool = False) -> Status:
    """Return the status line for a run; one that `stays` has no end."""
    model = load_robot(config.robot.name).model
    ticks = tick_schema(nq=model.nq, nv=model.nv)
    return Status(ticks, duration=config.duration, walks=config.walks, stays=stays)


@contextlib.contextmanager
def private_socket(folder: Path) -> Iterator[str]:
    """Yield the endpoint of a socket in a private folder, or in a temporary one if necessary.

    It is necessary for a path that is too long for a socket, or with characters that Zenoh takes
    for settings.
    """
    path = str(folder.absolute() / "hub")
    if len(path) <= _MAX_SOCKET_PATH and _PLAIN_PATH.fullmatch(path):
        yield f"{_SOCKET}{path}"
        return
    with tempfile.TemporaryDirectory(prefix="wbc-", dir="/tmp") as temporary:
        yield f"{_SOCKET}{temporary}/hub"


def open_hub(endpoint: str, status: Status, robot: str, *, out: Path | None = None) -> ZenohBus:
    """Open the hub that the services of a run report to, a socket of this user alone.

    `robot` is the kind of robot, not its name on the link. An operator's commands are added to
    `events.txt` in the folder `out`.
    """
    file = Path(endpoint.removeprefix(_SOCKET))
    if str(file) == endpoint:
        raise LinkError(
            f"listen: expected {_SOCKET}FILE, which other users cannot reach, got {endpoint}"
        )
    # The socket is private from its first moment.
    before = os.umask(0o177)
    try:
        with just_above_ordinary():
            hub = ZenohBus(listen=[endpoint], mode="router")
    finally:
        os.umask(before)
    hub.subscribe(TICKS_KEY.format(robot=robot), status.take_ticks)
    hub.subscribe(LINK_KEY, status.take_link)
    if out is not None:
        hub.subscribe(EVENTS_KEY, partial(_record, out / EVENTS_FILE))
    return hub


def _record(file: Path, delivery: Delivery) -> None:
    """Add an event to a file. If the disk is full, it is dropped."""
    with contextlib.suppress(OSError, MessageRefused):
        event, _ = decode_event(delivery.data)
        with file.open("a", encoding="utf-8") as lines:
            lines.write(f"{event}\n")


def tell(status: Status, terminal: Terminal, *, degraded: Sequence[str] = ()) -> None:
    """Print new events and the status line. An error in them is printed and ends nothing."""
    try:
        for event in status.take_events():
            terminal.say(event.name, event.text)
        line = status.line(terminal.columns)
    except Exception as error:
        line = f"no status: {type(error).__name__}: {error}"
    if degraded:
        line = f"{', '.join(degraded)} degraded | {line}"
    terminal.show(line[: terminal.columns])


if __name__ == "__main__":
    run(main)
