"""What moves the person from within: slides of the trunk that breathe, and muscles of the right arm."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.human.body import Array, Body
from carecontact.human.hulls import SIDEWAYS, girdle
from carecontact.human.shell import belly_half_width, belly_span
from carecontact.human.skeleton import body_name
from carecontact.tissue.life import JOINTS, PARTS

# Slide joints on the trunk move the wall of the abdomen and the front of the chest, and the visible skin with them.
# The abdomen's soft region moves outward as a whole, and the core under it stays. The skin moves with the region;
# around the region its movement fades to zero at the trunk's sides. The slide of the chest carries the chest's plates.

SEGMENT = {"abdomen": "abdomen", "chest": "thorax"}
"""Part -> the segment that carries its slide."""
FRONT = (0.0, -1.0, 0.0)
"""Direction of the slides in the mesh frame, which is also that of the segments in the bind pose."""
STIFFNESS_N_M = 1e5
"""Stiffness of the servo that moves a part: a press of 20 N moves it back by 0.2 mm, while the abdomen's tissue gives
way by 40 mm."""
INERTIA_KG = 2.0
"""Inertia of the moving wall (assumed). It is an armature of the joint, so that the segments keep their masses."""
MASS_KG = 1e-3
"""Mass of a slide's body, because MuJoCo requires one."""
STILL = ("neck", "head", *(f"{side}_{part}" for side in SIDEWAYS for part in ("upper_arm", "forearm", "hand")))
"""Segments beside the chest whose skin does not breathe."""
WHOLE_FROM = 2 / 3
"""Weight of the other segments from which on skin makes the whole of a movement. The chest's plates are made of skin
with more than half, so that theirs is at most 0.8 mm short of 5 mm; with 1/2, the armpit's fold is half as steep
again."""
TAPER_M = 0.06
"""Width of the rim in which the skin's movement fades, both along the trunk and across it."""
SEAM_M = 0.03
"""Width of the strip over the lower border of the chest in which the skin goes over from the abdomen's movement to the
chest's, if the whole of both has its full movement."""
MARGIN_M = 0.015
"""How far the visible skin makes all of a breath's movement beyond the abdomen's soft region and beyond what the
chest's plates carry."""
SIDE_M = 0.03
"""Width of the zone in which it fades from the plane of the spine forward."""


def add_slide(segment: str, bone: mujoco.MjsBody) -> mujoco.MjsBody:
    """Return the body that carries the front of a segment: a new slide on its bone, or the bone itself."""
    name = carrier(segment, breathes=True)
    if name == body_name(segment):
        return bone
    made = bone.add_body(name=name, explicitinertial=True, mass=MASS_KG, inertia=np.full(3, MASS_KG * 0.01))
    made.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=FRONT, armature=INERTIA_KG)
    return made


def add_servos(spec: mujoco.MjSpec) -> None:
    """Add the servos of the slides. Call it after the skeleton."""
    for part in PARTS:
        servo = _actuator(spec, f"breathes_{part}", breath_body(part), affine_bias=True)
        servo.gainprm[0] = STIFFNESS_N_M
        servo.biasprm[:3] = [0.0, -STIFFNESS_N_M, -2.0 * np.sqrt(STIFFNESS_N_M * INERTIA_KG)]


def _actuator(
    spec: mujoco.MjSpec, name: str, joint: str, *, affine_gain: bool = False, affine_bias: bool = False
) -> mujoco.MjsActuator:
    gain = mujoco.mjtGain.mjGAIN_AFFINE if affine_gain else mujoco.mjtGain.mjGAIN_FIXED
    bias = mujoco.mjtBias.mjBIAS_AFFINE if affine_bias else mujoco.mjtBias.mjBIAS_NONE
    return spec.add_actuator(name=name, trntype=mujoco.mjtTrn.mjTRN_JOINT, target=joint, gaintype=gain, biastype=bias)


def breath_body(part: str) -> str:
    return f"human_breath_{part}"


