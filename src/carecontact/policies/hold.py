"""How the hand is held over foam: against the skin's normal, and turned or upright where the person leaves no room."""

from __future__ import annotations

from itertools import product

import numpy as np
import numpy.typing as npt

from carecontact.interface.geometry import matrix_from_quat
from carecontact.interface.robot import PANDA
from carecontact.policies.foam import NEAREST, FoamSeen, lanes
from carecontact.policies.motion import UP, tool_quat

F64 = npt.NDArray[np.float64]

LEANS = (1.0, 0.5, 0.0)
"""Shares of the way from straight up to the skin's normal."""
YAWS_DEG = (0, 45, -45, 90, -90)
"""Turns about the tool's axis from where the wrist is near the middle of its range."""
CLEAR_M = 0.030
"""Enough room: twice the 15 mm by which the deepest breath moves the chest."""
NEAR_M = 0.35
"""Farther from the foam than this, neither the hand nor the last links are."""


def holds(foam: FoamSeen, person: F64) -> list[tuple[F64, F64]]:
    """Return orientations (4,) of the tool with the (3,) unit vectors against which it presses, the best one first.

    Those with room for hand and last links come first, from the least turned and the least raised one on, and then the
    others, from the most room on.

    Args:
        person: (N, 3) seen points of the person in base [m].
    """
    near = person[np.linalg.norm(person - foam.centre_m, axis=1) < NEAR_M]
    places, radial = foam.on_skin(np.vstack(lanes(foam))), np.arctan2(foam.centre_m[1], foam.centre_m[0])
    ways = sorted(product(LEANS, YAWS_DEG), key=lambda way: 2 * (1 - way[0]) + abs(way[1]) / 90)
    found: list[tuple[float, F64, F64]] = []
    for lean, yaw in ways:
        out = lean * foam.out + (1 - lean) * UP
        out /= np.linalg.norm(out)
        turned = radial + np.radians(yaw)
        quat = tool_quat(-out, np.array([np.cos(turned), np.sin(turned), 0.0]))
        found.append((min(CLEAR_M, room(near, places, quat)), quat, out))
    return [(quat, out) for _, quat, out in sorted(found, key=lambda way: -way[0])]


def room(person: F64, places: F64, quat: F64) -> float:
    """Return the distance [m] of hand and last links from a person (N, 3), below 0 inside of it, with the tool's tip at
    the nearest of places (n, 3). Fewer points than NEAREST are noise."""
    least = np.inf
    for place in places:
        off = (person - place) @ matrix_from_quat(quat)
        for half_m, behind_m in PANDA.hand_boxes_m[1:]:  # the fingers are in the tool
            gap = np.abs(off + [0.0, 0.0, behind_m]) - half_m
            apart = np.linalg.norm(np.maximum(gap, 0.0), axis=1) + np.minimum(gap.max(axis=1), 0.0)
            least = min([least, *np.sort(apart)[NEAREST : NEAREST + 1]])
    return float(least)
