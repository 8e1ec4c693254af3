"""A robot that stands still and sends its state at several rates in turn, as a process.

Each message is a new state, by its number and its time, for an edge that serves LA. The process has
the lowest priority, because another robot would have another computer. It prints READY, and
`RATE time rate sent` at each change: the machine's monotonic clock [ns], the new rate [1/s], and
the number of messages so far. SIGTERM ends it.
"""

from __future__ import annotations

from remote_wbc import begin

begin(__name__)

import dataclasses
import itertools
import os
import time

import numpy as np

from shared.bus.base import Publisher
from shared.bus.zenoh_bus import ZenohBus
from shared.clock import Ticker, sleep_until
from shared.commands import python_module
from shared.config.config_file import load_config
from shared.motion.plan import make_motion
from shared.process.cli import EXIT_STANDING, Parser, run
from shared.process.service import StopSignal
from shared.robots import load_robot
from shared.wbc.contacts import ContactMode
from shared.wire.channels import DOWNLINK, UPLINK
from shared.wire.codec import Codec
from shared.wire.messages import RobotState

_PERIOD_NS = 1_000_000
_CONNECT_SECONDS = 30.0


def main() -> int:
    parser = Parser(prog=python_module("benchmarks.fast_robot"), description=__doc__)
    parser.add_argument("--endpoint", required=True, help="the edge's endpoint")
    parser.add_argument("--name", required=True, help="the robot's name")
    parser.add_argument(
        "--rates", required=True, help="messages per second, multiples of 1000: A,B"
    )
    parser.add_argument("--seconds", type=float, required=True, help="time at each rate [s]")
    arguments = parser.parse_args()
    stop = StopSignal()
    os.nice(19)
    config = load_config(None, {"controller": "la", "push": []})
    robot = load_robot(config.robot.name)
    codec = Codec(robot, config, make_motion(robot, config))
    bus = ZenohBus.dial(arguments.endpoint, within=_CONNECT_SECONDS, largest=DOWNLINK.max_bytes)
    publisher = bus.publisher(UPLINK.key_for(arguments.name))
    # As a robot does, which takes its answers.
    bus.subscribe(DOWNLINK.key_for(arguments.name), lambda delivery: None)
    print("READY", flush=True)
    state = RobotState(
        session=os.getpid(),
        sequence=0,
        stamp_ns=0,
        time_ns=0,
        mode=ContactMode.DOUBLE_SUPPORT,
        q=robot.q_standing.copy(),
        v=np.zeros(robot.model.nv),
    )
    rates = itertools.cycle(int(each) for each in arguments.rates.split(","))
    for rate in rates:
        print(f"RATE {time.monotonic_ns()} {rate} {state.sequence}", flush=True)
        state = _send(publisher, codec, state, stop, rate=rate, seconds=arguments.seconds)
        if stop.requested:
            break
    bus.close()
    return EXIT_STANDING


def _send(
    publisher: Publisher,
    codec: Codec,
    state: RobotState,
    stop: StopSignal,
    *,
    rate: int,
    seconds: float,
) -> RobotState:
    """Send states at a rate for a time, or until stopped. Return the last one."""
    per_tick = rate * _PERIOD_NS // 1_000_000_000
    began_ns = time.monotonic_ns()
    ticker = Ticker(start_ns=began_ns, period_ns=_PERIOD_NS)
    while not stop.requested and ticker.due_ns < began_ns + seconds * 1e9:
        sleep_until(ticker.due_ns)
        for _ in range(per_tick):
            now_ns = time.monotonic_ns()
            state = dataclasses.replace(state, sequence=state.sequence + 1, stamp_ns=now_ns)
            publisher.publish(codec.encode_state(state))
        ticker.next(time.monotonic_ns())
    return state


if __name__ == "__main__":
    run(main)
