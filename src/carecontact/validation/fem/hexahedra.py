"""The same presses by quadratic hexahedra in three dimensions, as a second method for the same equations, without
Fourier series. It is too slow for the whole table. A quarter of the ground is meshed, with symmetry on two sides.

Quadratic elements work for Poisson's ratios up to 0.49, at which linear ones lock; the energy of volume change is
integrated with two points along each side.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from carecontact.errors import DependencyError
from carecontact.validation.fem.contact import balance
from carecontact.validation.fem.ground import Medium
from carecontact.validation.fem.tools import Tool
from carecontact.validation.result import Array

NEEDS = "carecontact validate --fem needs scikit-fem: pip install 'carecontact[fem]'"

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


def graded(fine_m: float, fine_to_m: float, end_m: float, growth: float = GROWTH) -> Array:
    """Return coordinates (n,) from 0 to ``end_m``: steps of at most ``fine_m`` up to ``fine_to_m``, then growing
    ones.
    """
    points = list(np.linspace(0.0, min(fine_to_m, end_m), max(1, int(np.ceil(min(fine_to_m, end_m) / fine_m))) + 1))
    step, rest = fine_m, []
    while points[-1] + sum(rest) < end_m - 1e-12:
        step *= growth
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
    """Return (elements, i, a, j, b): the integral of the derivative of function i along a times that of function j
    along b.
    """
    slopes = np.stack([np.asarray(function[0].grad) for function in basis.basis])
    weighted = np.einsum("iaeq,eq->eiaq", slopes, np.sqrt(basis.dx))
    count, functions = weighted.shape[:2]
    flat = weighted.reshape(count, 3 * functions, -1)
    return (flat @ flat.transpose(0, 2, 1)).reshape(count, functions, 3, functions, 3)
