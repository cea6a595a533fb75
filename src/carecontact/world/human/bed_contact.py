"""Contact of a lying body with the bed: spheres that touch its back from inside, and the tilt at which its trunk rests
on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carecontact.world.human.body import Array, Body

MOST_TILT_DEG = 1.5
"""Largest tilt [deg] of the trunk: the mattress gives way under the pelvis, which carries the most weight, until the
trunk lies about level (assumed)."""


@dataclass(frozen=True, kw_only=True)
class Proxy:
    """A sphere that meets only the bed, the pillow and the arm board."""

    name: str
    segment: str
    centre: Array
    """(3,) mesh frame, bind pose"""
    radius_m: float


def bed_proxies(body: Body) -> list[Proxy]:
    rows: list[Proxy] = []

    def under(segment: str, name: str, surface: Array, radius: float, *, sunk_m: float = 0.0) -> None:
        """Add a sphere that touches the rearmost point of a surface from inside or, with ``sunk_m``, stays so far from
        it.
        """
        centre = surface - np.array([0, radius + sunk_m, 0])
        rows.append(Proxy(name=name, segment=segment, centre=centre, radius_m=radius))

    j = body.joint_centre
    sunk = pelvis_immersion(body)
    for side in ("left", "right"):
        buttock, scapula = _trunk_supports(body, side)
        under("pelvis", f"{side}_buttock", buttock, BUTTOCK_RADIUS_M, sunk_m=sunk)
        under("thorax", f"{side}_scapula", scapula, SCAPULA_RADIUS_M)
        calf = j[f"{side}_shank"] + 0.35 * body.axis_vector(f"{side}_shank")
        under(f"{side}_shank", f"{side}_calf", _back_of(body.vertices_of(f"{side}_shank"), calf), 0.04)
        foot = body.vertices_of(f"{side}_foot")
        under(f"{side}_foot", f"{side}_heel", foot[foot[:, 1].argmax()], 0.025)
        # Limbs turn about their own axis, so that a sphere centred on it meets the bed in the same way at every turn.
        # A percentile of the section's radii serves as radius, so that the skin does not sink into the board.
        for segment, along, name, inside in (
            ("upper_arm", 0.95, "elbow", 60), ("forearm", 0.92, "wrist", 85), ("hand", 0.55, "hand", 60),
        ):  # fmt: skip
            full = f"{side}_{segment}"
            points = body.vertices_of(full, *([f"{side}_forearm"] if segment == "upper_arm" else []))
            axis = body.axis_vector(full)
            length = float(np.linalg.norm(axis))
            unit = axis / length
            centre = j[full] + along * axis
            near = points[np.abs((points - centre) @ unit) < 0.02]
            off = near - centre
            centre = centre + (off.mean(0) - (off.mean(0) @ unit) * unit)
            off = near - centre
            radius = float(np.percentile(np.linalg.norm(off - np.outer(off @ unit, unit), axis=1), inside))
            rows.append(Proxy(name=f"{side}_{name}", segment=full, centre=centre, radius_m=radius))
    head = body.vertices_of("head")
    occiput = head[head[:, 1].argmax()]
    under("head", "occiput", np.array([0, occiput[1], occiput[2]]), 0.07)
    return rows


BUTTOCK_RADIUS_M, SCAPULA_RADIUS_M = 0.07, 0.06


def pelvis_immersion(body: Body) -> float:
    """Return how much deeper the buttocks sink into the mattress than the shoulder blades [m]."""
    buttock, scapula = _trunk_supports(body, "right")
    apart = scapula[2] - buttock[2]
    return max(0.0, float(buttock[1] - scapula[1] - apart * np.sin(np.radians(MOST_TILT_DEG))))


def trunk_tilt(body: Body) -> float:
    """Return the angle [rad] by which the trunk's head end is lowered when buttocks and shoulder blades rest on the
    bed.
    """
    at = {p.name: p for p in bed_proxies(body)}
    low, high = at["right_buttock"], at["right_scapula"]
    along, depth = high.centre[2] - low.centre[2], low.centre[1] - high.centre[1]
    # The angle of the common tangent of two circles, from the line of their centres and the difference of their radii.
    return float(np.arctan2(depth, along) + np.arcsin((low.radius_m - high.radius_m) / np.hypot(along, depth)))


def _trunk_supports(body: Body, side: str) -> tuple[Array, Array]:
    """Return the rearmost points (3,) of the buttock and of the shoulder blade."""
    sign = 1.0 if side == "left" else -1.0
    j = body.joint_centre
    trunk = body.vertices_of("pelvis", "abdomen", "thorax", "left_thigh", "right_thigh")
    buttock = _back_of(trunk, np.array([sign * 0.08, 0, j[f"{side}_thigh"][2] - 0.01]))
    return buttock, _back_of(trunk, np.array([sign * 0.09, 0, j[f"{side}_upper_arm"][2] - 0.06]))


def _back_of(points: Array, near: Array, radius: float = 0.04) -> Array:
    """Return the rearmost surface point near a point, by distance across the body's front-back axis."""
    distance = np.hypot(points[:, 0] - near[0], points[:, 2] - near[2])
    close = points[distance < radius] if (distance < radius).any() else points[[distance.argmin()]]
    return np.array([near[0], close[:, 1].max(), near[2]])
