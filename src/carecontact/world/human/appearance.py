"""Appearance of the person: skin, clothes and hair are drawn by a seed and painted on the body's own texture."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.world.human.body import Body
from carecontact.world.human.refine import refined
from carecontact.world.human.skin import Appearance, coloured, painters
from carecontact.world.kept import Arrays, kept, source_sha256

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

SPLITS = {
    3: ("pelvis", "abdomen", "left_thigh", "right_thigh"), 1: ("head",),
    2: ("thorax", *(f"{side}_{part}" for side in ("left", "right")
                    for part in ("clavicle", "upper_arm", "forearm", "shank"))),
}  # fmt: skip
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
        return {
            "vertices": fine.vertices, "faces": fine.faces.astype(np.int32), "owner": fine.owner.astype(np.int32),
            "is_eye": fine.is_eye, "painters": painters(fine),
        }  # fmt: skip

    facts = {
        "body": [body.name, body.sha256], "splits": SPLITS, "source": source_sha256(Path(__file__).parent),
        "numpy": np.__version__, "cv2": cv2.__version__,
    }  # fmt: skip
    found = kept("paint", facts, compute)
    owner = found["owner"].astype(np.int64)[:, None]
    fine = replace(
        body, vertices=found["vertices"], faces=found["faces"].astype(np.int64), is_eye=found["is_eye"],
        weight_segment=owner, weight=np.ones(owner.shape),
    )  # fmt: skip
    return coloured(found["painters"], fine, appearance)


def wear(model: mujoco.MjModel, body: Body, appearance: Appearance) -> None:
    """Replace the skin's texture in a compiled model; the physics is unchanged. Call it before the first image."""
    texture = model.texture("human_skin").id
    start = int(model.tex_adr[texture])
    painted = fine_paint(body, appearance)
    model.tex_data[start : start + painted.size] = painted.ravel()
