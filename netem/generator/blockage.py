"""Blockers that cross the line of sight: when they cut it, and what their edges cost before that.

A blocker is a box that goes to and fro along a track square to the path. Seen along the path it is
an upright screen of width w and unlimited height. While the screen covers the line the path is
without line of sight. While it is beside the line its edges diffract, TR 38.901 clause 7.6.4.2
(blockage model B),

    L = −20 log₁₀(1 − (F_h1 + F_h2)(F_w1 + F_w2)),   F = ± atan(π/2 √(π/λ (D₁ + D₂ − r))) / π,

with D₁ + D₂ the path over an edge and r the straight one; + for an edge beyond which the line is
covered, − for the nearer edge of a screen that leaves it free. Unlimited height: F_h1 + F_h2 = 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

WAVELENGTH = 299_792_458.0 / 28e9


@dataclass(frozen=True)
class Blockers:
    """Several blockers, arrays (n,), and what is common to them.

    Each crosses the path at `fraction` of it, counted from the access point. Seen along the track
    it is `width` long, seen along the path `depth` [m]. `start` [m] is the way gone at time 0 along
    the track and back, in [0, 4 `half_track`).
    """

    fraction: np.ndarray
    width: np.ndarray
    depth: np.ndarray
    start: np.ndarray
    half_track: float
    speed: float

    def positions(self, seconds: np.ndarray) -> np.ndarray:
        """Where each is on its track, from −`half_track` to `half_track` [m]; (n, times)."""
        gone = (self.start[:, None] + self.speed * seconds) % (4.0 * self.half_track)
        position: np.ndarray = np.abs(gone - 2.0 * self.half_track) - self.half_track
        return position

    def screens(self, slant: np.ndarray) -> np.ndarray:
        """Width of each as the path sees it [m], (n, times).

        `slant` (times,): the tangent of the angle between the path and the normal of the tracks.
        """
        width: np.ndarray = self.width[:, None] + self.depth[:, None] * np.abs(slant)
        return width


def covers(offset: np.ndarray, width: np.ndarray) -> np.ndarray:
    """Whether a screen with its centre `offset` [m] beside the line cuts it."""
    covered: np.ndarray = np.abs(offset) < width / 2.0
    return covered


def knife_edge_loss_db(
    offset: np.ndarray,
    width: np.ndarray | float,
    *,
    before: np.ndarray | float,
    behind: np.ndarray | float,
) -> np.ndarray:
    """Loss [dB] by a screen with its centre `offset` [m] beside the line.

    `before` and `behind` [m]: along the line from the transmitter to the screen, and from there to
    the receiver. Everything broadcasts.
    """
    near, far = np.abs(offset) - np.divide(width, 2.0), np.abs(offset) + np.divide(width, 2.0)
    # beyond the far edge the line is always covered, beyond the near one only if it is cut
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
