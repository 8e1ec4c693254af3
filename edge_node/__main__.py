"""The edge as a process: `python -m edge_node --listen tcp/…`.

It serves one robot after another, and with `--name amy,bob` several at once, each on its own keys.
"""

from __future__ import annotations

from remote_wbc import begin

begin(__name__)

import threading
import time
from collections.abc import Sequence

from edge_node.client_monitor import ClientMonitor
from edge_node.node import EdgeNode
from shared.bus.base import Inbox, sender_name
from shared.bus.operator import CommandServer, RobotTimes
from shared.bus.security import EDGE
from shared.bus.zenoh_bus import ZenohBus
from shared.clock import ScaledClock
from shared.commands import python_module
from shared.errors import ConfigError
from shared.motion.plan import make_motion
from shared.output.no_start import refused_in_words
from shared.output.report import edge_report
from shared.process.cli import EXIT_STANDING, Parser, run
from shared.process.realtime import (
    RealtimeBudget,
    RealtimeShare,
    prepare,
    suspend_garbage_collection,
)
from shared.process.run_options import add_run_arguments, config_from
from shared.process.service import (
    EDGE_ENDPOINT,
    ServiceLog,
    StopSignal,
    add_service_arguments,
    identity_from,
    script_of,
    wait_while_held,
)
from shared.robots import load_robot
from shared.telemetry.schema import SOLVE_SCHEMA
from shared.wire.channels import DOWNLINK, PLANS, SOLVES_KEY, UPLINK
from shared.wire.operator.commands import Accepted, Command, EdgeCommand
from shared.wire.operator.events import CommandEvent
from shared.wire.operator.messages import EDGE_COMMANDS_KEY

_PRIORITY = 10
_POLL_NS = 50_000_000


def main() -> int:
    parser = Parser(prog=python_module("edge_node"), description=__doc__)
    ways = parser.add_mutually_exclusive_group()
    ways.add_argument(
        "--listen", metavar="ENDPOINT", default=EDGE_ENDPOINT, help="(default %(default)s)"
    )
    ways.add_argument("--connect", metavar="ENDPOINT", help="a router to dial instead of listening")
    parser.add_argument(
        "--realtime-share",
        metavar="0.2",
        type=_share,
        help="share of a core at real-time priority; beyond it, other processes get their part "
        "(default: no such limit)",
    )
    add_service_arguments(parser)
    add_run_arguments(parser)
    arguments = parser.parse_args()
    config = config_from(arguments)
    robot = load_robot(config.robot.name)
    node = EdgeNode(robot, config, make_motion(robot, config))
    me = identity_from(arguments, role=EDGE, kind=robot.name, several=True)
    served = me.robots
    script = script_of(arguments, EdgeCommand)
    wait_while_held(arguments)
    stop = StopSignal()
    scheduling = prepare(priority=_PRIORITY)
    if arguments.connect is None:
        bus = ZenohBus(
            listen=[arguments.listen],
            largest=DOWNLINK.max_bytes,
            lease=config.loop.link_lease,
            credentials=me.credentials,
        )
    else:
        bus = ZenohBus.dial(
            arguments.connect,
            within=config.loop.connect_timeout,
            largest=DOWNLINK.max_bytes,
            lease=config.loop.link_lease,
            credentials=me.credentials,
            stopping=lambda: stop.requested,
        )
    log = ServiceLog(
        "edge", SOLVE_SCHEMA, out=arguments.out, telemetry=arguments.telemetry, key=SOLVES_KEY
    )
    arrived = threading.Event()
    inboxes = {name: Inbox(arrived) for name in served}
    for name, inbox in inboxes.items():
        bus.subscribe(UPLINK.key_for(name), inbox.put)
    downlinks = {name: bus.publisher(DOWNLINK.key_for(name)) for name in served}
    plan_keys = {name: bus.publisher(PLANS.key_for(name)) for name in served}
    clock = ScaledClock()
    if log.hub is not None:
        clock = _serve_commands(log.hub, node, served, script)
    suspend_garbage_collection()
    where = arguments.connect or arguments.listen
    names = ", ".join(f"{name} as {sender_name(downlinks[name].session)}" for name in served)
    print(f"READY {where} for {names} ({scheduling}; {config.wbc.solver})", flush=True)

    monitors = {name: ClientMonitor() for name in served}
    share = arguments.realtime_share
    budget = RealtimeBudget() if share is None else RealtimeShare(share)
    while not stop.requested:
        budget.keep(time.monotonic_ns())
        # A message may come between two inboxes' `take`, and its event be lost.
        if not (node.sessions.waiting or any(inbox.holds for inbox in inboxes.values())):
            arrived.wait(_POLL_NS * 1e-9)
        started_ns = time.monotonic_ns()
        for name, inbox in inboxes.items():
            messages = inbox.take()
            for delivery in messages:
                node.receive(delivery.data, started_ns, robot=name)
            for line in monitors[name].look(
                started_ns,
                heard=bool(messages),
                refused=node.refused_from[name],
                shared=node.sessions.shared[name],
                renewed=node.sessions.renewed[name],
            ):
                print(line if len(served) == 1 else f"{name}: {line}", flush=True)
        answer = node.step()
        for name, plan in node.take_plans():
            plan_keys[name].publish(plan)
        if answer is None:
            continue
        if answer.data is not None:
            downlinks[answer.robot].publish(answer.data)
        solve_ns = time.monotonic_ns() - started_ns
        answer.record(log.row(), wall_ns=clock.at(started_ns), solve_ns=solve_ns)
    report = log.finish(
        lambda rows: edge_report(
            rows,
            statuses=dict(node.solved),
            sent=sum(downlink.sent for downlink in downlinks.values()),
            received=sum(inbox.counter.received for inbox in inboxes.values()),
            lost=sum(inbox.counter.lost for inbox in inboxes.values()),
            refused=dict(node.refused),
        )
    )
    sent, p50 = report["link"]["downlink"]["sent"], report["edge_solve_ms"]["p50"]
    print(
        f"stopped: {sent} answers sent, {'' if p50 is None else f'solve p50 {p50} ms, '}"
        f"refused {refused_in_words(node.refused) or 'no message'}",
        flush=True,
    )
    # Last, because a neighbour that is cut off makes it wait.
    bus.close()
    return EXIT_STANDING


def _share(text: str) -> float:
    """Return a share of a core, more than 0 and at most 1."""
    share = float(text)
    if not 0.0 < share <= 1.0:
        raise ValueError
    return share


def _serve_commands(
    hub: ZenohBus, node: EdgeNode, robots: tuple[str, ...], script: Sequence[CommandEvent]
) -> ScaledClock:
    """Carry out an operator's and a script's commands to walk. Return the robot's clock."""
    times = RobotTimes(hub, lambda text: print(text, flush=True))

    def carry_out(command: Command) -> Accepted:
        if not isinstance(command, EdgeCommand):
            raise ConfigError(
                f"{command}: expected a command for the edge, got one for another service"
            )
        if len(robots) > 1:
            raise ConfigError(f"{command}: expected an edge of one robot, got {len(robots)}")
        # A velocity that is given again is an event, since it holds for a while only.
        return times.carried_out(command, tell=node.steer(command))

    CommandServer(hub, EDGE_COMMANDS_KEY, carry_out)
    times.play(script, carry_out)
    return times.clock


if __name__ == "__main__":
    run(main)
