"""The answers of the finite elements, by two methods: nothing here simulates."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from carecontact.errors import CarecontactError, DependencyError
from carecontact.lab.fem.cases import (
    DEPTHS_M,
    FRICTION,
    MATCHED_M,
    TRAVEL_M,
    WAYS_M,
    Answer,
    Case,
    Curve,
    Drag,
    Medium,
    Skin,
    Tool,
    rings,
)
from carecontact.lab.fem.surface import ACROSS, ALONG, PRESS, Kernel, Spectrum, Surface, around, finest
from carecontact.lab.validation.result import Array

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
    and the radius [m] of a circle with the area of contact, which is that of a press without friction."""
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


# The same presses by quadratic hexahedra in three dimensions, as a second method for the same equations, without
# Fourier series. It is too slow for the whole table. A quarter of the ground is meshed, with symmetry on two sides.
#
# Quadratic elements work for Poisson's ratios up to 0.49, at which linear ones lock; the energy of volume change is
# integrated with two points along each side.

NEEDS = "carecontact verify physics --fem needs scikit-fem: pip install 'carecontact[fem]'"

try:
    import skfem
except ModuleNotFoundError:
    raise DependencyError(NEEDS) from None

SIDE_M, GROWTH = 0.0025, 1.6
"""Side of the elements under the tool, whose nodes are half as far apart, and the growth from one element to the
next."""
END_M = 0.10
"""Distance from the axis at which the ground ends along and, if flat, across; its ends are free."""
TURN = 0.97 * np.pi
"""Angle [rad] around the limb to which the mesh goes on each side; the seam opposite the tool is free."""


_NO_PIVOTS = {"SymmetricMode": True, "DiagPivotThresh": 0.0}


class Block:
    """A quarter of the ground, reduced to the compliance of the surface's nodes near the axis."""

    def __init__(self, medium: Medium, reach_m: float, *, side_m: float = SIDE_M) -> None:
        ground = medium.ground
        radius = ground.limb_radius_m
        width = END_M if radius is None else TURN * radius
        mesh = skfem.MeshHex.init_tensor(
            graded(side_m, reach_m, END_M), graded(side_m, reach_m, width), -_depths(medium, side_m)[::-1]
        )
        depth = -mesh.p[2][mesh.t].mean(0)
        flat = skfem.MeshHex2.from_mesh(mesh)
        basis = skfem.Basis(_bent(flat, radius), skfem.ElementHex2(), intorder=4)
        unbent = skfem.Basis(flat, basis.elem, intorder=1).doflocs
        modulus = np.where(depth < medium.skin.thickness_m, medium.skin.modulus_pa, medium.tissue_pa)
        matrix = _stiffness(basis, modulus, ground.poisson)
        # Three displacements at each node: along, across and up.
        fixed = np.repeat(unbent[2] < -ground.thickness_m + 1e-9, 3)
        for side in (0, 1):
            fixed[side::3] |= np.abs(unbent[side]) < 1e-9
        near = np.hypot(unbent[0], unbent[1])
        nodes = np.flatnonzero((unbent[2] > -1e-9) & (near < reach_m))
        nodes = nodes[np.argsort(near[nodes])]
        free = np.flatnonzero(~fixed)
        up = np.searchsorted(free, 3 * nodes + 2)
        loads = np.zeros((len(free), len(nodes)))
        loads[up, np.arange(len(nodes))] = 1.0
        # The matrix is symmetric and positive definite: order by minimum degree on A^T + A, without pivoting.
        factors = splu(matrix[free][:, free], permc_spec="MMD_AT_PLUS_A", options=_NO_PIVOTS)
        self._compliance = factors.solve(loads)[up]
        self._along, self._across, height = basis.doflocs[:, nodes]
        self._drop = -height
        self.unknowns = len(free)

    def press(self, tool: Tool, travel_m: float) -> float:
        """Return the force [N] of a frictionless press to a travel past geometric touch."""
        push, _ = balance(self._compliance, travel_m - self._drop - tool.height(self._along, self._across))
        return 4 * float(push.sum())


