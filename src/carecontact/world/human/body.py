"""A person's geometry, mass, sex and age group in the bind pose. ``world.human.library`` loads one by its name."""

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
    """A person's body in the bind pose. In the mesh frame [m], z points up, the person faces -y, and their left is
    +x.
    """

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
