"""The paths of a run's entities in a recording, alone or among several runs.

alone       world/com                  plots/com_error
compared    world/<run>/com            plots/com_error/<run>
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from viewer.colours import Colour

# Distance between robots side by side [m].
SIDE_BY_SIDE = 1.2


@dataclass(frozen=True)
class Track:
    """A run's name, colour and place [m, world]; a run without a name is alone."""

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

    def own_colour(self, colour: Colour) -> Colour:
        """Return the colour of a line or mark: its own, or that of the run among several."""
        return colour if self.colour is None else self.colour

    @property
    def _part(self) -> str:
        return path_part(self.name)


def path_part(name: str) -> str:
    """Return a name as a part of a path, which rerun shows as it is."""
    return re.sub(r"[^\w.-]+", "_", name)
