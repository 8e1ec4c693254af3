"""Robots: what the controller must know of one, and the catalogue of those that are known."""

from shared.robots.catalogue import CATALOGUE, description_of, load_robot
from shared.robots.description import Foot, FootDescription, Robot, RobotDescription

__all__ = [
    "CATALOGUE",
    "Foot",
    "FootDescription",
    "Robot",
    "RobotDescription",
    "description_of",
    "load_robot",
]
