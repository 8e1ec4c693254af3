"""Start the stack, or the part of it that --only names, and wait for its end.

Without --only everything runs on this machine: edge, netem, robot and viewer. Without any option it
is a demonstration: a push, an outage and a cut link within 5 s. In a terminal the robot then
stands, and takes commands, until Ctrl-C.

Exit code 0: the robot finished standing. With --stay, or if no robot runs here: a signal ended the
services. With -d: all services are ready. 3: the robot fell. 130: a signal ended the robot's run.
Any other code: an error, and its message says what to do.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import dataclasses
import errno
import itertools
import re
import socket
import time
from collections.abc import Sequence
from pathlib import Path

from deploy.background.detach import in_background
from deploy.background.registry import Registry
from deploy.console.keys import has_keys
from deploy.operate import service_of
from deploy.plan import (
    Options,
    Plan,
    check_credentials,
    make_plan,
    services_of,
)
from deploy.scene import DEMO
from deploy.services import NETEM, ROBOT, VIEWER, Service, load_services
from deploy.stack import Run, StackRun, in_words
from netem.networks import load_network, profile_of
from shared.commands import wbc
from shared.config.config_file import dump_config
from shared.config.extensions import CONTROLLERS, TASKS
from shared.config.settings import RunConfig, extended
from shared.errors import ConfigError, LinkError, writing
from shared.motion.plan import make_motion
from shared.output.screen import has_screen
from shared.output.versions import versions
from shared.process.cli import EXIT_STANDING
from shared.process.run_options import add_run_arguments, add_view_argument, config_from
from shared.process.service import add_identity_arguments
from shared.robots import load_robot
from shared.wire.operator.commands import LinkCommand
from shared.wire.operator.events import CommandEvent, read_events

# Options, and what the parser adds, that leave the run itself as it is.
_NOT_OF_THE_RUN = {"view", "out", "dry_run", "parser", "run_command"}


def run_up(arguments: argparse.Namespace) -> int:
    """Run the stack that the arguments describe. Return the exit code, as the module lists it."""
    declared = load_services()
    if arguments.detach:
        return in_background(lambda ready_fd: _play(arguments, declared, ready_fd))
    return _play(arguments, declared, None)


def _play(arguments: argparse.Namespace, declared: dict[str, Service], ready_fd: int | None) -> int:
    """Play the run that the arguments describe. Return its exit code."""
    config = config_from(arguments)
    demo = _is_demo(arguments)
    attended = not arguments.detach and has_keys()
    scene = DEMO if demo else () if arguments.events is None else read_events(arguments.events)
    chosen = services_of(declared, arguments.only, direct=config.link.network == "direct")
    services = tuple(service.name for service in chosen)
    if NETEM not in services:
        if arguments.network not in (None, "direct"):
            raise ConfigError(
                f"network: {arguments.network} needs netem; add netem to --only, or leave "
                "--network out"
            )
        link = dataclasses.replace(config.link, network="direct")
        config = dataclasses.replace(config, link=link)
    # Settings that cannot be used are refused before anything starts.
    for table, value in extended(config):
        table.load(value)
    make_motion(load_robot(config.robot.name), config)
    if NETEM in services:
        load_network(config.link.network)
    options = Options(
        edge=arguments.edge,
        router=arguments.router,
        listen=arguments.listen,
        secure=arguments.secure,
    )
    view = _resolve_view(config.view) if VIEWER in services else "off"
    plan = make_plan(options, chosen, view=view, free_port=iter(_free_ports(2)).__next__)
    robot = config.robot.label if arguments.name is None else arguments.name
    check_credentials(plan, robot=robot)
    _check_scene(scene, plan)
    described = Run(
        config,
        plan,
        Path(),
        arguments.name,
        ready_fd,
        stays=arguments.stay or (demo and attended),
        scene=scene,
        seen=attended and view not in ("off", "record"),
    )
    if arguments.dry_run:
        print(*in_words(described), sep="\n")
        return EXIT_STANDING
    _check_port(plan)
    if arguments.detach:
        Registry().check(None, robot=robot, services=plan.names)
    out = _run_folder(arguments.out, config, services)
    if VIEWER in services and view == "off" and config.view == "auto":
        print("no screen: the run is recorded, not shown (--view page for a browser)", flush=True)
    return asyncio.run(StackRun(dataclasses.replace(described, out=out)).run())


def add_up_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `up`."""
    parser.description = __doc__
    add_run_arguments(parser)
    add_view_argument(parser)
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder of this run (default runs/<time>-…)"
    )
    parser.add_argument(
        "-d",
        "--detach",
        action="store_true",
        help="return when everything is ready; see ps, logs, restart and down",
    )
    parser.add_argument(
        "--stay",
        action="store_true",
        help="go on until Ctrl-C, longer than --duration; after a fall wait for a reset",
    )
    parser.add_argument(
        "--events",
        metavar="FILE",
        type=Path,
        help="commands at times of the task, one a line, as in '2.5s link cut'",
    )
    parser.add_argument(
        "--dry-run",
        action="store_true",
        help="print the services, their order and their settings; start nothing",
    )
    group = parser.add_argument_group(
        "several machines (docs/real-network.md); ENDPOINT: tls/HOST:PORT, or tcp, quic"
    )
    group.add_argument(
        "--only",
        metavar="SERVICE,…",
        help=f"services to start, of {', '.join(load_services())} (default: all but the router)",
    )
    group.add_argument(
        "--edge",
        metavar="ENDPOINT",
        help="the edge or the router that the robot, or the shim, dials",
    )
    group.add_argument(
        "--router",
        metavar="ENDPOINT",
        help="the router that both edge and robot dial",
    )
    group.add_argument(
        "--listen",
        metavar="ENDPOINT",
        help="where edge, router or shim listen for the other machine (default without "
        "certificates: on loopback)",
    )
    add_identity_arguments(group)