def graded(fine_m: float, fine_to_m: float, end_m: float) -> Array:
    """Return coordinates (n,) from 0 to ``end_m``: steps of at most ``fine_m`` to ``fine_to_m``, then larger."""
    points = list(np.linspace(0.0, min(fine_to_m, end_m), max(1, int(np.ceil(min(fine_to_m, end_m) / fine_m))) + 1))
    step, rest = fine_m, []
    while points[-1] + sum(rest) < end_m - 1e-12:
        step *= GROWTH
        rest.append(step)
    scale = (end_m - points[-1]) / sum(rest) if rest else 1.0
    return np.r_[points, points[-1] + scale * np.cumsum(rest)]


def _depths(medium: Medium, side_m: float) -> Array:
    skin, thickness = medium.skin.thickness_m, medium.ground.thickness_m
    below = skin + graded(side_m, side_m, thickness - skin)
    return np.r_[0.0, below] if skin else below


def _bent(mesh: Any, radius_m: float | None) -> Any:
    """Return the mesh with its second coordinate bent around a limb whose top is at the origin."""
    if radius_m is None:
        return mesh
    along, arc, height = mesh.doflocs
    angle, distance = arc / radius_m, radius_m + height
    return skfem.MeshHex2(np.stack([along, distance * np.sin(angle), distance * np.cos(angle) - radius_m]), mesh.t)


