"""The edge as a process: `python -m edge_node --listen tcp/…`. Serves robot after robot."""

from __future__ import annotations

from remote_wbc import begin

begin(__name__)

import time

from edge_node.client_monitor import ClientMonitor
from edge_node.node import EdgeNode
from shared.bus.base import Inbox
from shared.bus.security import EDGE
from shared.bus.zenoh_bus import ZenohBus
from shared.commands import python_module
from shared.motion.plan import make_motion
from shared.output.report import edge_report
from shared.process.cli import EXIT_STANDING, Parser, add_run_arguments, config_from, run
from shared.process.realtime import RealtimeBudget, prepare, suspend_garbage_collection
from shared.process.service import (
    EDGE_ENDPOINT,
    ServiceLog,
    StopSignal,
    add_service_arguments,
    identity_from,
    wait_while_held,
)
from shared.robots import load_robot
from shared.telemetry.schema import SOLVE_SCHEMA
from shared.wire.channels import DOWNLINK, SOLVES_KEY, UPLINK

_PRIORITY = 10
_POLL_NS = 50_000_000


def main() -> int:
    parser = Parser(prog=python_module("edge_node"), description=__doc__)
    ways = parser.add_mutually_exclusive_group()
    ways.add_argument(
        "--listen", metavar="ENDPOINT", default=EDGE_ENDPOINT, help="(default %(default)s)"
    )
    ways.add_argument("--connect", metavar="ENDPOINT", help="a router to dial instead of listening")
    add_service_arguments(parser)
    add_run_arguments(parser)
    arguments = parser.parse_args()
    config = config_from(arguments)
    robot = load_robot(config.robot.name)
    node = EdgeNode(robot, config, make_motion(robot, config))
    me = identity_from(arguments, role=EDGE, kind=robot.name)
    wait_while_held(arguments)
    stop = StopSignal()
    scheduling = prepare(priority=_PRIORITY)
    if arguments.connect is None:
        bus = ZenohBus(
            listen=[arguments.listen], largest=DOWNLINK.max_bytes, credentials=me.credentials
        )
    else:
        bus = ZenohBus.dial(
            arguments.connect,
            within=config.loop.connect_timeout,
            largest=DOWNLINK.max_bytes,
            credentials=me.credentials,
            stopping=lambda: stop.requested,
        )
    log = ServiceLog(
        "edge", SOLVE_SCHEMA, out=arguments.out, telemetry=arguments.telemetry, key=SOLVES_KEY
    )
    inbox = Inbox()
    bus.subscribe(UPLINK.key_for(me.robot), inbox.put)
    downlink = bus.publisher(DOWNLINK.key_for(me.robot))
    suspend_garbage_collection()
    where = arguments.connect or arguments.listen
    print(f"READY {where} for {me.robot} ({scheduling}; {config.wbc.solver})", flush=True)

    monitor, budget = ClientMonitor(), RealtimeBudget()
    while not stop.requested:
        budget.keep(time.monotonic_ns())
        heard = inbox.wait(_POLL_NS)
        for data in inbox.take():
            node.receive(data)
        started_ns = time.monotonic_ns()
        for line in monitor.look(started_ns, heard=heard, refused=node.refused):
            print(line, flush=True)
        answer = node.step()
        if answer is None:
            continue
        if answer.data is not None:
            downlink.publish(answer.data)
        solve_ns = time.monotonic_ns() - started_ns
        answer.record(log.row(), wall_ns=started_ns, solve_ns=solve_ns)
    bus.close()
    report = log.finish(
        lambda rows: edge_report(
            rows,
            statuses=dict(node.solved),
            sent=downlink.sent,
            received=inbox.counter.received,
            lost=inbox.counter.lost,
            refused=dict(node.refused),
        )
    )
    print(
        f"stopped: {downlink.sent} projectors sent, solve p50 {report['edge_solve_ms']['p50']} ms, "
        f"refused {dict(node.refused) or 'none'}",
        flush=True,
    )
    return EXIT_STANDING


if __name__ == "__main__":
    run(main)
