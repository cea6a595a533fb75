"""Bodies by name: the shipped archives, made by ``tools/bake_body.py``, and a user's own SMPL-X model, read with numpy
alone."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from contextlib import suppress
from dataclasses import replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Literal
from urllib.parse import parse_qsl

import numpy as np
import numpy.typing as npt

from carecontact.errors import AssetError, ConfigError, UnknownNameError
from carecontact.human.body import PARENT, AgeGroup, Array, Body, Sex
from carecontact.human.joints import elbow_axis, hand_axes, supination_of


def body_file(name: str) -> bytes:
    """Return the content of a file in the folder of bodies. Raises OSError for one that cannot be read."""
    folder = body_folder()
    found = _contents(folder)
    return found[name] if name in found else (folder / name).read_bytes()


def body_folder() -> Path:
    return Path(str(resources.files("carecontact") / "assets" / "bodies"))


@cache
def _contents(folder: Path) -> dict[str, bytes]:
    """Read all files together: access times and what the system keeps in memory then reveal no trial's body."""
    found: dict[str, bytes] = {}
    for path in sorted(folder.iterdir()):
        with suppress(OSError):
            found[path.name] = path.read_bytes()
    return found


# A user's own SMPL-X model as a body: ``smplx:FILE.npz?sex=F&age=old&betas=0.5,-1``. Needs numpy only.
#
# It reads these arrays of the official archive (https://smpl-x.is.tue.mpg.de, whose licence forbids shipping it):
# ``v_template``, ``f``, ``weights``, ``J_regressor``, ``kintree_table``; ``shapedirs`` if betas are given; ``vt`` and
# ``ft`` if they are there. Pose and expression blend shapes are not used: the skin turns by linear blending alone.

SMPLX_PREFIX = "smplx:"
BODY_JOINTS = (
    *"pelvis left_hip right_hip spine1 left_knee right_knee spine2 left_ankle right_ankle spine3 left_foot".split(),
    *"right_foot neck left_collar right_collar head left_shoulder right_shoulder left_elbow right_elbow".split(),
    *"left_wrist right_wrist jaw left_eye right_eye".split(),
)
SIDES = ("left", "right")
FINGERS = [f"{finger}{k}" for finger in ("index", "middle", "pinky", "ring", "thumb") for k in (1, 2, 3)]
JOINTS = (*BODY_JOINTS, *(f"{side}_{joint}" for side in SIDES for joint in FINGERS))
"""The 55 joints of SMPL-X, in the order of its files."""
LIMB_JOINTS = {
    "clavicle": ["collar"],
    "upper_arm": ["shoulder"],
    "forearm": ["elbow"],
    "thigh": ["hip"],
    "shank": ["knee"],
    "foot": ["ankle", "foot"],
    "hand": ["wrist", *FINGERS],
}
SEGMENT_JOINTS = {
    "pelvis": ("pelvis",),
    "abdomen": ("spine1",),
    "thorax": ("spine2", "spine3"),
    "neck": ("neck",),
    "head": ("head", "jaw", "left_eye", "right_eye"),
    **{f"{s}_{segment}": tuple(f"{s}_{j}" for j in joints) for s in SIDES for segment, joints in LIMB_JOINTS.items()},
}
"""Segment -> its joints; it turns about the first one."""
OF_FINGERS = {"finger3-3": "middle3", "finger2-1": "index1", "finger5-1": "pinky1"}
LANDMARKS = {
    "eye.L": "left_eye",
    "eye.R": "right_eye",
    "head": "head",
    **{f"{ours}.{s[0].upper()}": f"{s}_{theirs}" for s in SIDES for ours, theirs in OF_FINGERS.items()},
}
TO_MESH = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""Rotation from SMPL-X's axes, with y up and the person facing +z, to the mesh frame."""
DENSITY_KG_M3 = 980.0
"""Density that gives a body's mass if none is given; the shipped bodies have their mass by the same density, from
Anny."""
SUPINATION_DEG = 50.0
"""Supination to which the file's palms, which face down, are turned before anything else. The turn is spread evenly
along the forearm, as in real skin: turning a rigid forearm so far would twist the skin at the elbow."""
LICENCE = "the user's own file; SMPL-X model licence"

