"""The robot as a process: `python -m robot_node --connect tcp/…`."""

from __future__ import annotations

from remote_wbc import begin

begin(__name__)

from functools import partial
from typing import Any

import numpy as np

from robot_node.commands import RobotCommands
from robot_node.live import LiveLoop, Narrator
from robot_node.node import RobotNode
from robot_node.worker import WorkerComputer
from shared.bus.base import Inbox
from shared.bus.preflight import preflight
from shared.bus.zenoh_bus import ZenohBus
from shared.commands import python_module
from shared.errors import UserError
from shared.motion.plan import make_motion
from shared.output.fall import fall_in_words, torque_limits
from shared.output.report import robot_report
from shared.output.sources import commands_in_words
from shared.process.cli import EXIT_FELL, EXIT_STANDING, Parser, run
from shared.process.entry import EXIT_INTERRUPTED
from shared.process.realtime import prepare, suspend_garbage_collection
from shared.process.run_options import add_run_arguments, config_from
from shared.process.service import (
    NETEM_ENDPOINT,
    ServiceLog,
    StopSignal,
    add_service_arguments,
    identity_from,
    script_of,
    wait_while_held,
)
from shared.robots import load_robot
from shared.telemetry.schema import STEP_SCHEMA
from shared.wire.channels import DOWNLINK, PLANS, STEPS_KEY, TICKS_KEY, UPLINK
from shared.wire.operator.commands import RobotCommand

_PRIORITY = 30
# Task times stay inside 64 bits of nanoseconds.
_ENDLESS_NS = 2**62


def main() -> int:
    parser = Parser(prog=python_module("robot_node"), description=__doc__)
    parser.add_argument(
        "--connect",
        metavar="ENDPOINT",
        default=NETEM_ENDPOINT,
        help="the shim, the edge itself, or a router (default %(default)s)",
    )
    add_service_arguments(parser)
    parser.add_argument(
        "--stay",
        action="store_true",
        help="go on until a signal, longer than --duration; after a fall wait for a reset",
    )
    add_run_arguments(parser)
    arguments = parser.parse_args()
    config = config_from(arguments)
    robot = load_robot(config.robot.name)
    motion = make_motion(robot, config)
    me = identity_from(arguments, role=None, kind=robot.name)
    node = RobotNode(robot, config, motion, start_computer=partial(WorkerComputer, config))
    script = script_of(arguments, RobotCommand)
    wait_while_held(arguments)
    stop = StopSignal()
    scheduling = prepare(priority=_PRIORITY)
    bus = ZenohBus.dial(
        arguments.connect,
        within=config.loop.connect_timeout,
        largest=UPLINK.max_bytes,
        lease=config.loop.link_lease,
        credentials=me.credentials,
        stopping=lambda: stop.requested,
    )
    log = ServiceLog(
        "telemetry",
        node.schema,
        out=arguments.out,
        telemetry=arguments.telemetry,
        key=TICKS_KEY.format(robot=robot.name),
        complete=node.tick_row.complete,
    )
    steps = None
    if node.clock is not None:
        steps = log.beside("steps", STEP_SCHEMA, key=STEPS_KEY.format(robot=robot.name))
    inbox = Inbox()
    uplink = bus.publisher(UPLINK.key_for(me.robot))
    loop = LiveLoop(
        node,
        config.loop,
        uplink=uplink,
        inbox=inbox,
        log=log.rows,
        steps=steps,
        explain=lambda: preflight(arguments.connect, me.credentials),
        stays=arguments.stay,
    )
    bus.subscribe(DOWNLINK.key_for(me.robot), loop.receive)
    bus.subscribe(PLANS.key_for(me.robot), loop.receive_plan)
    commands: RobotCommands | None = None
    if log.hub is not None:
        commands = RobotCommands(log.hub, node, loop, _say)
        commands.play(script)
    suspend_garbage_collection()
    print(f"READY {me.robot} → {arguments.connect} ({scheduling})", flush=True)

    failure: UserError | None = None
    duration_ns = _ENDLESS_NS if arguments.stay else round(config.duration * 1e9)
    each_look = _nothing if commands is None else commands.tell_clock
    with Narrator(loop, _say, each_look=each_look):
        try:
            loop.run(duration_ns=duration_ns, stopping=lambda: stop.requested)
        except UserError as error:
            failure = error
    node.close()

    def make_report(rows: np.ndarray) -> dict[str, Any]:
        return robot_report(
            node.schema,
            rows,
            fell=node.fallen,
            wall_seconds=loop.wall_seconds,
            sent=uplink.sent,
            received=inbox.counter.received,
            lost=inbox.counter.lost,
            refused=dict(node.refused),
            answers=node.answers.by_sender,
            sensor_faults=dict(node.sensor_guard.faults),
            base_estimate=node.base_estimate,
            torque_limits=torque_limits(robot, clamp=config.robot.torque_clamp),
        )

    report = log.finish(make_report)
    if failure is None:
        outcome = f"stands after {report['task_seconds']:.2f} s"
        if report["fall"] is not None:
            reason = fall_in_words(report["fall"], controller=config.controller)
            outcome = f"fell after {report['task_seconds']:.2f} s: {reason}"
        sources = commands_in_words(report["commands"], config.controller)
        print(
            f"{outcome}; commands: {sources}; CoM error "
            f"{100 * (report['com_error_m'] or 0):.2f} cm, {report['overruns']} overruns",
            flush=True,
        )
    # Last, because a neighbour that is cut off makes it wait.
    bus.close()
    if failure is not None:
        raise failure
    if node.fallen:
        return EXIT_FELL
    finished = arguments.stay or node.time_ns >= duration_ns
    return EXIT_STANDING if finished else EXIT_INTERRUPTED


def _say(text: str) -> None:
    print(text, flush=True)


def _nothing() -> None:
    """Do nothing: no hub asks for the clock."""


if __name__ == "__main__":
    run(main)
