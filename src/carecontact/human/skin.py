"""The visible skin with its texture, and the drawn appearance of a person: skin, clothes and hair. It has no
contact."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.cache import Arrays, cached, source_sha256
from carecontact.errors import AssetError
from carecontact.human.body import Array, Body
from carecontact.human.library import body_file, body_names
from carecontact.human.mesh import refined
from carecontact.human.skeleton import body_name
from carecontact.pictures import decoded

TEXTURE_SIZE = 1024
WAVES = 16
OUTLINE_TEXELS = 1.0
FACES_AT_ONCE = 20_000


@dataclass(frozen=True, kw_only=True)
class Appearance:
    skin: tuple[int, int, int] = (214, 164, 134)
    cloth: tuple[int, int, int] = (44, 74, 116)
    hair: tuple[int, int, int] = (62, 43, 30)


GREY = (168, 164, 158)


def baked_texture(name: str) -> npt.NDArray[np.uint8]:
    """Return a shipped body's texture (TEXTURE_SIZE, TEXTURE_SIZE, 3). Raises AssetError if it is not there."""
    file = f"{name}.skin.png"
    try:
        image = decoded(body_file(file))
    except OSError as error:
        raise AssetError(f"skin of body {name}: {error}; reinstall the package or run tools/bake_skin.py") from None
    if image.shape != (TEXTURE_SIZE, TEXTURE_SIZE, 3):
        raise AssetError(f"skin of body {name}: {file} is not a {TEXTURE_SIZE} x {TEXTURE_SIZE} colour PNG")
    return image


def texture_of(body: Body) -> npt.NDArray[np.uint8]:
    """Return a shipped body's own texture; for any other body, paint one in the colours of its age group."""
    if body.name in body_names():
        return baked_texture(body.name)
    return paint(body, Appearance(hair=GREY) if body.age_group == "old" else Appearance())


def add_skin(spec: mujoco.MjSpec, body: Body) -> None:
    """Add one skin over all segments; a vertex with two points of the texture becomes two."""
    pairs = np.stack([body.faces.ravel(), body.uv_faces.ravel()], 1)
    unique, inverse = np.unique(pairs, axis=0, return_inverse=True)
    vertex = unique[:, 0]
    coordinates = body.uv[unique[:, 1]].copy()
    coordinates[:, 1] = 1 - coordinates[:, 1]
    ids, weights = [], []
    for index in range(len(body.segments)):
        mine = (body.weight_segment[vertex] == index) & (body.weight[vertex] > 1e-3)
        rows = np.flatnonzero(mine.any(1))
        ids.append(rows.astype(np.int32))
        weights.append(np.where(mine[rows], body.weight[vertex[rows]], 0).sum(1).astype(np.float32))
    texture = texture_of(body)
    made = spec.add_texture(
        name="human_skin", type=mujoco.mjtTexture.mjTEXTURE_2D, width=TEXTURE_SIZE, height=TEXTURE_SIZE, nchannel=3
    )
    made.data = texture.tobytes()
    material = spec.add_material(name="human_skin", specular=0.12, shininess=0.15)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "human_skin"
    spec.add_skin(
        name="human",
        vert=body.vertices[vertex].ravel().astype(np.float32),
        texcoord=coordinates.ravel().astype(np.float32),
        face=inverse.reshape(-1).astype(np.int32),
        bodyname=[body_name(s) for s in body.segments],
        bindpos=np.array([body.joint_centre[s] for s in body.segments]).ravel().astype(np.float32),
        bindquat=np.tile([1, 0, 0, 0], len(body.segments)).astype(np.float32),
        vertid=ids,
        vertweight=weights,
        group=0,
        rgba=[1, 1, 1, 1],
        material="human_skin",
    )


def paint(body: Body, appearance: Appearance) -> npt.NDArray[np.uint8]:
    """Return a texture (TEXTURE_SIZE, TEXTURE_SIZE, 3) in which each face has the colour of its place on the body."""
    return coloured(painters(body), body, appearance)


def painters(body: Body) -> npt.NDArray[np.int32]:
    """Return which face covers each texel (TEXTURE_SIZE, TEXTURE_SIZE), counted from 1; 0 where none does."""
    corners = body.uv[body.uv_faces] * TEXTURE_SIZE
    corners[..., 1] = TEXTURE_SIZE - corners[..., 1]
    image = np.zeros((TEXTURE_SIZE, TEXTURE_SIZE), np.int32)
    # A face first covers the texels beside its outline: texture filtering would show the hairline between two faces.
    for reach in (OUTLINE_TEXELS, 0.0):
        for start in range(0, len(corners), FACES_AT_ONCE):
            face, x, y = _covered(corners[start : start + FACES_AT_ONCE], reach)
            image[y, x] = 1 + start + face
    return image


