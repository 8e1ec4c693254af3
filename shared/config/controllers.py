"""The table of the robot's controllers, by the name that a configuration gives.

A controller of the project's own is one file in `robot_node` and one entry here.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ControllerEntry:
    """A controller: where its class is, as `module:Class`, and what reports say of it.

    `corrects`: it corrects its last solution, so that it reports a contraction and has no use for
    a fresh projector after a contact switch.
    """

    factory: str
    corrects: bool = False


CONTROLLERS = {
    "la": ControllerEntry("robot_node.controllers:LocallyAssisted"),
    "lc": ControllerEntry("robot_node.corrected:LocallyCorrected", corrects=True),
    "pr": ControllerEntry("robot_node.controllers:PurelyRemote"),
}
