"""The person's hinges: axis, range of motion, passive stiffness and damping.

The ranges depend on the body's age group, see ``RANGE_DEG``. Angles are anatomical: zero is the anatomical position
with the forearm in neutral rotation, so ``qpos`` reads as in a clinic. Order in a segment is the order of rotation,
outermost first: shoulder abduction, flexion, rotation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from carecontact.human.body import DE_LEVA, AgeGroup, Array, Body

ASSUMED = "assumed"


@dataclass(frozen=True, kw_only=True)
class Hinge:
    name: str
    segment: str
    axis: Array
    """(3,) in the mesh frame, bind pose"""
    bind_deg: float
    """Anatomical angle of the bind pose."""
    range_deg: tuple[float, float]
    stiffness_nm_rad: float
    damping_nms_rad: float
    range_source: str
    source: str
    """Source of stiffness and damping."""
    neutral_deg: float | None = None
    """Angle at which the relaxed joint rests. None: no published value holds in the lying pose, so that the joint rests
    where the person is laid."""


AAOS = "American Academy of Orthopaedic Surgeons 1965, Joint Motion, adult means"
LEGS = "Merck Manual, Normal values for range of motion of joints (2013); adduction assumed"
AGED = "Walker et al. 1984, Phys Ther 64:919, healthy men and women of 60 to 84 years, means"
RANGE_DEG: dict[str, dict[AgeGroup, tuple[float, float]]] = {
    "upper_arm_abduction": {"adult": (0, 180), "old": (0, 165)},
    "upper_arm_flexion": {"adult": (-60, 180), "old": (-44, 165)},
    "upper_arm_rotation": {"adult": (-90, 70), "old": (-81, 62)},
    "forearm_flexion": {"adult": (0, 150), "old": (4, 143)},
    "forearm_supination": {"adult": (-80, 80), "old": (-71, 74)},
    "hand_flexion": {"adult": (-70, 80), "old": (-63, 64)},
    "hand_deviation": {"adult": (-30, 20), "old": (-26, 19)},
    "thigh_flexion": {"adult": (-15, 125), "old": (-15, 125)},
    "thigh_abduction": {"adult": (-25, 45), "old": (-25, 45)},
    "thigh_rotation": {"adult": (-45, 45), "old": (-45, 45)},
    "shank_flexion": {"adult": (0, 130), "old": (0, 130)},
    "foot_plantarflexion": {"adult": (-20, 50), "old": (-20, 50)},
}
"""Lower and upper end of the range of each hinge of arms and legs: AAOS for adults' arms, Walker et al. for those of
old people, the Merck Manual for legs, which are welded in the lying pose. Internal rotation, supination, radial
deviation and flexion are positive."""
MEAN_ARM_KG = 69.2 * DE_LEVA["M"]["upper_arm"].mass
"""Mass of man-adult's upper arm, which is assumed for the people whose elbows were measured."""
ELBOW_NM_RAD, ELBOW_RANGE_NM_RAD = 1.1, (0.40, 1.8)
"""Middle value and range of the stiffness that Wiegner and Watts found."""
ELBOW_NEUTRAL_DEG = 180.0 - 107.0
ELBOW = (
    "Wiegner and Watts 1986, J Neurol Neurosurg Psychiatry 49:1171, 19 relaxed people (abstract): 0.40 to 1.8 N m/rad, "
    "here in proportion to the mass of the upper arm (they found r = 0.85 with its volume); at rest at 107 +- 10 "
    "degrees, taken as the angle between the bones, 180 straight. Damping assumed. No change with age (Lin, Ju and "
    "Huang 2005, Arch Phys Med Rehabil 86, abstract: little in 192 people until 70 years; stiffness and damping go by "
    "body weight)"
)
SHOULDER_NM_RAD, SHOULDER_RANGE_NM_RAD = 1.5, (0.5, 5.0)
"""Assumed value and plausible range of the shoulder's stiffness."""
SHOULDER = (
    "assumed, middle of the plausible 0.5 to 5 N m/rad and 0.2 to 1.5 N m s/rad, in proportion to the mass of the "
    "upper arm as the elbow's. Relaxed shoulders of men are stiffer than women's (Hwang et al. 2023, "
    "doi:10.36227/techrxiv.24585783, abstract, without numbers). No neutral angle was found"
)
FOREARM_NM_RAD, WRIST_FLEXION_NM_RAD, WRIST_DEVIATION_NM_RAD = 0.76, 0.99, 2.9
WRIST = (
    "Drake and Charles 2014, Ann Biomed Eng 42:1853, mean over 10 relaxed people, without the coupling of the three "
    "(their numbers, from memory of papers that quote them: not checked); stiffer in deviation than in flexion, as "
    "Formica et al. 2012, J Neurophysiol 108:1158 (abstract), found. Damping assumed"
)


