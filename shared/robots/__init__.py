"""Robots: the data that the controller needs, and the catalogue of known robots."""

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
