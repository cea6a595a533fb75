"""The answers of the simulated person on the indentation bench."""

from __future__ import annotations

import numpy as np

from carecontact.validation.calibration_residual import held_out_m
from carecontact.validation.fem.answer import Answer, Curve
from carecontact.validation.fem.cases import DEPTHS_M, Case
from carecontact.validation.fem.materials import MATCHED_M
from carecontact.validation.pressing import person_bench
from carecontact.validation.reference import SPEED_M_S
from carecontact.validation.result import Array
from carecontact.validation.subject import Subject

TRAVEL_M = DEPTHS_M[-1] + 0.002
"""Past geometric touch: first force on a bumpy surface comes later."""
RING_M = 0.002
"""The dimple at a distance is the mean over the skin's vertices within this of it."""
RINGS_M = np.arange(0.004, 0.0301, RING_M)


def answer(subject: Subject, case: Case) -> Answer:
    """How the person's region answers: the mean over the places that no fit used.

    Raises SceneError where an indenter does not find the region's surface.
    """
    places = held_out_m(case.region)
    curves, dimples = {}, []
    for name, indenter in case.indenters().items():
        bench = person_bench(subject, case.region, indenter)
        presses = [bench.press(along_m=x, across_m=y, depth_m=TRAVEL_M, speed_m_s=SPEED_M_S) for x, y in places]
        curves[name] = Curve(presses=tuple((p.indentation_m, p.force_n) for p in presses))
        if name == case.main():
            for x, y in places:
                bench.press(along_m=x, across_m=y, depth_m=MATCHED_M, speed_m_s=SPEED_M_S)
                dimples.append(_rings(*bench.skin()))
    sunk = np.nanmean(dimples, axis=0)
    return Answer(curves=curves, dimple_m=sunk, dimple_at_m=RINGS_M, dimple_travel_m=MATCHED_M)


def _rings(distance_m: Array, sunk_m: Array) -> Array:
    """(r,) mean over the vertices in each ring; not a number where there is none."""
    near = [np.abs(distance_m - ring) <= RING_M for ring in RINGS_M]
    return np.array([sunk_m[pick].mean() if pick.any() else np.nan for pick in near])
