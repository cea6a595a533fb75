"""Contacts beyond those that the check of energy judges: harder, faster and deeper. In some of them, energy is made or
vanishes. What is found is reported and decides nothing, but for those of ``ledger.of_the_layer``, which that check
judges.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from carecontact.contract.embodiment import EMBODIMENTS
from carecontact.validation.ledger import Hard, bounce, dragged, pressed, steps_s
from carecontact.validation.result import Measure
from carecontact.validation.rig import CAP, PAD, Tool, of_tip
from carecontact.validation.subject import Subject

MITT = of_tip("mitt", EMBODIMENTS["mitt"].tip)


def _nose_down(tool: Tool, degrees: float) -> Tool:
    """Return a box whose front edge, towards which it is dragged, is turned down."""
    half = np.radians(degrees) / 2
    long, _, high = tool.size_m
    lowest = long * np.sin(2 * half) + high * np.cos(2 * half)
    return replace(tool, name=f"{tool.name} with its nose {degrees:g} degrees down", height_m=float(lowest),
                   turned=(float(np.cos(half)), 0.0, float(np.sin(half)), 0.0))  # fmt: skip


def _aslant(tool: Tool, speed_m_s: float) -> Hard:
    return Hard(tool=tool, how=f"bounced aslant at {speed_m_s:g} m/s both ways",
                contact=partial(bounce, speed_m_s=speed_m_s, sideways_m_s=speed_m_s))  # fmt: skip


HARD = (
    dragged(CAP, 5.0, 0.1), dragged(CAP, 5.0, 0.3), dragged(CAP, 10.0, 0.1), dragged(CAP, 10.0, 0.3),
    dragged(PAD, 5.0, 0.1), dragged(PAD, 7.0, 0.1), dragged(PAD, 10.0, 0.2),
    dragged(_nose_down(PAD, 20.0), 3.0, 0.1), dragged(MITT, 10.0, 0.1), dragged(MITT, 15.0, 0.1),
    pressed(CAP, 15.0), pressed(CAP, 20.0), _aslant(CAP, 0.5), _aslant(CAP, 0.8), _aslant(PAD, 0.8),
)  # fmt: skip


def measures(subject: Subject, region: str) -> Iterator[Measure]:
    """Yield what each contact measured, at the protocol's step and at that of the fast mode."""
    for dt_s in steps_s(subject, quick=False):
        for hard in HARD:
            name = hard.name(f"{region}, beyond the claim", dt_s)
            yield from hard.contact(subject, region, hard.tool, dt_s=dt_s).measures(name, decides=False)
