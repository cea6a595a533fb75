"""A person's geometry in the bind pose, and the mass, centre of mass and inertia of each segment."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

PARENT: dict[str, str | None] = {
    "pelvis": None, "abdomen": "pelvis", "thorax": "abdomen", "neck": "thorax", "head": "neck",
    **{f"{s}_clavicle": "thorax" for s in ("left", "right")},
    **{f"{s}_upper_arm": f"{s}_clavicle" for s in ("left", "right")},
    **{f"{s}_forearm": f"{s}_upper_arm" for s in ("left", "right")},
    **{f"{s}_hand": f"{s}_forearm" for s in ("left", "right")},
    **{f"{s}_thigh": "pelvis" for s in ("left", "right")},
    **{f"{s}_shank": f"{s}_thigh" for s in ("left", "right")},
    **{f"{s}_foot": f"{s}_shank" for s in ("left", "right")},
}  # fmt: skip
Sex = Literal["M", "F"]
AgeGroup = Literal["adult", "old"]
CHILD_ALONG = {"upper_arm": "forearm", "forearm": "hand", "thigh": "shank", "shank": "foot"}


@dataclass(frozen=True, kw_only=True)
class Body:
    """A body in the bind pose. In the mesh frame [m], z points up, the person faces -y, and their left is +x."""

    name: str
    """Name of the body, as ``library.load_body`` takes it."""
    sex: Sex
    """Selects the rows of de Leva's table."""
    age_group: AgeGroup
    """Selects the ranges of motion."""
    mass_kg: float
    licence: str
    vertices: Array
    """(V, 3)"""
    faces: npt.NDArray[np.int64]
    """(F, 3)"""
    uv: Array
    uv_faces: npt.NDArray[np.int64]
    segments: tuple[str, ...]
    joint_centre: dict[str, Array]
    weight_segment: npt.NDArray[np.int64]
    """(V, 4) index into segments"""
    weight: Array
    """(V, 4), rows sum to one"""
    is_eye: npt.NDArray[np.bool_]
    landmarks: dict[str, Array]
    meta: dict[str, Any]
    """Provenance."""
    sha256: str
    """sha256 of the body's file."""

    @cached_property
    def owner(self) -> npt.NDArray[np.int64]:
        """(V,) index of the segment with the largest weight."""
        return self.weight_segment[np.arange(len(self.vertices)), self.weight.argmax(1)]

    def vertices_of(self, *segments: str) -> Array:
        return self.vertices[np.isin(self.owner, [self.segments.index(s) for s in segments])]

    def faces_of(self, *segments: str) -> npt.NDArray[np.int64]:
        """Return the faces (n, 3) of which any corner belongs to one of the segments."""
        mine = np.isin(self.owner, [self.segments.index(s) for s in segments])
        return self.faces[mine[self.faces].any(1)]

    def direction(self, segment: str) -> Array:
        """Return the unit vector (3,) from the joint of a limb's segment to the next joint."""
        along = self.axis_vector(segment)
        return along / np.linalg.norm(along)

    def axis_vector(self, segment: str) -> Array:
        side, _, name = segment.partition("_")
        if name == "hand":
            return self.landmarks[f"finger3-3.{side[0].upper()}"] - self.joint_centre[segment]
        return self.joint_centre[f"{side}_{CHILD_ALONG[name]}"] - self.joint_centre[segment]

    @property
    def stature_m(self) -> float:
        return float(np.ptp(self.vertices[:, 2]))

    @property
    def bmi(self) -> float:
        """Body mass index [kg/m^2]."""
        return self.mass_kg / self.stature_m**2


# Segment masses, centres of mass and inertias: de Leva 1996, J Biomech 29:1223, Table 4 (adjusted Zatsiorsky-
# Seluyanov). Fractions are of body mass and of the segment's length; radii of gyration are about the sagittal,
# transverse and longitudinal axis.


@dataclass(frozen=True, kw_only=True)
class SegmentFractions:
    mass: float
    centre: float
    """Distance of the centre of mass from the segment's first end, as a share of its length."""
    gyration: tuple[float, float, float]
    """Radii of gyration about the sagittal, transverse and longitudinal axis, as shares of its length."""


def _row(mass: float, centre: float, sagittal: float, transverse: float, longitudinal: float) -> SegmentFractions:
    gyration = sagittal / 100, transverse / 100, longitudinal / 100
    return SegmentFractions(mass=mass / 100, centre=centre / 100, gyration=gyration)