def _is_demo(arguments: argparse.Namespace) -> bool:
    """Return whether no option describes the run. Options for the view do not count."""
    options = vars(arguments).items()
    given = {name for name, value in options if value not in (None, False)}
    return arguments.view != "off" and given <= _NOT_OF_THE_RUN


def _check_scene(scene: Sequence[CommandEvent], plan: Plan) -> None:
    """Raise `UserError` if a command of the scene cannot be carried out here."""
    for event in scene:
        service = service_of(event.command)
        if not plan.has(service):
            raise ConfigError(
                f"events: {event.command}: expected {service} among the services, got "
                f"{', '.join(plan.names)}; leave this line out"
            )
        if isinstance(event.command, LinkCommand):
            profile_of(event.command)


def _run_folder(out: Path | None, config: RunConfig, services: tuple[str, ...]) -> Path:
    """Make a new folder with the settings in it."""
    if out is None:
        controller = CONTROLLERS.label(config.controller).lower()
        words = (TASKS.label(config.task), controller, config.link.network)
        # A name of a user's may have settings, and a network is a path.
        what = "-".join(re.sub(r"[^\w.=-]+", "-", word).strip(".-") for word in words)
        stamp = time.strftime("%Y%m%d-%H%M%S")
        name = f"{stamp}-{what if ROBOT in services else '-'.join(services)}"
        out = _new_folder(Path("runs") / name)
    with writing(out, what="out"):
        out.mkdir(parents=True, exist_ok=True)
        if any(out.iterdir()):
            raise ConfigError(
                f"out: expected a new or empty folder, got {out} with files; try another"
            )
        text = dump_config(config, versions=versions())
        (out / "config.toml").write_text(text, encoding="utf-8")
    return out


def _new_folder(path: Path) -> Path:
    """Make a folder of this name, or of the name with -2, -3, … if another run has it."""
    for number in itertools.count(1):
        folder = path if number == 1 else path.with_name(f"{path.name}-{number}")
        with writing(folder, what="out"):
            folder.parent.mkdir(parents=True, exist_ok=True)
            with contextlib.suppress(FileExistsError):
                folder.mkdir()
                return folder
    raise AssertionError


def _check_port(plan: Plan) -> None:
    """Check that the port for other machines is free; raise `LinkError` if it is not."""
    endpoint = plan.opens
    if endpoint is None or endpoint.port == 0:
        return
    datagrams = endpoint.protocol in ("udp", "quic")
    family = socket.AF_INET6 if ":" in endpoint.host else socket.AF_INET
    with socket.socket(family, socket.SOCK_DGRAM if datagrams else socket.SOCK_STREAM) as probe:
        # As Zenoh does: a connection that has just been closed does not block the port.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, not datagrams)
        try:
            probe.bind((endpoint.host, endpoint.port))
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                raise LinkError(
                    f"listen: port {endpoint.port} is in use, by another stack ({wbc('ps')}) or "
                    f"another program; end it, or try --listen {endpoint.protocol}/"
                    f"{endpoint.host}:PORT"
                ) from None


def _resolve_view(view: str) -> str:
    if view != "auto":
        return view
    return "native" if has_screen() else "off"


def _free_ports(count: int) -> list[int]:
    sockets = [socket.socket() for _ in range(count)]
    try:
        for each in sockets:
            each.bind(("127.0.0.1", 0))
        return [each.getsockname()[1] for each in sockets]
    finally:
        for each in sockets:
            each.close()
