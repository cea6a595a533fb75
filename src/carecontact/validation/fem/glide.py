"""A tool that is pressed in and then moves along the surface at the same depth, stuck to it or with friction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carecontact.errors import CarecontactError
from carecontact.validation.fem.contact import Mask, balance
from carecontact.validation.fem.surface import ACROSS, ALONG, PRESS, Surface
from carecontact.validation.fem.tools import Tool
from carecontact.validation.result import Array

MOST_TURNS, CLOSE = 60, 1e-3
"""Most alternations between pushes and drags in one step, and the change of the total drag, as a share of the total
friction, at which they end (Panagiotopoulos 1975, Ingenieur-Archiv 44:421)."""
DESCENTS, SETTLED = 3000, 1e-5
EASE = 0.5
"""Share of the newly found displacements that an alternation adopts (relaxation)."""


@dataclass(frozen=True, kw_only=True)
class Glide:
    """The motion of a tool along the surface, from rest, at one depth."""

    way_m: Array
    """(n,) distance that the tool has moved along"""
    normal_n: Array
    """(n,) force along the press"""
    tangential_n: Array
    """(n,) force against the motion"""


def stuck_stiffness(surface: Surface, tool: Tool, depth_m: float) -> tuple[float, float]:
    """Return the ratio of force to distance [N/m] along the surface for a tool that is glued to the surface it touches,
    and the radius [m] of a circle with the area of contact, which is that of a press without friction.
    """
    joint = surface.compliance((PRESS,), (PRESS,))
    _, active = balance(joint, surface.gap(tool, depth_m))
    stuck = Surface(
        kernel=surface.kernel, limb_radius_m=surface.limb_radius_m, places=surface.places[active], images=surface.images
    )
    n = int(active.sum())
    axes = PRESS, ALONG, ACROSS
    force = np.linalg.solve(stuck.compliance(axes, axes), np.repeat([0.0, 1.0, 0.0], n))
    radius = np.sqrt(surface.count * n * np.prod(surface.kernel.step_m) / np.pi)
    return float(surface.count * force[n : 2 * n].sum()), float(radius)


def glide(surface: Surface, tool: Tool, depth_m: float, way_m: Array, friction: float) -> Glide:
    """Move a tool with Coulomb friction, step by step along ``way_m``, which begins at 0 with a frictionless press.

    A patch sticks to the tool until its drag reaches ``friction`` times its push. Pushes act along the press, and the
    tool does not turn. Raises CarecontactError if a step finds no balance.
    """
    m = len(surface.places)
    normal = surface.compliance((PRESS,), (PRESS,))
    cross = surface.compliance((PRESS,), (ALONG, ACROSS))
    back = surface.compliance((ALONG, ACROSS), (PRESS,))
    side = surface.compliance((ALONG, ACROSS), (ALONG, ACROSS))
    push, active = balance(normal, surface.gap(tool, depth_m))
    drag, moved = np.zeros(2 * m), back @ push
    normals, tangentials, before = [push.sum()], [0.0], 0.0
    for way in way_m[1:]:
        # Where each patch would be if it stuck to the tool.
        carried = moved + np.r_[np.full(m, way - before), np.zeros(m)]
        along, last = moved[:m], np.inf
        for _ in range(MOST_TURNS):
            gap = surface.gap(tool, depth_m, moved_m=way - along)
            push, active = balance(normal, gap - cross @ drag, active)
            drag = _drag(side, carried - back @ push, drag, friction * push, active)
            now = side @ drag + back @ push
            along = (1 - EASE) * along + EASE * now[:m]
            total = drag[:m].sum()
            if abs(total - last) < CLOSE * friction * push.sum():
                break
            last = total
        else:
            raise CarecontactError(f"finite elements: friction found no balance {1000 * way:.2f} mm along")
        moved, before = side @ drag + back @ push, way
        normals.append(push.sum())
        tangentials.append(drag[:m].sum())
    return Glide(
        way_m=way_m, normal_n=surface.count * np.array(normals), tangential_n=surface.count * np.array(tangentials)
    )


def _drag(side: Array, wanted: Array, start: Array, most: Array, active: Mask) -> Array:
    """Return drags (2 m,) along and across that move patches to ``wanted`` but nowhere exceed ``most`` (m,).

    The method is accelerated projected gradients (Beck and Teboulle 2009, SIAM J Imaging Sci 2:183), restarted if they
    turn back.
    """
    pick = np.flatnonzero(active)
    both = np.r_[pick, pick + len(active)]
    matrix, target, limit = side[np.ix_(both, both)], wanted[both], most[pick]
    step = 1 / np.abs(matrix).sum(1).max()
    found = _within(start[both], limit)
    ahead, speed = found, 1.0
    for _ in range(DESCENTS):
        new = _within(ahead - step * (matrix @ ahead - target), limit)
        turned = (ahead - new) @ (new - found) > 0
        faster = 1.0 if turned else (1 + np.sqrt(1 + 4 * speed**2)) / 2
        ahead = new + (0.0 if turned else (speed - 1) / faster) * (new - found)
        change, found, speed = np.abs(new - found).max(), new, faster
        if change < SETTLED * limit.max() and not turned:
            break
    out = np.zeros(len(start))
    out[both] = found
    return out


def _within(drag: Array, most: Array) -> Array:
    """Return the drags, shortened to at most ``most`` (m,)."""
    pairs = drag.reshape(2, -1)
    size = np.hypot(*pairs)
    return (pairs * np.minimum(1.0, most / np.maximum(size, 1e-300))).ravel()
