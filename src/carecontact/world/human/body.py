"""A person's geometry, mass, sex and age group, read with numpy.

Shipped archives are made by ``tools/bake_body.py``; ``world.human.smplx`` reads a user's own SMPL-X file.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from carecontact.errors import AssetError, UnknownNameError

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
SMPLX_PREFIX = "smplx:"
CHILD_ALONG = {"upper_arm": "forearm", "forearm": "hand", "thigh": "shank", "shank": "foot"}


def body_names() -> list[str]:
    folder = resources.files("carecontact") / "assets" / "bodies"
    return sorted(p.name.removesuffix(".npz") for p in folder.iterdir() if p.name.endswith(".npz"))


@dataclass(frozen=True, kw_only=True)
class Body:
    """Bind pose, mesh frame: z up, facing -y, the person's left is +x [m]."""

    name: str
    """As ``load_body`` takes it."""
    sex: Sex
    """Chooses the rows of de Leva's table."""
    age_group: AgeGroup
    """Chooses the ranges of motion."""
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
    """Of the file."""

    @cached_property
    def owner(self) -> npt.NDArray[np.int64]:
        """(V,) index of the segment with the largest weight."""
        return self.weight_segment[np.arange(len(self.vertices)), self.weight.argmax(1)]

    def vertices_of(self, *segments: str) -> Array:
        return self.vertices[np.isin(self.owner, [self.segments.index(s) for s in segments])]

    def faces_of(self, *segments: str) -> npt.NDArray[np.int64]:
        """Faces with any corner owned by the segments."""
        mine = np.isin(self.owner, [self.segments.index(s) for s in segments])
        return self.faces[mine[self.faces].any(1)]

    def direction(self, segment: str) -> Array:
        """Unit vector from a limb segment's joint to the next one's."""
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
        """[kg/m^2]"""
        return self.mass_kg / self.stature_m**2


def smplx_path(name: str) -> Path:
    """The file that ``smplx:FILE.npz?...`` names."""
    return Path(name.removeprefix(SMPLX_PREFIX).partition("?")[0])


def load_body(name: str) -> Body:
    """A shipped body by name, or ``smplx:FILE.npz?sex=F``.

    Raises UnknownNameError, AssetError when a shipped archive's recorded hash is missing or another one, and
    ConfigError for an SMPL-X file that cannot be used.
    """
    if name.startswith(SMPLX_PREFIX):
        from carecontact.world.human.smplx import load_smplx

        return load_smplx(name)
    if name not in body_names():
        raise UnknownNameError("body", name, [*body_names(), f"{SMPLX_PREFIX}FILE.npz?sex=F (your own)"])
    folder = resources.files("carecontact") / "assets" / "bodies"
    data = (folder / f"{name}.npz").read_bytes()
    digest = hashlib.sha256(data).hexdigest()
    try:
        expected = json.loads((folder / f"{name}.provenance.json").read_text())["sha256"]
    except OSError as error:
        raise AssetError(f"body {name}: {error}; reinstall the package or run tools/bake_body.py") from None
    if digest != expected:
        raise AssetError(f"body {name}.npz has sha256 {digest[:12]}..., its provenance file says {expected[:12]}...")
    with resources.as_file(folder / f"{name}.npz") as path, np.load(path) as z:
        arrays = {k: z[k] for k in z.files}
    segments = tuple(str(s) for s in arrays["segments"])
    weight = arrays["weight"].astype(np.float64)
    centres = dict(zip(segments, arrays["joint_centres_m"].astype(np.float64), strict=True))
    # The rig's root and first spine bone share one point; the pelvis turns about the hips, the trunk about L5/S1.
    centres["pelvis"] = (centres["left_thigh"] + centres["right_thigh"]) / 2
    centres["abdomen"] = centres["pelvis"] + 0.25 * (centres["thorax"] - centres["pelvis"])
    meta = json.loads(arrays["meta_json"].tobytes())
    return Body(
        name=name,
        sex=meta["parameters"]["sex"],
        age_group=meta["parameters"]["age"],
        mass_kg=float(meta["measured_by_anny"]["mass"]),
        licence=meta["licence"],
        vertices=arrays["vertices_m"].astype(np.float64),
        faces=arrays["faces"].astype(np.int64),
        uv=arrays["uv"].astype(np.float64),
        uv_faces=arrays["uv_faces"].astype(np.int64),
        segments=segments,
        joint_centre=centres,
        weight_segment=arrays["weight_segment"].astype(np.int64),
        weight=weight / weight.sum(1, keepdims=True),
        is_eye=arrays["is_eye"],
        landmarks=dict(
            zip([str(n) for n in arrays["landmark_names"]], arrays["landmarks_m"].astype(np.float64), strict=True)
        ),
        meta=meta,
        sha256=digest,
    )
