"""Contacts beyond those that the check of energy judges: harder, faster and deeper. In some of them, energy is made or
vanishes. What is found is reported and decides nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from carecontact.contract.embodiment import EMBODIMENTS
from carecontact.validation.ledger import Ledger, bounce, drag, steps_s
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


@dataclass(frozen=True, kw_only=True)
class Hard:
    """One contact beyond the claim."""

    tool: Tool
    how: str
    contact: Callable[..., Ledger]


def _dragged(tool: Tool, press_n: float, speed_m_s: float) -> Hard:
    return Hard(
        tool=tool, how=f"pressed with {press_n:g} N and dragged at {speed_m_s:g} m/s",
        contact=partial(drag, press_n=press_n, speed_m_s=speed_m_s),
    )  # fmt: skip


def _pressed(tool: Tool, press_n: float) -> Hard:
    return Hard(tool=tool, how=f"pressed suddenly with {press_n:g} N",
                contact=partial(drag, press_n=press_n, speed_m_s=0.0))  # fmt: skip


def _aslant(tool: Tool, speed_m_s: float) -> Hard:
    return Hard(tool=tool, how=f"bounced aslant at {speed_m_s:g} m/s both ways",
                contact=partial(bounce, speed_m_s=speed_m_s, sideways_m_s=speed_m_s))  # fmt: skip


HARD = (
    _dragged(CAP, 5.0, 0.1), _dragged(CAP, 5.0, 0.3), _dragged(CAP, 10.0, 0.1), _dragged(CAP, 10.0, 0.3),
    _dragged(PAD, 5.0, 0.1), _dragged(PAD, 7.0, 0.1), _dragged(PAD, 10.0, 0.2),
    _dragged(_nose_down(PAD, 20.0), 3.0, 0.1), _dragged(MITT, 10.0, 0.1), _dragged(MITT, 15.0, 0.1),
    _pressed(CAP, 15.0), _pressed(CAP, 20.0), _aslant(CAP, 0.5), _aslant(CAP, 0.8), _aslant(PAD, 0.8),
)  # fmt: skip


def measures(subject: Subject, region: str) -> Iterator[Measure]:
    """Yield what each contact measured, at the protocol's step and at that of the fast mode."""
    for dt_s in steps_s(subject, quick=False):
        for hard in HARD:
            name = f"{region}, beyond the claim: {hard.tool.name} of 1 kg {hard.how} at {1000 * dt_s:g} ms"
            yield from hard.contact(subject, region, hard.tool, dt_s=dt_s).measures(name, decides=False)
