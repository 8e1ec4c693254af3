"""Blockers that cross the line of sight: the times at which they cut it, and their diffraction.

A blocker is a box that moves to and fro along a track square to the path. Seen along the path it is
an upright screen of width w and unlimited height. While the screen covers the line, the path has no
line of sight. While the screen is beside the line, its edges diffract, TR 38.901 clause 7.6.4.2
(blockage model B),

    L = −20 log₁₀(1 − (F_h1 + F_h2)(F_w1 + F_w2)),   F = ± atan(π/2 √(π/λ (D₁ + D₂ − r))) / π,

with D₁ + D₂ the path over an edge and r the straight path. The sign is + for an edge beyond which
the line is covered. It is − for the nearer edge of a screen that leaves the line free. The
unlimited height gives F_h1 + F_h2 = 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

WAVELENGTH = 299_792_458.0 / 28e9


@dataclass(frozen=True)
class Blockers:
    """Several blockers, arrays (n,), with a common track length and speed.

    Each crosses the path at `fraction` of its length from the access point. It is `width` long
    along its track and `depth` long along the path [m]. `start` is the distance covered at time 0
    along the track and back, in [0, 4 `half_track`) [m].
    """

    fraction: np.ndarray
    width: np.ndarray
    depth: np.ndarray
    start: np.ndarray
    half_track: float
    speed: float

    def positions(self, seconds: np.ndarray) -> np.ndarray:
        """The position of each on its track, from −`half_track` to `half_track` [m], (n, times)."""
        gone = (self.start[:, None] + self.speed * seconds) % (4.0 * self.half_track)
        position: np.ndarray = np.abs(gone - 2.0 * self.half_track) - self.half_track
        return position

    def screens(self, slant: np.ndarray) -> np.ndarray:
        """Width of the screen of each, seen along the path [m], (n, times).

        `slant` (times,) is the tangent of the angle between the path and the normal of the tracks.
        """
        width: np.ndarray = self.width[:, None] + self.depth[:, None] * np.abs(slant)
        return width


def covers(offset: np.ndarray, width: np.ndarray) -> np.ndarray:
    """Return whether a screen with its centre `offset` [m] beside the line cuts the line."""
    covered: np.ndarray = np.abs(offset) < width / 2.0
    return covered


def knife_edge_loss_db(
    offset: np.ndarray,
    width: np.ndarray | float,
    *,
    before: np.ndarray | float,
    behind: np.ndarray | float,
) -> np.ndarray:
    """Loss by a screen with its centre `offset` [m] beside the line [dB].

    `before` is the distance along the line from the transmitter to the screen, `behind` the
    distance from the screen to the receiver [m]. All arguments broadcast.
    """
    near, far = np.abs(offset) - np.divide(width, 2.0), np.abs(offset) + np.divide(width, 2.0)
    # The line is always covered beyond the far edge, and beyond the near edge only if it is cut.
    covered = _edge(far, before, behind) - np.sign(near) * _edge(near, before, behind)
    loss: np.ndarray = -20.0 * np.log10(1.0 - covered)
    return loss


def _edge(
    distance: np.ndarray, before: np.ndarray | float, behind: np.ndarray | float
) -> np.ndarray:
    """|F| of an edge `distance` [m] beside the line."""
    over = np.hypot(before, distance) + np.hypot(behind, distance) - (before + behind)
    part: np.ndarray = (
        np.arctan(np.pi / 2.0 * np.sqrt(np.pi / WAVELENGTH * np.maximum(over, 0.0))) / np.pi
    )
    return part
