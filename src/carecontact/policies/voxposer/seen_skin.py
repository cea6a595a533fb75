"""Remembers where the skin was seen before the arm came near, from which voxposer-phased concludes that the tool
touches."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from carecontact.policies.motion import CAP_RADIUS_M
from carecontact.policies.voxposer import fixed_values as fixed

F64 = npt.NDArray[np.float64]


def touches(skin: F64, tool: F64) -> bool:
    """Return whether the round cap of a tool at (3,) is within CONTACT_M of the seen skin (N, 3), all in base [m]."""
    centre = tool + [0.0, 0.0, CAP_RADIUS_M]
    return bool(np.linalg.norm(skin - centre, axis=1).min(initial=np.inf) <= CAP_RADIUS_M + fixed.CONTACT_M)


def gap(skin: F64, tool: F64, direction: F64) -> float:
    """Return how far [m] the cap can still go along a level direction (3,) before it meets the seen skin (N, 3).

    It is 0 if the cap is there already, or if nothing is seen on its way.
    """
    offset = skin - tool
    ahead = offset @ direction
    beside = np.linalg.norm((offset - ahead[:, None] * direction)[:, :2], axis=1) <= CAP_RADIUS_M
    ahead = ahead[beside & (offset[:, 2] >= 0) & (ahead > 0)]
    return max(float(ahead.min()) - CAP_RADIUS_M, 0.0) if len(ahead) else 0.0


def skin_height(skin: F64, place: F64) -> float:
    """Return the height in base [m] of the seen skin (N, 3) above a place (3,).

    Where no skin was seen, it is such that a tool which slides PRESS_M below it stays at the height of the place.
    """
    near = skin[np.hypot(*(skin[:, :2] - place[:2]).T) < fixed.SKIN_RADIUS_M, 2]
    return float(np.percentile(near, 90)) if len(near) else float(place[2]) + fixed.PRESS_M
