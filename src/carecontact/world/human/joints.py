"""The person's hinges: axis, range of motion, passive stiffness and damping.

Ranges: AAOS 1965 adult means (shoulder, elbow, wrist, hip, knee, ankle); trunk and neck ranges are assumed. Angles are
anatomical: zero is the anatomical position with the forearm in neutral rotation, so ``qpos`` reads as in a clinic.
Order in a segment is the order of rotation, outermost first: shoulder abduction, flexion, rotation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carecontact.world.human.body import Array, Body

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
    source: str
    """Of stiffness and damping."""


def hinges(body: Body) -> list[Hinge]:
    rows: list[Hinge] = []

    def add(
        segment: str, motion: str, axis: Array, bind: float, low: float, high: float, k: float, d: float, source: str
    ) -> None:
        unit = np.asarray(axis, np.float64) / np.linalg.norm(axis)
        rows.append(
            Hinge(
                name=f"{segment}_{motion}", segment=segment, axis=unit, bind_deg=bind, range_deg=(low, high),
                stiffness_nm_rad=k, damping_nms_rad=d, source=source,
            )
        )  # fmt: skip

    x, y, z = np.eye(3)
    for segment, k, d in (("abdomen", 60.0, 20.0), ("thorax", 60.0, 20.0)):
        add(segment, "flexion", x, 0, -20, 40, k, d, ASSUMED)
        add(segment, "lateral", y, 0, -25, 25, k, d, ASSUMED)
    add("neck", "flexion", x, 0, -45, 45, 8.0, 3.0, ASSUMED)
    add("neck", "rotation", z, 0, -60, 60, 4.0, 2.0, ASSUMED)

    for side, sign in (("left", 1.0), ("right", -1.0)):
        upper, fore, hand = (f"{side}_{n}" for n in ("upper_arm", "forearm", "hand"))
        u, f = body.direction(upper), body.direction(fore)
        elbow = np.cross(u, f)
        elbow_bind = float(np.degrees(np.arccos(np.clip(u @ f, -1, 1))))
        abduction_bind = float(np.degrees(np.arctan2(abs(u[0]), -u[2])))
        shoulder = "stiffness and damping within 0.5-5 N m/rad and 0.2-1.5 N m s/rad (plausible range, assumed mid)"
        add(upper, "abduction", -sign * y, abduction_bind, 0, 180, 1.5, 0.5, shoulder)
        # Lifts the humerus out of the frontal plane at any abduction; its range is that of flexion and extension.
        add(upper, "flexion", np.cross(u, -y), 0, -60, 180, 1.5, 0.5, shoulder)
        add(upper, "rotation", sign * u, 0, -90, 70, 1.5, 0.5, shoulder + "; positive is internal")
        add(fore, "flexion", elbow, elbow_bind, 0, 150, 1.0, 0.2, "elbow stiffness 0.4-1.8 N m/rad in the literature")
        palm, radial = hand_axes(body, side)
        add(fore, "supination", -sign * f, supination_of(palm, elbow, f, sign), -80, 80, 0.5, 0.03, ASSUMED)
        h = body.direction(hand)
        add(hand, "flexion", np.cross(h, palm), 0, -70, 80, 0.3, 0.03, "passive wrist flexion")
        add(
            hand, "deviation", np.cross(h, radial), 0, -30, 20, 1.0, 0.03, "passive wrist deviation; positive is radial"
        )

        thigh, shank, foot = (f"{side}_{n}" for n in ("thigh", "shank", "foot"))
        t, s = body.direction(thigh), body.direction(shank)
        hip_bind = float(np.degrees(np.arctan2(-t[1], -t[2])))
        knee_bind = hip_bind - float(np.degrees(np.arctan2(-s[1], -s[2])))
        add(thigh, "flexion", -x, hip_bind, -15, 125, 5.0, 1.0, "damping 1.0 N m s/rad; stiffness assumed")
        add(thigh, "abduction", -sign * y, float(np.degrees(np.arctan2(abs(t[0]), -t[2]))), -25, 45, 5.0, 1.0, ASSUMED)
        add(thigh, "rotation", sign * t, 0, -45, 45, 5.0, 1.0, ASSUMED)
        add(shank, "flexion", x, knee_bind, 0, 130, 3.0, 1.0, "damping 1.0 N m s/rad; stiffness assumed")
        add(foot, "plantarflexion", x, 0, -20, 50, 5.0, 0.5, ASSUMED)
    return rows


def supination_of(palm: Array, elbow: Array, forearm: Array, sign: float) -> float:
    """Angle of the palm from neutral (palm normal along the elbow's axis) about the supination axis [deg]."""
    axis = -sign * forearm
    neutral = sign * elbow - (sign * elbow @ axis) * axis
    flat = palm - (palm @ axis) * axis
    return float(np.degrees(np.arctan2(np.cross(neutral, flat) @ axis, neutral @ flat)))


def hand_axes(body: Body, side: str) -> tuple[Array, Array]:
    """Palm normal (out of the palm) and radial direction (toward the thumb) of a hand in the bind pose, unit."""
    h, letter = body.direction(f"{side}_hand"), side[0].upper()
    radial = body.landmarks[f"finger2-1.{letter}"] - body.landmarks[f"finger5-1.{letter}"]
    radial = radial - (radial @ h) * h
    radial /= np.linalg.norm(radial)
    return np.cross(radial, h) if side == "right" else np.cross(h, radial), radial
