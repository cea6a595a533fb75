"""Planes in which the hulls of neighbouring plates meet, so that a push meets one plate wherever it is clear of them.

Where hulls overlap, both plates carry what lies there, each with a spring of its own, and that place is too stiff.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carecontact.world.human.body import Array, Body
from carecontact.world.human.plates import SIDEWAYS
from carecontact.world.human.shell import belly_half_width, belly_span

ARMPIT_M, NECK_M = 0.07, 0.10
ARMPIT_SHARE, GIRDLE_SHARE = 1.15, 0.45
"""The plane between chest and shoulder girdle runs through a point ARMPIT_M below the height of the shoulder's joint,
at ARMPIT_SHARE of the way from the breastbone to it, and one NECK_M above that height at GIRDLE_SHARE of the way. So
the ribs belong to the chest as far as the armpit (our choice)."""
HIP_M = 0.13
"""Distance from the abdomen's lower end down to the plane between hip and thigh."""
RIM_M = 0.015
"""How far the flank reaches under the abdomen's soft region, so that no gap is left between them."""


@dataclass(frozen=True, kw_only=True)
class Plane:
    """A plane in the mesh frame; what it bounds lies at negative heights."""

    normal: Array
    """(3,) unit vector"""
    offset_m: float

    def height_m(self, points: Array) -> Array:
        """Return the heights (n,) of points (n, 3) over the plane."""
        return points @ self.normal - self.offset_m

    @property
    def turned(self) -> Plane:
        return Plane(normal=-self.normal, offset_m=-self.offset_m)


def below(z_m: float) -> Plane:
    return Plane(normal=np.array([0.0, 0.0, 1.0]), offset_m=z_m)


def girdle(body: Body, side: str) -> Plane:
    """Return the plane between chest and shoulder girdle; the chest lies below it."""
    sideways, shoulder = SIDEWAYS[side], body.joint_centre[f"{side}_upper_arm"]
    lower = shoulder * [ARMPIT_SHARE, 1.0, 1.0] - [0.0, 0.0, ARMPIT_M]
    upper = shoulder * [GIRDLE_SHARE, 1.0, 1.0] + [0.0, 0.0, NECK_M]
    run = lower - upper
    normal = np.array([-run[2], 0.0, run[0]]) * sideways[0]
    normal /= np.linalg.norm(normal)
    return Plane(normal=normal, offset_m=float(normal @ lower))


def parted(body: Body) -> dict[str, Array]:
    """Return, for every plate whose hull would otherwise overlap another's, the points (n, 3) of its hull."""
    low, high = belly_span(body)
    hip = low - HIP_M
    found: dict[str, Array] = {}
    for side, outward in SIDEWAYS.items():
        middle = Plane(normal=-outward, offset_m=float(-outward @ body.joint_centre["pelvis"]))
        beside = Plane(normal=-outward, offset_m=RIM_M - belly_half_width(body))
        arm = girdle(body, side)
        ribs, trunk = ("thorax", "left_clavicle", "right_clavicle"), ("thorax", "abdomen", "pelvis")
        pelvis = ("pelvis", "left_thigh", "right_thigh", "abdomen")
        found |= {
            f"{side}_chest": clipped(body, ribs, below(high).turned, middle, arm),
            f"{side}_shoulder": clipped(body, ribs, below(high).turned, middle, arm.turned),
            f"{side}_flank": clipped(body, trunk, below(low).turned, below(high), beside),
            f"{side}_hip": clipped(body, pelvis, below(hip).turned, below(low), middle),
            f"{side}_thigh": clipped(body, (f"{side}_thigh",), below(hip)),
        }
    return found


def clipped(body: Body, segments: tuple[str, ...], *planes: Plane) -> Array:
    """Return points (n, 3) of the surface of some segments below all planes: its vertices, and the places where its
    edges cross a plane.
    """
    mine = np.isin(body.owner, [body.segments.index(s) for s in segments])
    faces = body.faces[mine[body.faces].all(1)]
    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1), axis=0)
    rows = [body.vertices[mine]]
    for plane in planes:
        a, b = body.vertices[edges[:, 0]], body.vertices[edges[:, 1]]
        over_a, over_b = plane.height_m(a), plane.height_m(b)
        cross = over_a * over_b < 0
        share = over_a[cross] / (over_a[cross] - over_b[cross])
        rows.append(a[cross] + share[:, None] * (b - a)[cross])
    points = np.concatenate(rows)
    return points[np.all([plane.height_m(points) < 1e-9 for plane in planes], axis=0)]
