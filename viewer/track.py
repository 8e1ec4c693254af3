"""The paths of a run's entities in a recording, alone or among several runs.

alone       world/com                  plots/com_error
compared    world/<run>/com            plots/com_error/<run>
"""

from __future__ import annotations

from dataclasses import dataclass

import rerun as rr

Colour = tuple[int, int, int]

# Distance between robots side by side [m].
SIDE_BY_SIDE = 1.2


@dataclass(frozen=True)
class Track:
    """A run's name, colour and place [m, world]; without a name it is alone."""

    name: str = ""
    colour: Colour | None = None
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def alone(self) -> bool:
        return not self.name

    @property
    def root(self) -> str:
        """The entity under which the scene is drawn."""
        return "world" if self.alone else f"world/{self._part}"

    @property
    def frame(self) -> str:
        """The coordinate frame of that entity."""
        return f"tf#/{self.root}"

    def world(self, entity: str) -> str:
        """Return the path of an entity in the scene."""
        return f"{self.root}/{entity}"

    def plot(self, path: str) -> str:
        """Return the path of a series or of a lane."""
        return path if self.alone else f"{path}/{self._part}"

    def line_name(self, name: str) -> str:
        """Return the name of a line in a legend."""
        return name if self.alone else self.name

    @property
    def _part(self) -> str:
        return rr.escape_entity_path_part(self.name)
