"""Watch a run whose services run elsewhere: telemetry hub, status line and summary.

`python -m deploy.console.watch --listen tcp/0.0.0.0:7450` opens the hub that robot, shim and viewer
connect to. `./deploy/up` contains a hub already. End this program after the services: it sums up
the files that they have left in `--out`.
"""

from __future__ import annotations

from remote_wbc import begin

begin(__name__)

import time
from pathlib import Path

from deploy.console.status import Status
from deploy.console.terminal import Terminal
from deploy.outcome import SUMMARY, summarise
from shared.bus.zenoh_bus import ZenohBus
from shared.commands import python_module
from shared.config.settings import RunConfig
from shared.output.report import summary_in_words
from shared.process.cli import EXIT_STANDING, Parser, add_run_arguments, config_from, run
from shared.process.service import StopSignal
from shared.wire.channels import LINK_KEY, TICKS_KEY

_ENDPOINT = "tcp/127.0.0.1:7450"
_PERIOD_SECONDS = 0.1


def main() -> int:
    parser = Parser(prog=python_module("deploy.console.watch"), description=__doc__)
    parser.add_argument(
        "--listen",
        metavar="ENDPOINT",
        default=_ENDPOINT,
        help="endpoint of the hub (default %(default)s)",
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
        # The summary of an earlier run: this run may leave none.
        (arguments.out / SUMMARY).unlink(missing_ok=True)
    stop = StopSignal()
    status, terminal = status_of(config), Terminal()
    hub = open_hub(arguments.listen, status, robot=config.robot.name)
    print(f"READY {arguments.listen}", flush=True)
    while not stop.requested:
        tell(status, terminal)
        time.sleep(_PERIOD_SECONDS)
    terminal.clear()
    hub.close()
    words = status.events.in_words()
    if words:
        print(words, flush=True)
    if arguments.out is not None:
        result = summarise(arguments.out, config)
        words = summary_in_words(result) if result else "no summary: the robot left no report"
        print(words, flush=True)
    return EXIT_STANDING


def status_of(config: RunConfig) -> Status:
    """Return the status line for a run."""
    return Status(duration=config.duration, walks=config.task == "walk")


def open_hub(endpoint: str, status: Status, *, robot: str) -> ZenohBus:
    """Open the hub that the services of a run report to.

    `robot` is the kind of robot, not its name on the link.
    """
    hub = ZenohBus(listen=[endpoint], mode="router")
    hub.subscribe(TICKS_KEY.format(robot=robot), status.take_ticks)
    hub.subscribe(LINK_KEY, status.take_link)
    return hub


def tell(status: Status, terminal: Terminal) -> None:
    """Print new events and the status line."""
    for event in status.take_events():
        terminal.say(event.name, event.text)
    terminal.show(status.line(terminal.columns))


if __name__ == "__main__":
    run(main)
