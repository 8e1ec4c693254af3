"""Run one service of `services.toml` as the main process of a container: see `compose.yaml`.

`python -m deploy.container SERVICE [arguments of the service]`. When the service is ready, the file
`/tmp/ready` is created, or the file that --ready-file names. Docker decides whether a service that
has ended is started again.
"""

from __future__ import annotations

from remote_wbc import begin

begin(__name__)

import argparse
import asyncio
import dataclasses
import signal
import tempfile
from pathlib import Path

from deploy.services import FAILURE, Service, load_services
from deploy.supervisor import Launch, Supervisor
from shared.commands import python_module
from shared.process.cli import Parser, run
from shared.process.entry import python

READY_FILE = Path("/tmp/ready")


def main() -> int:
    services = load_services()
    parser = Parser(prog=python_module("deploy.container"), description=__doc__)
    parser.add_argument(
        "--ready-file",
        metavar="FILE",
        type=Path,
        default=READY_FILE,
        help="file to create when the service is ready (default %(default)s)",
    )
    parser.add_argument("service", choices=services)
    parser.add_argument("arguments", nargs=argparse.REMAINDER, help="arguments of the service")
    arguments = parser.parse_args()
    service = services[arguments.service]
    arguments.ready_file.unlink(missing_ok=True)
    return asyncio.run(_serve(service, arguments.arguments, arguments.ready_file))


async def _serve(service: Service, arguments: list[str], ready_file: Path) -> int:
    """Run the service until it ends or a signal arrives. Return its exit code."""
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    with tempfile.TemporaryDirectory() as folder:
        supervisor = Supervisor(
            Path(folder),
            lambda name, line: print(line, flush=True),
            changed=lambda: None,
        )
        alone = dataclasses.replace(service, restart="no", end=FAILURE)
        command = tuple(python("-m", *service.command, *arguments))
        launch = Launch(alone, command, float("inf"))
        running = asyncio.create_task(_play(supervisor, launch, ready_file))
        stopping = asyncio.create_task(stop.wait())
        try:
            await asyncio.wait({running, stopping}, return_when=asyncio.FIRST_COMPLETED)
            if running.done():
                return running.result()
        finally:
            stopping.cancel()
            running.cancel()
            await supervisor.stop()
        codes = [state.exit_code for state in supervisor.states()]
        return _code(next((code for code in codes if code is not None), 0))


async def _play(supervisor: Supervisor, launch: Launch, ready_file: Path) -> int:
    await supervisor.start(launch)
    ready_file.touch()
    _, code = await supervisor.wait()
    return _code(code)


def _code(code: int) -> int:
    """Return an exit code in Docker's form: 128 + n for a process that signal n has killed."""
    return code if code >= 0 else 128 - code


if __name__ == "__main__":
    run(main)
