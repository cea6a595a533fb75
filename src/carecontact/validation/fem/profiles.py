"""Rigid indenters with an axis of symmetry, as the height of their surface above the tip."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from carecontact.contract.embodiment import PANDA
from carecontact.sim.bench import FLAT_DOME_M, Indenter
from carecontact.validation.result import Array

Profile = Callable[[Array], Array]
"""Radius [m] -> height of the indenter's surface above its tip [m], of the same shape."""

STEEPEST = 4.0
"""Slope at which a round profile continues as a straight cone, 76 degrees: contact never reaches it here, and a height
stays finite everywhere."""


def profile(indenter: Indenter) -> Profile:
    """The bench's own indenter. The cap is not round: its place takes a spheroid with the same section areas."""
    if indenter.shape == "hemisphere":
        return spheroid(indenter.size_m or 0.0, indenter.size_m or 0.0)
    if indenter.shape == "flat":
        return flat(indenter.size_m or 0.0, indenter.edge_m)
    along, across, height = PANDA.cap_semi_axes_m
    return spheroid(float(np.sqrt(along * across)), height)


def spheroid(radius_m: float, height_m: float) -> Profile:
    """Half a spheroid with ``radius_m`` at its widest and ``height_m`` along its axis."""
    # Where height' = (height / radius) s / sqrt(1 - s^2) reaches STEEPEST, s = r / radius.
    ratio = STEEPEST * radius_m / height_m
    last = radius_m * ratio / np.hypot(1.0, ratio)

    def height(r: Array) -> Array:
        s = np.minimum(r, last) / radius_m
        return height_m * (1 - np.sqrt(1 - s**2)) + STEEPEST * np.maximum(r - last, 0.0)

    return height


def flat(radius_m: float, edge_m: float, dome_m: float = FLAT_DOME_M) -> Profile:
    """A disc with a rounded rim of ``edge_m``, whose face rises by ``dome_m`` as the bench's does; 0 edge: sharp."""
    edge = min(edge_m, radius_m)
    face = radius_m - edge
    rim = spheroid(edge, edge) if edge > 0 else lambda r: STEEPEST * r

    def height(r: Array) -> Array:
        share = np.minimum(r / face, 1.0) if face > 0 else np.ones_like(r)
        return dome_m * share**2 + rim(np.maximum(r - face, 0.0))

    return height


def on_a_cylinder(profile: Profile, radius_m: float) -> Profile:
    """The indenter as a round limb meets it: the limb's surface falls away as y^2 / (2 radius), whose mean over a
    circle of radius r is r^2 / (4 radius). This is exact for the gap's mean, and the tissue stays a flat layer."""
    return lambda r: profile(r) + r**2 / (4 * radius_m)
