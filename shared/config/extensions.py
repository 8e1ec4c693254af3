"""The tables of controllers, tasks, plants and robots to which others can add: see `Names`."""

from __future__ import annotations

from collections.abc import Mapping

from shared.extensions import Extensions, Names
from shared.robots.catalogue import ROBOTS

CONTROLLERS = Extensions(
    "controller",
    "remote_wbc.controllers",
    {
        "la": "robot_node.controllers:LocallyAssisted",
        "lc": "robot_node.corrected:LocallyCorrected",
        "pr": "robot_node.controllers:PurelyRemote",
    },
    "docs/own-controller.md",
    capitals=True,
)
TASKS = Extensions(
    "task",
    "remote_wbc.tasks",
    {
        "balance": "shared.motion.plan:standing",
        "walk": "shared.motion.plan:walking",
        "go": "shared.motion.plan:going",
    },
    "docs/own-controller.md",
)
PLANTS = Extensions(
    "plant",
    "remote_wbc.plants",
    {"mujoco": "robot_node.plant:MujocoPlant", "rigid": "robot_node.rigid_plant:RigidPlant"},
    "docs/own-controller.md",
)
TABLES: Mapping[str, Names] = {
    "controller": CONTROLLERS,
    "task": TASKS,
    "plant.kind": PLANTS,
    "robot.name": ROBOTS,
}


def corrects(controller: str) -> bool:
    """Return whether a controller corrects its last solution.

    Then it reports a contraction, and needs no fresh projector after a contact switch.
    """
    return bool(getattr(CONTROLLERS.load(controller), "corrects", False))