def _stiffness(basis: Any, modulus_pa: Array, poisson: float) -> csc_matrix:
    """Return the stiffness matrix for three displacements at each node of a scalar basis."""
    first = modulus_pa * poisson / ((1 + poisson) * (1 - 2 * poisson))
    second = modulus_pa / (2 * (1 + poisson))
    reduced = skfem.Basis(basis.mesh, basis.elem, intorder=3)
    volume, shear = (_products(each) for each in (reduced, basis))
    swapped, along = shear.transpose(0, 1, 4, 3, 2), np.trace(shear, axis1=2, axis2=4)
    blocks = first[:, None, None, None, None] * volume + second[:, None, None, None, None] * swapped
    for axis in range(3):
        blocks[:, :, axis, :, axis] += second[:, None, None] * along
    dofs = 3 * basis.element_dofs.T[:, :, None] + np.arange(3)
    shape = blocks.shape
    rows = np.broadcast_to(dofs[:, :, :, None, None], shape)
    columns = np.broadcast_to(dofs[:, None, None], shape)
    return csc_matrix((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=(3 * basis.N, 3 * basis.N))


def _products(basis: Any) -> Array:
    """Return (elements, i, a, j, b): integrals of the derivatives of function i along a times j along b."""
    slopes = np.stack([np.asarray(function[0].grad) for function in basis.basis])
    weighted = np.einsum("iaeq,eq->eiaq", slopes, np.sqrt(basis.dx))
    count, functions = weighted.shape[:2]
    flat = weighted.reshape(count, 3 * functions, -1)
    return (flat @ flat.transpose(0, 2, 1)).reshape(count, functions, 3, functions, 3)


SOLVED_M = np.r_[np.linspace(0.0, 0.001, 11), np.linspace(0.00125, 0.002, 4), np.linspace(0.0024, TRAVEL_M, 10)]
"""Travels past geometric touch at which a press is solved; between them, the force is interpolated."""
CURVE_M = np.linspace(0.0, TRAVEL_M, 241)
PATCHES, FINEST_M, COARSEST_M = 18, 0.00045, 0.0010
"""Number of patches over a tool's reach, and bounds of their side. If a test halves the side, forces change by at most
1 %."""
GLIDING_M = 0.0012
"""Side of the patches under a gliding tool, which needs many more of them."""
MARGIN = 1.05
FIRST_GUESS_PA = 15e3
MATCHED, MOST_SOLVES = 0.001, 15


class Sample:
    """A medium in which presses are solved; kernels are computed once for each size of patch."""

    def __init__(self, medium: Medium, *, refined: float = 1.0) -> None:
        """``refined``: how many times finer the patches are than usual."""
        self.medium, self._refined = medium, refined
        self._kernels: dict[float, Kernel] = {}

    @cached_property
    def _spectrum(self) -> Spectrum:
        return Spectrum(self.medium, finest(FINEST_M / self._refined))

    def press(self, tool: Tool, travels_m: ArrayLike) -> Array:
        """Return the force (n,) [N] of a frictionless press at increasing travels past geometric touch."""
        surface = self._under(tool)
        joint, active, forces = surface.compliance((PRESS,), (PRESS,)), None, []
        for travel in np.asarray(travels_m):
            push, active = balance(joint, surface.gap(tool, float(travel)), active)
            forces.append(surface.count * push.sum())
            active = active if active.any() else None
        return np.array(forces)

    def curve(self, tool: Tool) -> Curve:
        force = PchipInterpolator(SOLVED_M, self.press(tool, SOLVED_M))(CURVE_M)
        return Curve(presses=((CURVE_M, force),))

    def dimple(self, tool: Tool, travel_m: float) -> tuple[Array, Array]:
        """Return the share of the travel by which the surface moves along it at RINGS_M, and by which it sinks around
        the limb (``Answer``)."""
        surface = self._under(tool)
        push, _ = balance(surface.compliance((PRESS,), (PRESS,)), surface.gap(tool, travel_m))
        places, inward, sunk = surface.everywhere(push)
        return rings(places, inward) / travel_m, rings(places, sunk, beside=True) / travel_m

    def drag(self, tool: Tool, travel_m: float, friction: float) -> Drag:
        step = GLIDING_M / self._refined
        radius, reach = self.medium.ground.limb_radius_m, MARGIN * tool.reach_m(travel_m) + 2 * step
        stiffness, contact = stuck_stiffness(around(self._kernel(step), radius, reach, glides=True), tool, travel_m)
        way = around(self._kernel(step), radius, reach, glides=True, ahead_m=float(WAYS_M[-1]))
        found = glide(way, tool, travel_m, WAYS_M, friction)
        return Drag(
            way_m=WAYS_M, force_n=found.tangential_n, normal_n=found.normal_n, stuck_n_m=stiffness,
            contact_radius_m=contact,
        )  # fmt: skip

    def _under(self, tool: Tool) -> Surface:
        reach = tool.reach_m(TRAVEL_M)
        step = float(np.clip(reach / PATCHES, FINEST_M, COARSEST_M)) / self._refined
        return around(self._kernel(step), self.medium.ground.limb_radius_m, MARGIN * reach + 2 * step)

    def _kernel(self, step_m: float) -> Kernel:
        if step_m not in self._kernels:
            self._kernels[step_m] = Kernel(self._spectrum, step_m)
        return self._kernels[step_m]


def answer(case: Case, skin: Skin) -> Answer:
    """Return how the case's ground with this skin responds, with the tissue's modulus fitted to the reference's middle
    curve.

    Raises CarecontactError if no modulus fits.
    """
    found = matched(case, skin)
    curves = {name: found.curve(tool) for name, tool in case.tools().items()}
    drags = {
        tool.name: found.drag(tool, curves[tool.name].touch_m() + float(DEPTHS_M[-1]), FRICTION)
        for tool in case.gliding()
    }
    dimple, beside = found.dimple(case.main, MATCHED_M)
    return Answer(curves=curves, dimple=dimple, beside=beside, drags=drags, modulus_pa=found.medium.tissue_pa)


def sample(case: Case, skin: Skin, answered: Answer) -> Sample:
    """Return the medium of an answer, to compute more of it."""
    return Sample(Medium(ground=case.ground, skin=skin, tissue_pa=answered.modulus_pa))


def matched(case: Case, skin: Skin) -> Sample:
    """Return the medium whose tissue gives the reference's force at MATCHED_M past touch.

    It uses the secant method on the logarithms of modulus and force. Raises CarecontactError if it finds none.
    """
    wanted = float(np.interp(MATCHED_M, case.reference.depth_m, case.reference.force_n))
    modulus, power, last = FIRST_GUESS_PA, 0.6, None
    for _ in range(MOST_SOLVES):
        tried = Sample(Medium(ground=case.ground, skin=skin, tissue_pa=modulus))
        off = float(np.log(tried.curve(case.main).at(np.array([MATCHED_M]))[0] / wanted))
        if abs(off) < MATCHED:
            return tried
        if last is not None:
            power = (off - last[1]) / (np.log(modulus) - last[0])
        last = float(np.log(modulus)), off
        modulus *= float(np.exp(np.clip(-off / power, -2.0, 2.0)))
    raise CarecontactError(
        f"finite elements: no modulus of the {case.region}'s tissue gives {wanted:.2f} N under a skin of "
        f"{1000 * skin.thickness_m:.1f} mm and {skin.modulus_pa / 1e6:.2f} MPa"
    )