def carrier(segment: str, *, breathes: bool) -> str:
    """Return the name of the body that carries the front of a segment."""
    parts = [part for part, owner in SEGMENT.items() if breathes and owner == segment]
    return breath_body(parts[0]) if parts else body_name(segment)


def move_skin(spec: mujoco.MjSpec, body: Body) -> None:
    """Let the slides move the visible skin. Call it after the skin, with the body that the skin was made from.

    Whatever weight a vertex gets from a slide is subtracted from its weight on the segment under the slide, also below
    zero. The slide then adds exactly its own movement to that of the vertex's segments.
    """
    skin = spec.skin("human")
    points = np.asarray(skin.vert, np.float64).reshape(-1, 3)
    names, ids, weights = list(skin.bodyname), list(skin.vertid), list(skin.vertweight)
    bindpos, bindquat = list(skin.bindpos), list(skin.bindquat)
    of_trunk = 1 - _weight(skin, STILL)
    for part, share in shares(body, points).items():
        share = share * _rise(of_trunk / WHOLE_FROM)
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


def _weight(skin: mujoco.MjsSkin, segments: tuple[str, ...]) -> Array:
    """Return the weight (n,) with which the vertices of a skin move with some segments."""
    weight = np.zeros(len(skin.vert) // 3)
    for name, rows, shares in zip(skin.bodyname, skin.vertid, skin.vertweight, strict=True):
        if name in map(body_name, segments):
            weight[np.asarray(rows)] += shares
    return weight


def shares(body: Body, points: npt.ArrayLike) -> dict[str, Array]:
    """Return, for each part, the share (n,) of its movement that points (n, 3) of the skin make, in the mesh frame.

    The shares are whole as far as MARGIN_M beyond the abdomen's soft region, and beyond what the plates of the chest
    carry of the front. Between the two, the skin goes over from one movement to the other on the lowest strip of the
    chest.
    """
    points = np.asarray(points, np.float64)
    low, high = belly_span(body)
    ahead = _rise((body.joint_centre["thorax"][1] - points[:, 1]) / SIDE_M)
    above = _rise((points[:, 2] - high - MARGIN_M) / SEAM_M)
    beside = np.abs(points[:, 0]) - belly_half_width(body) - MARGIN_M
    under = low - MARGIN_M - points[:, 2]
    belly = (1 - above) * _rise(1 - beside / TAPER_M) * _rise(1 - under / TAPER_M)
    over_girdle = np.max([girdle(body, side).height_m(points) for side in SIDEWAYS], axis=0) - MARGIN_M
    chest = above * _rise(1 - over_girdle / TAPER_M)
    return {"abdomen": ahead * belly, "chest": ahead * chest}


def _rise(x: Array) -> Array:
    """Return a smooth step from 0 to 1 for x from 0 to 1, with zero slope at both ends."""
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3 - 2 * x)


# For protocols in which the right arm moves on its own, each of its joints has two actuators: one holds the joint with
# stiffness and damping in proportion to an activation (its command), the other adds a torque. Together they are a servo
# whose set point, stiffness and damping can change.


class Muscle(NamedTuple):
    stiffness_nm_rad: float
    """Stiffness at full activation."""
    damping_nms_rad: float


MUSCLES = dict(
    zip(JOINTS, (Muscle(200.0, 15.0), Muscle(100.0, 10.0), Muscle(15.0, 1.0), Muscle(30.0, 2.5)), strict=True)
)
"""Joint -> its muscles. The values are assumed: the arm arrives within some millimetres of its goal and is about
critically damped."""


def add_muscles(spec: mujoco.MjSpec) -> None:
    """Add the actuators of every muscle. Call it after the skeleton."""
    for joint, muscle in MUSCLES.items():
        holds = _actuator(spec, f"holds_{joint}", f"human_{joint}", affine_gain=True)
        holds.gainprm[:3] = [0.0, -muscle.stiffness_nm_rad, -muscle.damping_nms_rad]
        _actuator(spec, f"turns_{joint}", f"human_{joint}").gainprm[0] = 1.0
