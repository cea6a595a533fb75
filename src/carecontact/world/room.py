"""Bed, pillow, arm board, room and light; a seed draws the light's strength, direction and colour."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from carecontact.human.pose import BOARD_HEIGHT_M
from carecontact.protocol.sections import Scene

BED_TOUCH = {"contype": 0, "conaffinity": 3}
LOOK_ONLY = {"contype": 0, "conaffinity": 0}
BED_HALF_M = (1.0, 0.45)
"""Half length and half width of the mattress."""
PILLOW_HEIGHT_M = 0.045
SUPPORT = "bed_support"
"""Name of the body that rests on the bed and carries what is moved with the person: pillow and arm board."""
FURNITURE_GROUP = 0
"""Group of exactly the geoms of the empty cell. What a camera sees of them is part of the cell's calibration."""
LOOSE_GROUP = 2
"""Group of what lies about and is not in the cell's map."""
TOWEL, TOWEL_HALF_M = "bed_towel", 0.005
"""Name of the towel, and half of its thickness when it is folded (assumed)."""

PLANE, BOX, CYLINDER, ELLIPSOID = (
    getattr(mujoco.mjtGeom, f"mjGEOM_{kind}") for kind in ("PLANE", "BOX", "CYLINDER", "ELLIPSOID")
)


Vec = list[float]


def add_furniture(spec: mujoco.MjSpec, scene: Scene, *, head_x: float, head_y: float) -> None:
    world = spec.worldbody
    support = world.add_body(name=SUPPORT)
    top = scene.mattress_top_m
    linen, wood, steel = [0.80, 0.86, 0.90, 1], [0.62, 0.50, 0.38, 1], [0.42, 0.44, 0.48, 1]
    soft = {
        "solref": [0.02, 1.0],
        "solimp": [0.98, 0.99, 0.004, 0.5, 2.0],
        "friction": [0.8, 0.005, 0.0001],
        "condim": 3,
        "priority": 1,
    }

    def add(
        name: str, kind: mujoco.mjtGeom, size: Vec, pos: Vec, rgba: Vec, to: mujoco.MjsBody = world, **more: Any
    ) -> None:
        options = {"group": FURNITURE_GROUP, **LOOK_ONLY, **more}
        to.add_geom(name=name, type=kind, size=size, pos=pos, rgba=rgba, **options)

    add("floor", PLANE, [6, 6, 0.1], [0, 0, 0], [0.66, 0.63, 0.58, 1])
    add("wall", BOX, [0.05, 3.5, 1.4], [2.2, 0, 1.4], [0.86, 0.86, 0.82, 1])
    # One contact plane under everything keeps the number of contacts with the bed low, and with it the computing time.
    add("bed_mattress", BOX, [*BED_HALF_M, 0.08], [0, 0, top - 0.08], linen, **soft, **BED_TOUCH)
    add("bed_frame", BOX, [1.03, 0.47, 0.03], [0, 0, top - 0.19], steel)
    add("bed_head", BOX, [0.02, 0.47, 0.30], [1.05, 0, top + 0.02], wood)
    add("bed_foot", BOX, [0.02, 0.47, 0.16], [-1.05, 0, top - 0.08], wood)
    for a in (-0.95, 0.95):
        for b in (-0.40, 0.40):
            add(f"bed_leg_{a}_{b}", CYLINDER, [0.025, (top - 0.22) / 2, 0], [a, b, (top - 0.22) / 2], steel)
    x, y, white, unseen = head_x + 0.02, head_y, [0.95, 0.95, 0.93, 1], [0.0] * 4
    add("bed_pillow", ELLIPSOID, [0.16, 0.27, 0.045], [x, y, top + 0.012], white, support)
    contact = {"group": 3, **soft, **BED_TOUCH}
    half_m = PILLOW_HEIGHT_M / 2
    add("bed_pillow_contact", BOX, [0.12, 0.2, half_m], [x, y, top + half_m], unseen, support, **contact)
    low, high = np.array(scene.board_low_m), np.array(scene.board_high_m)
    middle, half = (low + high) / 2, (high - low) / 2
    board = {**soft, "friction": [scene.board_friction, 0.005, 0.0001], "priority": 2, **BED_TOUCH}
    half_m, blue = BOARD_HEIGHT_M / 2, [0.30, 0.46, 0.52, 1]
    add("bed_armboard", BOX, [*half, half_m], [*middle, top + half_m], blue, support, **board)
    add("bed_armboard_arm", BOX, [0.03, half[1] * 0.6, 0.015], [middle[0], middle[1], top - 0.015], steel, support)


