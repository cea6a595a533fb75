"""Answers of a tissue that follows simple rules."""

from __future__ import annotations

import numpy as np

from carecontact.lab.fem.cases import RINGS_M, WAYS_M, Answer, Case, Curve, Drag


def power(case: Case, exponent: float, *, scale: float = 1.0) -> Answer:
    """Force = scale 1e6 r^exponent d, a dimple that sinks by a fifth of the travel everywhere, and a drag that grows by
    1 N/mm up to half the normal force of 2 N."""
    depth = np.linspace(0.0, 0.006, 200)
    curves = {
        name: Curve(presses=((depth, scale * 1e6 * tool.radius_m**exponent * depth),))
        for name, tool in case.tools().items()
    }
    drag = Drag(
        way_m=WAYS_M, force_n=np.minimum(1000 * WAYS_M, 1.0), normal_n=np.full(len(WAYS_M), 2.0), stuck_n_m=1000.0
    )
    return Answer(
        curves=curves, dimple=np.full(len(RINGS_M), 0.2), beside=np.full(len(RINGS_M), -0.1),
        drags={tool.name: drag for tool in case.gliding()}, modulus_pa=1e4,
    )  # fmt: skip
