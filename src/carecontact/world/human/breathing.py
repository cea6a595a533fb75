"""Breathing: the belly's wall and the front of the chest ride on slides of the trunk, and the visible skin with them.

The belly's soft region moves as a whole, straight out; the core under it stays. The skin moves with the region over all
of it, and around it less and less, down to nothing at the trunk's sides. The plates of the chest stand on its slide.
"""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.kernel.life import PARTS
from carecontact.world.human.body import Array, Body
from carecontact.world.human.shell import belly_half_width, belly_span
from carecontact.world.human.skeleton import body_name

SEGMENT = {"abdomen": "abdomen", "chest": "thorax"}
"""Part -> the segment on which its slide stands."""
FRONT = (0.0, -1.0, 0.0)
"""In the mesh frame, and so in that of the segments, which lie as in the bind pose."""
STIFFNESS_N_M = 1e5
"""Of the servo that moves a part: a press with 20 N pushes it back by 0.2 mm, where the belly's tissue gives way by 40
mm."""
INERTIA_KG = 2.0
"""Of the wall that is moved (assumed). It is an armature, so that the segments keep their masses."""
MASS_KG = 1e-3
"""Of a slide's body: MuJoCo wants one."""
TAPER_M = 0.06
"""Width of the rim in which the skin's movement fades, along the trunk and across it."""
SIDE_M = 0.03
"""The same from the plane of the spine forward."""


def add_slide(segment: str, bone: mujoco.MjsBody) -> mujoco.MjsBody:
    """Return what the front of a segment rides on: a new slide on its bone, or the bone where it does not breathe."""
    part = next((part for part, owner in SEGMENT.items() if owner == segment), None)
    if part is None:
        return bone
    name = breath_body(part)
    made = bone.add_body(name=name, explicitinertial=True, mass=MASS_KG, inertia=np.full(3, MASS_KG * 0.01))
    made.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=FRONT, armature=INERTIA_KG)
    return made


def add_servos(spec: mujoco.MjSpec) -> None:
    """Add what moves the slides. Call after the skeleton."""
    for part in PARTS:
        servo = spec.add_actuator(
            name=f"breathes_{part}", trntype=mujoco.mjtTrn.mjTRN_JOINT, target=breath_body(part),
            gaintype=mujoco.mjtGain.mjGAIN_FIXED, biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        )  # fmt: skip
        servo.gainprm[0] = STIFFNESS_N_M
        servo.biasprm[:3] = [0.0, -STIFFNESS_N_M, -2.0 * np.sqrt(STIFFNESS_N_M * INERTIA_KG)]


def breath_body(part: str) -> str:
    return f"human_breath_{part}"


def carrier(segment: str, *, breathes: bool) -> str:
    """Name of the body that the front of a segment rides on."""
    part = next((part for part, owner in SEGMENT.items() if owner == segment), None)
    return breath_body(part) if breathes and part is not None else body_name(segment)


def move_skin(spec: mujoco.MjSpec, body: Body) -> None:
    """Let the visible skin ride on the slides. Call after the skin, with the body that it was made from.

    What a vertex gets of a slide's weight, the segment under the slide loses, below zero where it had none: then all
    that the slide adds is its own movement, wherever the vertex's other segments are.
    """
    skin = spec.skin("human")
    points = np.asarray(skin.vert, np.float64).reshape(-1, 3)
    names, ids, weights = list(skin.bodyname), list(skin.vertid), list(skin.vertweight)
    bindpos, bindquat = list(skin.bindpos), list(skin.bindquat)
    for part, share in shares(body, points).items():
        rows, under = np.flatnonzero(share), names.index(body_name(SEGMENT[part]))
        lessened = np.zeros(len(points))
        lessened[np.asarray(ids[under])] = weights[under]
        lessened -= share
        ids[under] = np.flatnonzero(lessened).astype(np.int32)
        weights[under] = lessened[ids[under]].astype(np.float32)
        names.append(breath_body(part))
        ids.append(rows.astype(np.int32))
        weights.append(share[rows].astype(np.float32))
        bindpos += body.joint_centre[SEGMENT[part]].tolist()
        bindquat += [1.0, 0.0, 0.0, 0.0]
    skin.bodyname, skin.vertid, skin.vertweight = names, ids, weights
    skin.bindpos, skin.bindquat = np.array(bindpos, np.float32), np.array(bindquat, np.float32)


def shares(body: Body, points: npt.ArrayLike) -> dict[str, Array]:
    """Part -> (n,) share of its movement that each point (n, 3) of the skin makes, in the mesh frame."""
    x, y, z = np.asarray(points, np.float64).T
    low, high = belly_span(body)
    shoulder = body.joint_centre["left_upper_arm"]
    ahead = _rise((body.joint_centre["thorax"][1] - y) / SIDE_M)
    above = _rise((z - high) / TAPER_M)
    belly = (1 - above) * _rise((z - low) / TAPER_M + 1) * _rise(1 - (np.abs(x) - belly_half_width(body)) / TAPER_M)
    below_neck = _rise((shoulder[2] - z) / TAPER_M + 0.5)
    chest = above * below_neck * _rise(1 - (np.abs(x) - 0.6 * shoulder[0]) / TAPER_M)
    return {"abdomen": ahead * belly, "chest": ahead * chest}


def _rise(x: Array) -> Array:
    """From 0 to 1 while x does, without a corner at either end."""
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3 - 2 * x)
