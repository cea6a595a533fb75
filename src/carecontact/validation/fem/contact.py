"""Contact of a rigid tool with a surface of known compliance: patches push and never pull."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from carecontact.errors import CarecontactError
from carecontact.validation.result import Array

Mask = npt.NDArray[np.bool_]

TOGETHER, MOST_ROUNDS = 30, 3000
"""Number of rounds in which all wrong patches change at once, which is fast but may cycle, and the most rounds in all.
After the first ones only the outermost wrong patch changes, which ends for every positive definite compliance (Murty
1974, Opsearch 11:123)."""
CLEAR_M = 1e-9
"""Largest depth of a patch inside the tool at which it still counts as out of contact."""


def balance(compliance: Array, gap: Array, start: Mask | None = None) -> tuple[Array, Mask]:
    """Solve frictionless contact by the active-set method: return the pushes (m,) [N] and which patches are in contact.

    Args:
        compliance: (m, m) inward displacement by push; patches in the order from the middle outwards.
        gap: (m,) least displacement by which each patch has to yield [m].
        start: a guess of the patches in contact; default: those with a positive gap.

    Raises CarecontactError if no set of patches balances.
    """
    active = gap > 0 if start is None else start
    for round_ in range(MOST_ROUNDS):
        pick = np.flatnonzero(active)
        force = np.zeros(len(gap))
        force[pick] = np.linalg.solve(compliance[np.ix_(pick, pick)], gap[pick])
        inside = gap - compliance[:, pick] @ force[pick]
        wrong = np.flatnonzero(np.where(active, force <= 0, inside > CLEAR_M))
        if not len(wrong):
            return force, active
        wrong = wrong if round_ < TOGETHER else wrong[-1:]
        active = active.copy()
        active[wrong] = ~active[wrong]
    raise CarecontactError(f"finite elements: contact found no balance in {MOST_ROUNDS} rounds")
