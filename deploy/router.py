"""Run a router: robots and edges behind NATs dial it, and it carries messages between them.

`python -m deploy.router --listen tls/0.0.0.0:7447 --secure`. The router carries only messages with
a key that the sender may use; it never reads a message. With certificates it admits the robots
whose certificate, robot-NAME.crt, is in its folder.
"""

from __future__ import annotations

from remote_wbc import begin

begin(__name__)

import os

# While a queue is full, the receiving thread waits for a sending thread. So a router cannot do with
# the nodes' single thread. Zenoh reads this variable when it is imported.
os.environ.pop("ZENOH_RUNTIME", None)

import time

from shared.bus.security import ROUTER, Credentials
from shared.bus.zenoh_bus import ZenohBus
from shared.commands import python_module
from shared.config.link_settings import LoopConfig
from shared.process.cli import EXIT_STANDING, Parser, run
from shared.process.service import StopSignal, add_secure_argument
from shared.wire.channels import DOWNLINK

_ENDPOINT = "tcp/127.0.0.1:7447"
_POLL_SECONDS = 0.1


def main() -> int:
    parser = Parser(prog=python_module("deploy.router"), description=__doc__)
    parser.add_argument(
        "--listen",
        metavar="ENDPOINT",
        default=_ENDPOINT,
        help="endpoint to listen on (default %(default)s)",
    )
    add_secure_argument(parser)
    arguments = parser.parse_args()
    credentials = None
    admits = "everybody"
    if arguments.secure is not None:
        credentials = Credentials.load(arguments.secure, ROUTER)
        admits = ", ".join(credentials.robots) or "no robot: copy certificates into its folder"
    stop = StopSignal()
    bus = ZenohBus(
        listen=[arguments.listen],
        mode="router",
        largest=DOWNLINK.max_bytes,
        lease=LoopConfig().link_lease,
        credentials=credentials,
    )
    print(f"READY {arguments.listen}, admits {admits}", flush=True)
    while not stop.requested:
        time.sleep(_POLL_SECONDS)
    bus.close()
    print("stopped", flush=True)
    return EXIT_STANDING


if __name__ == "__main__":
    run(main)