def hinges(body: Body) -> list[Hinge]:
    """Return every hinge of a body in the order of its joints, with the ranges of its age group."""
    rows: list[Hinge] = []

    def add(
        segment: str, motion: str, axis: Array, bind: float, k: float, d: float, source: str = ASSUMED, **more: Any
    ) -> None:
        """Add a hinge. Trunk and neck give their range, which is assumed; limbs take theirs from RANGE_DEG."""
        range_source = ASSUMED
        if "range_deg" not in more:
            more["range_deg"] = RANGE_DEG[f"{segment.partition('_')[2]}_{motion}"][body.age_group]
            range_source = AGED if body.age_group == "old" else AAOS
            if segment.endswith(("thigh", "shank", "foot")):
                range_source = LEGS
        more |= {"bind_deg": bind, "stiffness_nm_rad": k, "damping_nms_rad": d, "source": source}
        unit = np.asarray(axis, np.float64) / np.linalg.norm(axis)
        rows.append(Hinge(name=f"{segment}_{motion}", segment=segment, axis=unit, range_source=range_source, **more))

    x, y, z = np.eye(3)
    for segment in ("abdomen", "thorax"):
        add(segment, "flexion", x, 0, 60.0, 20.0, range_deg=(-20, 40))
        add(segment, "lateral", y, 0, 60.0, 20.0, range_deg=(-25, 25))
    add("neck", "flexion", x, 0, 8.0, 3.0, range_deg=(-45, 45))
    add("neck", "rotation", z, 0, 4.0, 2.0, range_deg=(-60, 60))

    share = body.mass_kg * DE_LEVA[body.sex]["upper_arm"].mass / MEAN_ARM_KG
    shoulder = SHOULDER_NM_RAD * share, 0.5 * share
    stiff_elbow = float(np.clip(ELBOW_NM_RAD * share, *ELBOW_RANGE_NM_RAD))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        upper, fore, hand = (f"{side}_{n}" for n in ("upper_arm", "forearm", "hand"))
        u, f = body.direction(upper), body.direction(fore)
        elbow = elbow_axis(u, f)
        elbow_bind = float(np.degrees(np.arctan2(np.cross(u, f) @ elbow, u @ f)))
        abduction_bind = float(np.degrees(np.arctan2(abs(u[0]), -u[2])))
        raised_bind = float(np.degrees(np.arcsin(np.clip(-u[1], -1, 1))))
        add(upper, "abduction", -sign * y, abduction_bind, *shoulder, SHOULDER)
        # This hinge lifts the humerus out of the frontal plane at any abduction; its range is that of flexion and
        # extension.
        add(upper, "flexion", np.cross(u, -y), raised_bind, *shoulder, SHOULDER)
        add(upper, "rotation", sign * u, 0, *shoulder, SHOULDER)
        add(fore, "flexion", elbow, elbow_bind, stiff_elbow, 0.2 * share, ELBOW, neutral_deg=ELBOW_NEUTRAL_DEG)
        palm, radial = hand_axes(body, side)
        add(fore, "supination", -sign * f, supination_of(palm, elbow, f, sign), FOREARM_NM_RAD, 0.03, WRIST)
        h = body.direction(hand)
        add(hand, "flexion", np.cross(h, palm), 0, WRIST_FLEXION_NM_RAD, 0.03, WRIST)
        add(hand, "deviation", np.cross(h, radial), 0, WRIST_DEVIATION_NM_RAD, 0.03, WRIST)

        thigh, shank, foot = (f"{side}_{n}" for n in ("thigh", "shank", "foot"))
        t, s = body.direction(thigh), body.direction(shank)
        hip_bind = float(np.degrees(np.arctan2(-t[1], -t[2])))
        knee_bind = hip_bind - float(np.degrees(np.arctan2(-s[1], -s[2])))
        add(thigh, "flexion", -x, hip_bind, 5.0, 1.0)
        add(thigh, "abduction", -sign * y, float(np.degrees(np.arctan2(abs(t[0]), -t[2]))), 5.0, 1.0)
        add(thigh, "rotation", sign * t, 0, 5.0, 1.0)
        add(shank, "flexion", x, knee_bind, 3.0, 1.0)
        add(foot, "plantarflexion", x, 0, 5.0, 0.5)
    return rows


STRAIGHT_DEG = 10.0


def elbow_axis(upper: Array, forearm: Array) -> Array:
    """Return the unit axis (3,) about which the elbow flexes, which is perpendicular to its bend.

    An arm that is straighter than STRAIGHT_DEG, as in a T-pose, does not show its axis: its bend may be the carrying
    angle and not flexion. Then the axis is the one about which the forearm moves forward.
    """
    across = np.cross(upper, forearm)
    bend = float(np.degrees(np.arcsin(np.clip(np.linalg.norm(across), 0, 1))))
    axis = across if bend > STRAIGHT_DEG else np.cross(upper, np.array([0.0, -1.0, 0.0]))
    return axis / np.linalg.norm(axis)


def supination_of(palm: Array, elbow: Array, forearm: Array, sign: float) -> float:
    """Return the angle [deg] of the palm about the supination axis; 0: its normal is along the elbow's axis."""
    axis = -sign * forearm
    neutral = sign * elbow - (sign * elbow @ axis) * axis
    flat = palm - (palm @ axis) * axis
    return float(np.degrees(np.arctan2(np.cross(neutral, flat) @ axis, neutral @ flat)))


def hand_axes(body: Body, side: str) -> tuple[Array, Array]:
    """Return two unit vectors (3,) of a hand in the bind pose: out of the palm, and toward the thumb."""
    h, letter = body.direction(f"{side}_hand"), side[0].upper()
    radial = body.landmarks[f"finger2-1.{letter}"] - body.landmarks[f"finger5-1.{letter}"]
    radial = radial - (radial @ h) * h
    radial /= np.linalg.norm(radial)
    return np.cross(radial, h) if side == "right" else np.cross(h, radial), radial