def _covered(corners: Array, reach: float) -> tuple[npt.NDArray[np.int64], ...]:
    """Return the pairs of triangles (N, 3, 2) and texels whose middles lie within them or at most so far outside."""
    low = np.clip(np.floor(corners.min(1) - reach), 0, TEXTURE_SIZE - 1).astype(int)
    size = np.clip(np.ceil(corners.max(1) + reach), 1, TEXTURE_SIZE).astype(int) - low
    count = size.prod(1)
    face = np.repeat(np.arange(len(corners)), count)
    number = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
    x, y = low[face, 0] + number % size[face, 0], low[face, 1] + number // size[face, 0]
    side = np.roll(corners, -1, axis=1) - corners
    area = side[:, 0, 0] * side[:, 1, 1] - side[:, 0, 1] * side[:, 1, 0]
    inward = np.stack([-side[..., 1], side[..., 0]], -1) * np.sign(area)[:, None, None]
    inward /= np.maximum(np.linalg.norm(inward, axis=-1, keepdims=True), 1e-12)
    near = np.ones(len(face), bool)
    for corner in range(3):
        from_corner = np.stack([x + 0.5, y + 0.5], -1) - corners[face, corner]
        near &= (from_corner * inward[face, corner]).sum(-1) >= -reach
    return face[near], x[near], y[near]


def coloured(painters: npt.NDArray[np.int32], body: Body, appearance: Appearance) -> npt.NDArray[np.uint8]:
    """Return the texture of a body whose faces cover the texels as ``painters`` says."""
    colours = np.clip(np.vstack([appearance.skin, _face_colours(body, appearance)]), 0, 255)
    image = np.pad(np.rint(colours).astype(np.uint16)[painters], ((1, 1), (1, 1), (0, 0)), "reflect")
    image = image[:-2] + 2 * image[1:-1] + image[2:]
    return ((image[:, :-2] + 2 * image[:, 1:-1] + image[:, 2:] + 8) >> 4).astype(np.uint8)


def _face_colours(body: Body, appearance: Appearance) -> Array:
    skin, cloth, hair = (np.array(c, np.float64) for c in (appearance.skin, appearance.cloth, appearance.hair))
    centre = body.vertices[body.faces].mean(1)
    owner = body.owner[body.faces[:, 0]]

    def of(*segments: str) -> npt.NDArray[np.bool_]:
        """Return which faces belong to these segments."""
        return np.isin(body.segments, segments)[owner]

    # Mottling of low spatial frequency: with one flat tone, key-point detectors fail. Few waves would show as stripes.
    waves, phases = np.split(np.random.default_rng(0).normal(0, 35, (WAVES, 4)), [3], axis=1)
    mottle = np.sin(centre @ waves.T + phases.T).sum(1) / (2 * np.sqrt(WAVES))
    colour = skin * (1 + 0.045 * mottle)[:, None]
    colour[of("left_hand", "right_hand", "left_foot", "right_foot")] *= [1.0, 0.94, 0.92]

    thigh = body.joint_centre["left_thigh"][2]
    legs = of("pelvis", "abdomen", "thorax", "left_thigh", "right_thigh")
    shorts = legs & (centre[:, 2] > thigh - 0.17) & (centre[:, 2] < thigh + 0.035)
    fold = 1 + 0.10 * np.sin(centre @ [70.0, 25, 12])
    colour[shorts] = cloth * fold[shorts, None]
    waistband = legs & (centre[:, 2] > thigh + 0.018) & (centre[:, 2] < thigh + 0.035)
    colour[waistband] = cloth * 0.6

    if body.sex == "F":
        chest = body.vertices_of("thorax", "left_clavicle", "right_clavicle")
        below_shoulder = chest[chest[:, 2] < body.joint_centre["right_upper_arm"][2] - 0.07]
        upper = below_shoulder[below_shoulder[:, 2] > body.joint_centre["right_upper_arm"][2] - 0.20]
        bust = upper[upper[:, 1].argmin(), 2]
        trunk = of("thorax", "left_clavicle", "right_clavicle")
        top = trunk & (np.abs(centre[:, 2] - bust + 0.005) < 0.075)
        colour[top] = cloth * fold[top, None]

    _paint_head(body, centre, of("head"), colour, skin, hair, mottle)
    return colour