REQUIRED = {
    "v_template": ("V", 3),
    "f": ("F", 3),
    "weights": ("V", len(JOINTS)),
    "J_regressor": (len(JOINTS), "V"),
    "kintree_table": (2, len(JOINTS)),
}
OPTIONS = "sex=F or sex=M (required), age=adult or age=old, mass=KG, betas=B1,B2,..."


def smplx_path(name: str) -> Path:
    """Return the path of the file that ``smplx:FILE.npz?...`` names."""
    return Path(name.removeprefix(SMPLX_PREFIX).partition("?")[0])


def load_smplx(name: str) -> Body:
    """Load the body that ``smplx:FILE.npz?sex=F`` names. Raises ConfigError that names the file and its fault."""
    place = smplx_path(name)
    # Check the file before the options: if its name is misspelt, an error about options would mislead.
    arrays, digest = _arrays(place)
    sex, age, mass, betas = _options(name.partition("?")[2], name=name)
    joints = np.asarray(arrays["J_regressor"], np.float64)
    vertices = np.asarray(arrays["v_template"], np.float64)
    if betas:
        vertices = vertices + _shape(arrays, betas, place=place)
    centres = joints @ vertices @ TO_MESH.T
    vertices = vertices @ TO_MESH.T
    at = {joint: centres[k] for k, joint in enumerate(JOINTS)}
    segments = tuple(PARENT)
    dense = np.zeros((len(vertices), len(segments)))
    weights = np.asarray(arrays["weights"], np.float64)
    for k, joint in enumerate(JOINTS):
        segment = next(s for s, own in SEGMENT_JOINTS.items() if joint in own)
        dense[:, segments.index(segment)] += weights[:, k]
    order = np.argsort(-dense, axis=1)[:, :4]
    top = np.take_along_axis(dense, order, 1)
    faces = np.asarray(arrays["f"]).astype(np.int64)
    joint_centre = {s: at[own[0]] for s, own in SEGMENT_JOINTS.items()}
    joint_centre["pelvis"] = (at["left_hip"] + at["right_hip"]) / 2
    joint_centre["abdomen"] = at["spine1"]
    uv, uv_faces = _texture(arrays, vertices, faces)
    # In this projection, eyes and lids share one place of the texture, which the lids get.
    is_eye = np.isin(weights.argmax(1), [JOINTS.index(f"{s}_eye") for s in ("left", "right")]) & ("vt" in arrays)
    volume = _volume(vertices, faces)
    if not 0.01 < volume < 0.3:
        raise ConfigError(f"{place}: the surface encloses {volume:.3g} m^3, which is not a person's in metres")
    body = Body(
        name=name,
        sex=sex,
        age_group=age,
        mass_kg=mass or DENSITY_KG_M3 * volume,
        licence=LICENCE,
        vertices=vertices,
        faces=faces,
        uv=uv,
        uv_faces=uv_faces,
        segments=segments,
        joint_centre=joint_centre,
        weight_segment=order,
        weight=top / top.sum(1, keepdims=True),
        is_eye=is_eye,
        landmarks={ours: at[theirs] for ours, theirs in LANDMARKS.items()},
        meta={"source": "SMPL-X", "parameters": {"sex": sex, "age": age, "betas": betas}},
        sha256=digest,
    )
    for side in ("left", "right"):
        body = _palm_up(body, side, dense)
    return body


def _options(query: str, *, name: str) -> tuple[Sex, AgeGroup, float | None, list[float]]:
    given = dict(parse_qsl(query, keep_blank_values=True))
    unknown = sorted(set(given) - {"sex", "age", "mass", "betas"})
    if unknown:
        raise ConfigError(f"{name}: no option {', '.join(unknown)}; valid: {OPTIONS}")
    sex, age = given.get("sex"), given.get("age", "adult")
    if sex not in ("F", "M"):
        raise ConfigError(f"{name}: segment masses depend on the sex, add ?sex=F or ?sex=M; valid: {OPTIONS}")
    if age not in ("adult", "old"):
        raise ConfigError(f"{name}: age {age!r} is neither adult nor old; valid: {OPTIONS}")
    try:
        mass = float(given["mass"]) if "mass" in given else None
        betas = [float(b) for b in given["betas"].split(",")] if "betas" in given else []
    except ValueError as error:
        raise ConfigError(f"{name}: {error}; valid: {OPTIONS}") from None
    if not np.isfinite([*betas, mass or 1.0]).all() or (mass is not None and not 20 < mass < 300):
        raise ConfigError(f"{name}: mass must be 20 to 300 kg and betas finite; valid: {OPTIONS}")
    return sex, age, mass, betas


