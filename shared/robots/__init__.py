"""Robots: the data that the controller needs, and the catalogue of known robots."""

from shared.robots.catalogue import CATALOGUE, ROBOTS, description_of, load_robot
from shared.robots.description import GRAVITY, Foot, Robot, RobotDescription, Sole

__all__ = [
    "CATALOGUE",
    "GRAVITY",
    "ROBOTS",
    "Foot",
    "Robot",
    "RobotDescription",
    "Sole",
    "description_of",
    "load_robot",
]
