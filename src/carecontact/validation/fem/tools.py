"""Rigid tools that are pressed into tissue, described by the height of their surface above the tip. Lengths along the
limb come first, lengths across it second."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from carecontact.contract.embodiment import EMBODIMENTS
from carecontact.validation.result import Array

STEEPEST = 4.0
"""Slope (76 degrees) from which a round tool continues as a straight cone, so that its height is finite everywhere;
contact never reaches so far here."""
EDGE_M = 0.002
"""Radius of a disc's rounded rim, as in the simulator (``kernel/c/tool.c``)."""


@dataclass(frozen=True, kw_only=True)
class Tool:
    """A tool with its longer side across the limb, as the shipped cap is held."""

    name: str
    shape: Literal["ellipsoid", "disc"]
    semi_axes_m: tuple[float, float, float]
    """Semi-axes along, across and up; for a disc its radius, its radius again, and the radius of its rim."""

    @property
    def radius_m(self) -> float:
        """Radius of the circle with the tool's area as seen from above."""
        return float(np.sqrt(self.semi_axes_m[0] * self.semi_axes_m[1]))

    def height(self, along_m: Array, across_m: Array) -> Array:
        """Return the height above the tip [m], in the shape of the inputs."""
        a, b, up = self.semi_axes_m
        if self.shape == "ellipsoid":
            return _dome(np.hypot(along_m / a, across_m / b), up, STEEPEST * min(a, b) / up)
        r, face = np.hypot(along_m, across_m), a - up
        return _dome(np.maximum(r - face, 0.0) / up, up, STEEPEST)

    def reach_m(self, depth_m: float) -> float:
        """Return the distance from the axis up to which the tool can touch at this depth; a disc touches up to its
        radius.
        """
        a, b, up = self.semi_axes_m
        if self.shape == "disc":
            return a
        sunk = min(depth_m / up, 1.0)
        return max(a, b) * float(np.sqrt(1 - (1 - sunk) ** 2))


def _dome(share: Array, up_m: float, steepest: float) -> Array:
    """Return the height of half an ellipse at a share of its half width, continued straight from where its slope is
    ``steepest``.
    """
    last = steepest / np.hypot(1.0, steepest)
    inside = np.minimum(share, last)
    return up_m * (1 - np.sqrt(1 - inside**2) + steepest * np.maximum(share - last, 0.0))


def ball(radius_m: float) -> Tool:
    return Tool(name=f"ball {1000 * radius_m:.1f} mm", shape="ellipsoid", semi_axes_m=(radius_m, radius_m, radius_m))


def disc(radius_m: float) -> Tool:
    edge = min(EDGE_M, radius_m)
    return Tool(name=f"disc {1000 * radius_m:.1f} mm", shape="disc", semi_axes_m=(radius_m, radius_m, edge))


CAP = Tool(name="cap", shape="ellipsoid", semi_axes_m=EMBODIMENTS["caps"].tip.half_m)
"""The shipped tool: an ellipsoid, wider across the limb than along it."""