def _arrays(path: Path) -> tuple[dict[str, npt.NDArray[Any]], str]:
    """Return the needed arrays after checking them, and the file's sha256."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"SMPL-X file {path}: {error.strerror}; expected smplx:FILE.npz?sex=F") from None
    if not zipfile.is_zipfile(io.BytesIO(data)):
        raise ConfigError(f"{path}: not an npz archive; expected SMPLX_*.npz as it was downloaded")
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            wanted = [k for k in (*REQUIRED, "shapedirs", "vt", "ft") if k in archive.files]
            arrays = {k: archive[k] for k in wanted}
    except (ValueError, zipfile.BadZipFile, EOFError, AttributeError, OSError) as error:
        raise ConfigError(f"{path}: not an npz of plain arrays ({error}); expected SMPLX_*.npz") from None
    missing = [k for k in REQUIRED if k not in arrays]
    if missing:
        raise ConfigError(f"{path}: lacks {', '.join(missing)}; an SMPL-X npz has {', '.join(REQUIRED)}")
    count = {"V": arrays["v_template"].shape[:1] or (0,), "F": arrays["f"].shape[:1] or (0,)}
    for key, shape in REQUIRED.items():
        expected = tuple(count[n][0] if isinstance(n, str) else n for n in shape)
        if arrays[key].shape != expected:
            joints = f" for the {len(JOINTS)} joints of SMPL-X" if len(JOINTS) in shape else ""
            raise ConfigError(f"{path}: {key} has shape {arrays[key].shape}, expected {expected}{joints}")
        if arrays[key].dtype.kind not in "fiu" or not np.isfinite(arrays[key]).all():
            raise ConfigError(f"{path}: {key} holds something other than finite numbers")
    faces = arrays["f"].astype(np.int64)
    if len(faces) == 0 or faces.min() < 0 or faces.max() >= count["V"][0]:
        raise ConfigError(f"{path}: f must name vertices 0 to {count['V'][0] - 1}")
    _check_tree(arrays["kintree_table"], path)
    return arrays, hashlib.sha256(data).hexdigest()


def _check_tree(table: npt.NDArray[Any], path: Path) -> None:
    """Check the parents of some joints, because this module identifies joints by their order alone."""
    expected = {"left_elbow": "left_shoulder", "right_wrist": "right_elbow", "jaw": "head", "spine3": "spine2"}
    expected |= {"left_middle1": "left_wrist", "right_pinky3": "right_pinky2", "left_foot": "left_ankle"}
    for child, parent in expected.items():
        if int(table[0, JOINTS.index(child)]) != JOINTS.index(parent):
            raise ConfigError(
                f"{path}: kintree_table does not make {parent} the parent of {child}; expected the joints of SMPL-X"
            )


def _shape(arrays: dict[str, npt.NDArray[Any]], betas: list[float], *, place: Path) -> Array:
    """Return the offsets (V, 3) [m] of the vertices for shape coefficients."""
    directions = arrays.get("shapedirs")
    vertices = len(arrays["v_template"])
    if directions is None or directions.ndim != 3 or directions.shape[:2] != (vertices, 3):
        raise ConfigError(f"{place}: betas need shapedirs of shape ({vertices}, 3, n)")
    if len(betas) > directions.shape[2]:
        raise ConfigError(f"{place}: {len(betas)} betas, but shapedirs has {directions.shape[2]}")
    return np.asarray(directions[..., : len(betas)], np.float64) @ np.array(betas)


def _palm_up(body: Body, side: Literal["left", "right"], dense: Array) -> Body:
    """Turn a forearm about its long axis, by nothing at the elbow and by the full angle at the wrist and the hand.

    ``dense``: (V, S) skin weights.
    """
    fore, hand = f"{side}_forearm", f"{side}_hand"
    sign, along = (1.0, -1.0)[side == "right"], body.direction(fore)
    palm, _ = hand_axes(body, side)
    now = supination_of(palm, elbow_axis(body.direction(f"{side}_upper_arm"), along), along, sign)
    angle = np.radians(SUPINATION_DEG - now)
    elbow, length = body.joint_centre[fore], float(np.linalg.norm(body.axis_vector(fore)))
    axis = -sign * along

    def turned(points: Array, weight: Array) -> Array:
        off = points - elbow
        share = (np.clip(off @ along / length, 0.0, 1.0) * weight * angle)[:, None]
        parallel = np.outer(off @ axis, axis)
        across = off - parallel
        return elbow + parallel + np.cos(share) * across + np.sin(share) * np.cross(axis, across)

    carried = dense[:, [body.segments.index(fore), body.segments.index(hand)]].sum(1)
    own = [name for name in body.landmarks if name.startswith("finger") and name.endswith(side[0].upper())]
    fingers = {name: turned(body.landmarks[name][None], np.ones(1))[0] for name in own}
    return replace(body, vertices=turned(body.vertices, carried), landmarks=body.landmarks | fingers)


def _texture(
    arrays: dict[str, npt.NDArray[Any]], vertices: Array, faces: npt.NDArray[np.int64]
) -> tuple[Array, npt.NDArray[np.int64]]:
    """Return the file's texture coordinates; if it has none, project front and back side by side."""
    vt, ft = arrays.get("vt"), arrays.get("ft")
    if vt is not None and ft is not None and vt.ndim == 2 and ft.shape == faces.shape and int(ft.max()) < len(vt):
        return np.clip(np.asarray(vt[:, :2], np.float64), 0.0, 1.0), ft.astype(np.int64)
    low, size = vertices.min(0), np.ptp(vertices, axis=0)
    flat = (vertices - low)[:, [0, 2]] / size[[0, 2]] * 0.98 + 0.01
    uv = np.concatenate([flat * [0.5, 1.0], flat * [0.5, 1.0] + [0.5, 0.0]])
    a, b, c = vertices[faces].transpose(1, 0, 2)
    back = np.cross(b - a, c - a)[:, 1] > 0
    return uv, faces + np.where(back, len(vertices), 0)[:, None]