DE_LEVA: dict[str, dict[str, SegmentFractions]] = {
    "M": {
        "head": _row(6.94, 50.02, 30.3, 31.5, 26.1),
        "thorax": _row(15.96, 50.66, 50.5, 32.0, 46.5),
        "abdomen": _row(16.33, 45.02, 48.2, 38.3, 46.8),
        "pelvis": _row(11.17, 61.15, 61.5, 55.1, 58.7),
        "upper_arm": _row(2.71, 57.72, 28.5, 26.9, 15.8),
        "forearm": _row(1.62, 45.74, 27.6, 26.5, 12.1),
        "hand": _row(0.61, 36.24, 28.8, 23.5, 18.4),
        "thigh": _row(14.16, 40.95, 32.9, 32.9, 14.9),
        "shank": _row(4.33, 43.95, 25.1, 24.6, 10.2),
        "foot": _row(1.37, 44.15, 25.7, 24.5, 12.4),
    },
    "F": {
        "head": _row(6.68, 48.41, 27.1, 29.5, 26.1),
        "thorax": _row(15.45, 50.50, 46.6, 31.4, 44.9),
        "abdomen": _row(14.65, 45.12, 43.3, 35.4, 41.5),
        "pelvis": _row(12.47, 49.20, 43.3, 40.2, 44.4),
        "upper_arm": _row(2.55, 57.54, 27.8, 26.0, 14.8),
        "forearm": _row(1.38, 45.59, 26.1, 25.7, 9.4),
        "hand": _row(0.56, 34.27, 24.4, 20.8, 15.4),
        "thigh": _row(14.78, 36.12, 36.9, 36.4, 16.2),
        "shank": _row(4.81, 43.52, 26.7, 26.3, 9.2),
        "foot": _row(1.29, 40.14, 29.9, 27.9, 13.9),
    },
}
# De Leva's head includes the neck, and his upper trunk the shoulders. The rig's neck and clavicles take a small share
# of them, so that each has an inertia of its own (the shares are assumed, the sums published).
SHARE_OF = {"neck": ("head", 0.15), "clavicle": ("thorax", 0.04)}


@dataclass(frozen=True, kw_only=True)
class SegmentInertia:
    mass_kg: float
    centre_m: Array
    """(3,) in the mesh frame"""
    axes: Array
    """(3, 3) columns: transverse, sagittal, longitudinal directions"""
    moments_kgm2: Array
    """(3,) moments about the axes in these columns"""


TRUNK_LENGTH_MM = {
    "M": {"thorax": 242.1, "abdomen": 215.5, "pelvis": 145.7},
    "F": {"thorax": 228.0, "abdomen": 205.3, "pelvis": 181.5},
}
"""Lengths of the trunk's segments from the neck down: cervicale, xiphion, omphalion, mid-hip (Table 4)."""


def kind_of(segment: str) -> str:
    """Return the name of a segment or hinge without its side."""
    return segment.removeprefix("left_").removeprefix("right_")


def segment_ends(body: Body, segment: str) -> tuple[Array, Array]:
    """Return the first and second end (3,) [m] of a body's segment, as de Leva defines them."""
    j, kind = body.joint_centre, kind_of(segment)
    if kind == "head":
        top = j["head"].copy()
        top[2] = body.vertices[:, 2].max()
        return top, j["neck"]
    if kind in TRUNK_LENGTH_MM[body.sex]:
        # The rig's spine joints are not de Leva's landmarks: his lengths, stacked from neck to hips, in proportion.
        lengths = TRUNK_LENGTH_MM[body.sex]
        ends = np.concatenate([[0.0], np.cumsum(list(lengths.values()))]) / sum(lengths.values())
        k = list(lengths).index(kind)
        line = j["pelvis"] - j["neck"]
        return j["neck"] + ends[k] * line, j["neck"] + ends[k + 1] * line
    if kind == "foot":
        points = body.vertices_of(segment)
        return points[points[:, 1].argmax()], points[points[:, 1].argmin()]
    return j[segment], j[segment] + body.axis_vector(segment)


def segment_inertias(body: Body) -> dict[str, SegmentInertia]:
    """Return the inertia of every segment of a body; the masses add up to the body's mass."""
    table = DE_LEVA[body.sex]
    total = sum(table[kind_of(segment)].mass for segment in body.segments if kind_of(segment) not in SHARE_OF)
    out: dict[str, SegmentInertia] = {}
    for segment in body.segments:
        kind = kind_of(segment)
        if kind in SHARE_OF:
            parent, share = SHARE_OF[kind]
            mass = body.mass_kg * table[parent].mass / total * share
            points = body.vertices_of(segment)
            size = np.maximum(np.ptp(points, axis=0), 0.05)
            moments = mass / 12 * (size @ size - size**2)
            centre, axes = points.mean(0), np.eye(3)
        else:
            row = table[kind]
            lent = sum(s * (2 if k == "clavicle" else 1) for k, (p, s) in SHARE_OF.items() if p == kind)
            mass = body.mass_kg * row.mass / total * (1 - lent)
            first, second = segment_ends(body, segment)
            along = second - first
            length = float(np.linalg.norm(along))
            centre = first + row.centre * along
            z = along / length
            x = np.cross(np.array([0.0, 1.0, 0.0]), z) if abs(z[1]) < 0.9 else np.cross(np.array([0.0, 0.0, 1.0]), z)
            x /= np.linalg.norm(x)
            axes = np.stack([x, np.cross(z, x), z], 1)
            sagittal, transverse, longitudinal = row.gyration
            moments = mass * (np.array([transverse, sagittal, longitudinal]) * length) ** 2
        out[segment] = SegmentInertia(mass_kg=mass, centre_m=centre, axes=axes, moments_kgm2=moments)
    return out
