"""A rigid indenter against a surface whose compliance is known: nodes push, and never pull."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from carecontact.errors import CarecontactError
from carecontact.validation.fem.profiles import Profile
from carecontact.validation.fem.surface import Surface
from carecontact.validation.result import Array

Mask = npt.NDArray[np.bool_]

TOGETHER, MOST_ROUNDS = 30, 3000
"""Rounds in which every wrong node changes at once, which is quick and may circle; after them only the outermost does,
which ends for every positive definite compliance without sticking (Murty 1974, Opsearch 11:123)."""
CLEAR_M = 1e-9
"""By how much a node may lie inside the indenter and still count as out of contact."""


@dataclass(frozen=True, kw_only=True)
class Contact:
    force_n: float
    """Of the whole indenter, along its axis."""
    radius_m: float
    """Distance of the farthest node in contact from the axis."""
    nodal_n: Array
    """(m,) push, followed by (m,) radial drag where the contact sticks."""


def press(surface: Surface, profile: Profile, depth_m: float) -> Contact:
    """Frictionless contact at one depth past first touch. Raises CarecontactError if no set of nodes balances."""
    gap = surface.gap(profile, depth_m)
    push, active = _balance(surface.normal, gap, gap > 0)
    return _contact(surface, push, active)


def press_sticking(surface: Surface, profile: Profile, depths_m: Array) -> list[Contact]:
    """Contact that never slips, step by step through increasing depths: a node keeps, along the surface, the place at
    which it was touched. Finer steps are more exact where contact grows.

    Raises CarecontactError if no set of nodes balances; this has happened at the rounded rim of a disc.
    """
    n = len(surface.normal)
    joint = np.block([[surface.normal, surface.cross], [surface.cross.T, surface.radial]])
    held, active = np.zeros(n), np.zeros(n, np.bool_)
    found = []
    for depth in depths_m:
        gap = surface.gap(profile, float(depth))
        before = active.copy()
        push, active = _balance(joint, np.r_[gap, held], active | (gap > 0), sticking=True)
        slid = (joint @ push)[n:]
        held = np.where(active & before, held, slid)
        found.append(_contact(surface, push, active))
    return found


def _balance(compliance: Array, target: Array, active: Mask, *, sticking: bool = False) -> tuple[Array, Mask]:
    """Nodal forces (m,), or (2 m,) with drags, and the nodes in contact, by the active-set method."""
    n = len(active)
    for round_ in range(MOST_ROUNDS):
        pick = np.flatnonzero(np.r_[active, active] if sticking else active)
        force = np.zeros(len(target))
        force[pick] = np.linalg.solve(compliance[np.ix_(pick, pick)], target[pick])
        inside = target[:n] - compliance[:n] @ force
        wrong = np.flatnonzero(np.where(active, force[:n] <= 0, inside > CLEAR_M))
        if not len(wrong):
            return force, active
        wrong = wrong if round_ < TOGETHER else wrong[-1:]
        active = active.copy()
        active[wrong] = ~active[wrong]
    raise CarecontactError(f"finite elements: contact found no balance in {MOST_ROUNDS} rounds")


def _contact(surface: Surface, nodal_n: Array, active: Mask) -> Contact:
    radius = surface.distance_m[active]
    push = nodal_n[: len(active)]
    return Contact(force_n=float(push.sum()), radius_m=float(radius.max(initial=0.0)), nodal_n=nodal_n)
