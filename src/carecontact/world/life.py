"""The movements that the person makes on their own, drawn by a seed from the protocol's ranges."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from carecontact.contract.protocol import Alive, Repositioning
from carecontact.kernel.life import JOINTS, MOST_MOVES, Doings, Move, Pull
from carecontact.world.human.body import Array

TONE = {"passive": 0.0, "helps": 0.0, "holds": 0.15}
"""Manner -> activation of the muscles at rest (assumed): the shoulder of a person who holds is about twenty times as
stiff as a passive one."""
HELP = {"passive": 0.0, "helps": 0.8, "holds": 0.0}
"""Manner -> share of the passive joints' stiffness and damping that the person cancels by helping (assumed)."""
LIFT_RAD = 0.13
"""Commanded flexion of the shoulder in the middle of a change of posture: man-adult's wrist then rises by about 10 mm
and does not rub on the board."""
WIDEST_M = 0.08
"""Largest distance of the wrist, along the board, from where it lay at first."""
REST_S = 0.5
"""Least time from the end of a change of posture to the next one."""


@dataclass(frozen=True, kw_only=True)
class Shift:
    """A change of posture, drawn before it is known how the person lies."""

    time_s: float
    duration_s: float
    wrist_m: float
    """Displacement of the wrist along the board; away from the trunk is positive."""


def draw_shifts(rng: np.random.Generator, wanted: Repositioning, *, until_s: float) -> list[Shift]:
    """Draw changes of posture, with exponentially distributed pauses between them, whose onsets are before ``until_s``.

    They are drawn before the trial and therefore cannot depend on the robot. The first onset may come at once.
    """
    out: list[Shift] = []
    now = at = 0.0
    gap_s = max(0.0, 60.0 / wanted.per_minute - np.mean(wanted.duration_s) - REST_S)
    while len(out) < MOST_MOVES:
        now += float(rng.exponential(gap_s))
        size, duration = float(rng.uniform(*wanted.wrist_m)), float(rng.uniform(*wanted.duration_s))
        way = float(rng.choice([-1.0, 1.0]))
        if now >= until_s:
            break
        if abs(at + way * size) > WIDEST_M:
            way = -np.sign(at)
        out.append(Shift(time_s=now, duration_s=duration, wrist_m=way * size))
        at += way * size
        now += duration + REST_S
    return out


def draw_doings(rng: dict[str, np.random.Generator], alive: Alive, *, until_s: float, wrist_radius_m: float) -> Doings:
    """Draw all movements of one person.

    Args:
        rng: streams ``breathing``, ``repositioning`` and ``withdrawal``.
        until_s: length of the longest trial [s].
        wrist_radius_m: horizontal distance of the wrist from the shoulder [m].
    """
    out = Doings(tone=TONE[alive.manner], help=HELP[alive.manner])
    if (b := alive.breathing) is not None:
        draw = rng["breathing"].uniform
        hz, belly, chest = (float(draw(*pair)) for pair in (b.frequency_hz, b.abdomen_m, b.chest_m))
        out = replace(
            out, breath_hz=hz, inspiration_share=b.inspiration_share, phase=float(draw()), breath_m=(belly, chest)
        )
    if alive.repositioning is not None:
        shifts = draw_shifts(rng["repositioning"], alive.repositioning, until_s=until_s)
        out = replace(out, moves=tuple(_move(shift, wrist_radius_m) for shift in shifts))
    if (w := alive.withdrawal) is not None:
        pull = Pull(
            force_n=float(rng["withdrawal"].uniform(*w.force_n)), for_s=w.for_s, delay_s=w.delay_s,
            duration_s=w.duration_s, shift_rad=_abduction(-w.wrist_m / wrist_radius_m),
        )  # fmt: skip
        out = replace(out, pull=pull)
    return out


def _move(shift: Shift, radius_m: float) -> Move:
    turn = _abduction(shift.wrist_m / radius_m)
    return Move(time_s=shift.time_s, duration_s=shift.duration_s, lift_rad=LIFT_RAD, shift_rad=turn)


def _abduction(angle_rad: float) -> Array:
    return angle_rad * np.array([joint.endswith("abduction") for joint in JOINTS], np.float64)