def _paint_head(
    body: Body, centre: Array, head: npt.NDArray[np.bool_], colour: Array, skin: Array, hair: Array, mottle: Array
) -> None:
    eyes = [body.landmarks["eye.L"], body.landmarks["eye.R"]]
    eye_height, face_front = eyes[0][2], body.vertices_of("head")[:, 1].min()
    behind = centre[:, 1] > body.joint_centre["head"][1] + 0.03
    ear = head & (np.abs(centre[:, 0]) > 0.078) & (centre[:, 2] < eye_height + 0.02)
    slope = 0.25 * np.clip(eyes[0][1] - centre[:, 1], -1, 1)
    scalp = head & ~ear & ((centre[:, 2] > eye_height + 0.065 + slope) | (behind & (centre[:, 2] > eye_height - 0.05)))
    colour[scalp] = hair * (1 + 0.35 * mottle[scalp, None])
    mouth = eye_height - 0.074
    lips = (
        head
        & (np.abs(centre[:, 0]) < 0.026)
        & (np.abs(centre[:, 2] - mouth) < 0.008)
        & (centre[:, 1] < face_front + 0.04)
    )
    colour[lips] = skin * [0.82, 0.55, 0.55]
    ball = body.is_eye[body.faces[:, 0]]
    for eye in eyes:
        off = centre - eye
        brow = (
            head
            & (np.abs(off[:, 0]) < 0.019)
            & (np.abs(off[:, 2] - 0.022 + 0.1 * np.abs(off[:, 0])) < 0.0035)
            & (off[:, 1] < 0)
        )
        colour[brow] = 0.6 * hair + 0.4 * skin
        white = ball & (np.abs(off[:, 0]) < 0.02)
        colour[white] = (238, 236, 232)
        if white.any():
            r = np.hypot(*(centre - centre[white].mean(0))[:, [0, 2]].T)
            front = white & (off[:, 1] < centre[white][:, 1].mean() - eye[1])
            colour[front & (r < 0.0065)] = (74, 52, 32)
            colour[front & (r < 0.003)] = (12, 12, 12)


Rgb = tuple[int, int, int]

SKIN_TONES: dict[str, Rgb] = {
    "very light": (236, 200, 180), "light": (220, 174, 146), "intermediate": (196, 146, 116),
    "tan": (166, 116, 86), "brown": (124, 84, 62), "dark": (84, 58, 47),
}  # fmt: skip
"""Skin tones from light to dark, as sRGB under the default light. The steps are ours; there are as many as Fitzpatrick
(1988) has types."""
CLOTHES: dict[str, Rgb] = {
    "navy": (44, 74, 116), "olive": (72, 84, 60), "wine": (122, 48, 62), "teal": (40, 90, 96),
    "violet": (92, 58, 92), "charcoal": (60, 60, 68), "sand": (186, 164, 128), "white": (214, 216, 218),
}  # fmt: skip
HAIR: dict[str, Rgb] = {
    "black": (26, 20, 19), "dark brown": (62, 43, 30), "brown": (84, 54, 32), "blond": (176, 140, 88),
    "grey": (168, 164, 158), "white": (206, 204, 200),
}  # fmt: skip

_LIMBS = (f"{side}_{part}" for side in ("left", "right") for part in ("clavicle", "upper_arm", "forearm", "shank"))
SPLITS = {3: ("pelvis", "abdomen", "left_thigh", "right_thigh"), 1: ("head",), 2: ("thorax", *_LIMBS)}
"""How often triangles are split before painting -> segments. An edge of clothes or a feature of the face crosses them,
and each has one tone of the skin's mottling, which shows as stripes where large triangles meet."""


def draw_appearance(rng: np.random.Generator) -> Appearance:
    """Draw skin tone, clothes and hair independently and uniformly. The order of the draws is part of ``varied-v1``."""
    skin, cloth, hair = (list(colours.values())[rng.integers(len(colours))] for colours in (SKIN_TONES, CLOTHES, HAIR))
    return Appearance(skin=skin, cloth=cloth, hair=hair)


def fine_paint(body: Body, appearance: Appearance) -> npt.NDArray[np.uint8]:
    """Paint a texture (TEXTURE_SIZE, TEXTURE_SIZE, 3) with full detail, like the shipped textures.

    Which fine face covers which texel does not depend on the appearance. It is kept, because it takes a second.
    """

    def compute() -> Arrays:
        fine = body
        for times, segments in SPLITS.items():
            fine = refined(fine, *segments, times=times)
        faces, owner = fine.faces.astype(np.int32), fine.owner.astype(np.int32)
        kept = {"vertices": fine.vertices, "faces": faces, "owner": owner, "is_eye": fine.is_eye}
        return kept | {"painters": painters(fine)}

    facts: dict[str, object] = {"body": [body.name, body.sha256], "splits": SPLITS}
    facts |= {"source": source_sha256(Path(__file__).parent), "numpy": np.__version__}
    found = cached("paint", facts, compute)
    owner = found["owner"].astype(np.int64)[:, None]
    faces, weight = found["faces"].astype(np.int64), np.ones(owner.shape)
    fine = replace(body, vertices=found["vertices"], faces=faces, weight_segment=owner, weight=weight)
    return coloured(found["painters"], replace(fine, is_eye=found["is_eye"]), appearance)


def set_appearance(model: mujoco.MjModel, body: Body, appearance: Appearance) -> None:
    """Replace the skin's texture in a compiled model; the physics is unchanged. Call it before the first image."""
    texture = model.texture("human_skin").id
    start = int(model.tex_adr[texture])
    painted = fine_paint(body, appearance)
    model.tex_data[start : start + painted.size] = painted.ravel()