def _volume(vertices: Array, faces: npt.NDArray[np.int64]) -> float:
    corner = vertices[faces]
    return abs(float(np.einsum("ij,ij->i", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])).sum())) / 6


def body_names() -> list[str]:
    folder = body_folder()
    return sorted(p.name.removesuffix(".npz") for p in folder.iterdir() if p.name.endswith(".npz"))


def load_body(name: str) -> Body:
    """Load a shipped body by its name, or a user's own SMPL-X file as ``smplx:FILE.npz?sex=F``.

    Raises UnknownNameError for any other name, AssetError for a shipped archive without the hash of its provenance
    file, and ConfigError for an SMPL-X file that cannot be used.
    """
    if name.startswith(SMPLX_PREFIX):
        return load_smplx(name)
    if name not in body_names():
        raise UnknownNameError("body", name, [*body_names(), f"{SMPLX_PREFIX}FILE.npz?sex=F (your own)"])
    data = body_file(f"{name}.npz")
    digest = hashlib.sha256(data).hexdigest()
    try:
        expected = json.loads(body_file(f"{name}.provenance.json"))["sha256"]
    except OSError as error:
        raise AssetError(f"body {name}: {error}; reinstall the package or run tools/bake_body.py") from None
    if digest != expected:
        raise AssetError(f"body {name}.npz has sha256 {digest[:12]}..., its provenance file says {expected[:12]}...")
    with np.load(io.BytesIO(data)) as z:
        arrays = {k: z[k] for k in z.files}
    segments, weight = tuple(map(str, arrays["segments"])), arrays["weight"].astype(np.float64)
    centres = dict(zip(segments, arrays["joint_centres_m"].astype(np.float64), strict=True))
    landmarks = zip(map(str, arrays["landmark_names"]), arrays["landmarks_m"].astype(np.float64), strict=True)
    # The rig's root and its first spine bone share one point. The pelvis turns about the hips, the trunk about L5/S1.
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
        landmarks=dict(landmarks),
        meta=meta,
        sha256=digest,
    )
