"""The table of the robot's controllers, by the name that a configuration gives.

To add a controller to the project, add a file in `robot_node` and an entry here.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ControllerEntry:
    """A controller: its class, as `module:Class`, and whether it `corrects` its last solution.

    A controller that corrects reports a contraction, and needs no fresh projector after a contact
    switch.
    """

    factory: str
    corrects: bool = False


CONTROLLERS = {
    "la": ControllerEntry("robot_node.controllers:LocallyAssisted"),
    "lc": ControllerEntry("robot_node.corrected:LocallyCorrected", corrects=True),
    "pr": ControllerEntry("robot_node.controllers:PurelyRemote"),
}
