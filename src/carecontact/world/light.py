"""Light of the room: a seed draws its strength, direction and colour, which are set in a compiled model."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

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


def shine(model: mujoco.MjModel, light: Light) -> None:
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
