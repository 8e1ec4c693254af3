"""Show a live run on the light page until it is stopped."""

from __future__ import annotations

import asyncio
import json
import os
import time
from collections.abc import Callable
from functools import partial

from shared.bus.operator import CommandClient
from shared.bus.zenoh_bus import ZenohBus
from shared.config.settings import RunConfig
from shared.process.realtime import LOWEST_PRIORITY, RealtimeShare, prepare
from shared.robots import load_robot
from shared.wire.operator.events import CommandEvent
from shared.wire.operator.messages import EVENTS_KEY, VIEW_KEY, encode_event
from shared.wire.operator.texts import parse_command
from viewer.camera import focus_height
from viewer.intake import NICENESS, BlockQueue, connect, subscribe
from viewer.page.feed import Feed
from viewer.page.hulls import load_hulls
from viewer.page.server import PageServer
from viewer.rerun_process import free_port
from viewer.title import parts

PORT = 9090
# The time between two looks at the queue [s]. The robot's blocks come ten times a second.
_LOOK = 0.02
# The part of a core that the page has before ordinary programs. It takes about 0.04.
_REALTIME_SHARE = 0.1


def watch_page(
    config: RunConfig,
    *,
    telemetry: str,
    stopped: Callable[[], bool],
    say: Callable[[str], None],
) -> None:
    """Serve the page of a run until `stopped`; `UserError` if the hub cannot be reached.

    Print a line that starts with READY, the address alone on a line, and a line at the end.
    """
    os.nice(NICENESS)
    # A browser that draws takes all the time that the services leave.
    prepare(priority=LOWEST_PRIORITY)
    share = RealtimeShare(_REALTIME_SHARE)
    robot = load_robot(config.robot.name)
    hulls = load_hulls(robot)
    blocks, events = BlockQueue(), BlockQueue()
    bus = connect(telemetry, stopped=stopped)
    if bus is None:
        return
    feed = Feed(robot, config, hulls["joints"])
    words = {
        "words": parts(config),
        "focus": focus_height(robot),
        "walks": config.task == "walk",
        "drives": config.stepping.mode != "off",
    }
    server = PageServer(
        json.dumps({**hulls, **words}), feed.state, partial(_carry_out, bus, events)
    )
    seen = bus.publisher(VIEW_KEY)

    async def serve() -> None:
        await server.open(free_port(PORT))
        say("READY in a browser, at the address below")
        say(server.address)
        waits = True
        while not stopped():
            share.keep(time.monotonic_ns())
            changed = [feed.take(blocks.take()), feed.take_events(events.take())]
            if any(changed):
                server.show(feed.state)
            if waits and server.browsers:
                seen.publish(b"")
                waits = False
            await asyncio.sleep(_LOOK)
        await server.close()

    try:
        subscribe(bus, blocks, robot=robot.name)
        bus.subscribe(EVENTS_KEY, lambda delivery: events.put(delivery.data))
        asyncio.run(serve())
    finally:
        bus.close()
    say(f"{blocks.dropped} blocks dropped when behind, {feed.refused} blocks refused")


def _carry_out(bus: ZenohBus, events: BlockQueue, line: str) -> str:
    """Send a command to the stack. Return a note beside its event, often empty.

    Raise `UserError` if the command is refused.
    """
    command = parse_command(line)
    answer = CommandClient(bus).send(command)
    # A busy machine may drop the event that the stack publishes.
    events.put(encode_event(CommandEvent(answer.time_ns, command), wall_ns=0))
    return answer.note