def add_towel(spec: mujoco.MjSpec, half_m: tuple[float, float]) -> None:
    """Add a folded towel without contact; the seed says where it lies and in which colour."""
    size, rgba = [*half_m, TOWEL_HALF_M], [1.0] * 4
    # MuJoCo takes a geom that is compiled in its body's frame to stay there.
    at = {"pos": [-0.4, -0.3, 0.0], "quat": [0.9, 0.0, 0.0, 0.4]}
    spec.worldbody.add_geom(name=TOWEL, type=BOX, size=size, rgba=rgba, group=LOOSE_GROUP, **at, **LOOK_ONLY)


def add_light(spec: mujoco.MjSpec) -> None:
    """Add a soft headlight and directional lights without shadows, which cost more than the rest of an image."""
    light = spec.visual.headlight
    light.ambient, light.diffuse, light.specular = [0.30] * 3, [0.18] * 3, [0.0] * 3
    for position, direction, strength in (
        ([0.4, 0.8, 2.8], [-0.2, -0.35, -1], 0.50),
        ([-1.0, -1.2, 2.6], [0.4, 0.5, -1], 0.22),
    ):
        lamp = {"pos": position, "dir": direction, "diffuse": [strength] * 3, "specular": [0.08] * 3}
        spec.worldbody.add_light(type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, castshadow=False, **lamp)
    sky, gradient = mujoco.mjtTexture.mjTEXTURE_SKYBOX, mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    colours = {"rgb1": [0.93, 0.93, 0.90], "rgb2": [0.74, 0.75, 0.74]}
    spec.add_texture(name="room", type=sky, builtin=gradient, width=128, height=768, **colours)
    spec.visual.map.znear, spec.visual.map.zfar = 0.01, 8.0
    spec.visual.quality.offsamples = 0
    spec.visual.quality.shadowsize = 0
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 1280, 960


STRENGTH = (0.65, 1.35)
"""Range of the factor on every lamp and on the ambient light."""
TURN_DEG = (-180.0, 180.0)
TILT_DEG = (0.0, 25.0)
"""Ranges of the main lamp's direction: a turn about the vertical, and a tilt away from the default direction."""
WARMTH = (-1.0, 1.0)
WARM_GAIN = np.array([0.10, 0.0, -0.16])
"""Change of red, green and blue at full warmth: about 3000 K at 1 and 8000 K at -1 under a camera balanced for 5000 K;
rounded, assumed."""


@dataclass(frozen=True, kw_only=True)
class Light:
    strength: float = 1.0
    turn_deg: float = 0.0
    tilt_deg: float = 0.0
    warmth: float = 0.0


def draw_light(rng: np.random.Generator) -> Light:
    """Draw a light uniformly from its ranges; the order of the draws is part of ``varied-v1``."""
    strength, turn, tilt, warmth = (float(rng.uniform(*span)) for span in (STRENGTH, TURN_DEG, TILT_DEG, WARMTH))
    return Light(strength=strength, turn_deg=turn, tilt_deg=tilt, warmth=warmth)


def set_light(model: mujoco.MjModel, light: Light) -> None:
    """Set the lamps of a compiled model. Call it once; depth images and physics do not change."""
    gain = light.strength * (1 + light.warmth * WARM_GAIN)
    model.light_diffuse[:] *= gain
    model.light_specular[:] *= gain
    head = model.vis.headlight
    head.ambient, head.diffuse = head.ambient * gain, head.diffuse * gain
    main = model.light_dir[0]
    tilted = _turn(main, np.cross(main, [0.0, 0.0, 1.0]), np.radians(light.tilt_deg))
    model.light_dir[0] = _turn(tilted, np.array([0.0, 0.0, 1.0]), np.radians(light.turn_deg))


def _turn(vector: np.ndarray, axis: np.ndarray, angle: float) -> np.ndarray:
    quat, out = np.zeros(4), np.zeros(3)
    mujoco.mju_axisAngle2Quat(quat, axis / np.linalg.norm(axis), angle)
    mujoco.mju_rotVecQuat(out, np.asarray(vector, np.float64), quat)
    return out
