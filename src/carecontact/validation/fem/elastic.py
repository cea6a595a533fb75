"""Linear axisymmetric elasticity by finite elements, condensed to the surface that an indenter can reach.

Strains are small and moduli constant. Quadratic elements with selective reduced integration carry nearly
incompressible tissue without locking: the volume's part of the energy is integrated with two points along each side,
and shear exactly (Malkus and Hughes 1978, Comput Methods Appl Mech Eng 15:63).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import splu

from carecontact.errors import DependencyError
from carecontact.validation.result import Array

NEEDS = "carecontact validate --fem needs scikit-fem: pip install 'carecontact[fem]'"

try:
    import skfem
    from skfem.helpers import ddot, grad, sym_grad, trace
except ModuleNotFoundError:
    raise DependencyError(NEEDS) from None


def stiffness(mesh: Any, element: Any, modulus_pa: Array, poisson: float) -> tuple[Any, Any]:
    """The basis of the displacements and its stiffness matrix, of the whole circle.

    Args:
        mesh: in (r, z) [m].
        element: vectorial, quadratic.
        modulus_pa: (e,) Young's modulus of each element.
    """
    full, reduced = (skfem.Basis(mesh, element, intorder=order) for order in (4, 3))
    modulus = modulus_pa[:, None]
    first = modulus * poisson / ((1 + poisson) * (1 - 2 * poisson))
    second = modulus / (2 * (1 + poisson))

    @skfem.BilinearForm
    def shear(u: Any, v: Any, w: Any) -> Any:
        r = w.x[0]
        return 4 * np.pi * r * second * (ddot(sym_grad(u), sym_grad(v)) + u[0] * v[0] / r**2)

    @skfem.BilinearForm
    def volume(u: Any, v: Any, w: Any) -> Any:
        r = w.x[0]
        return 2 * np.pi * r * first * (trace(grad(u)) + u[0] / r) * (trace(grad(v)) + v[0] / r)

    return full, (shear.assemble(full) + volume.assemble(reduced)).tocsc()


class Reach:
    """Hat functions on the reachable part of the surface, and the displacements that they push.

    Args:
        basis: of the displacements.
        facets: of the surface.
        reach_m: distance from the axis beyond which nodes cannot come into contact.
    """

    def __init__(self, basis: Any, facets: Any, reach_m: float) -> None:
        self._moves = skfem.FacetBasis(basis.mesh, basis.elem, facets=facets, intorder=4)
        self._hats = skfem.FacetBasis(basis.mesh, skfem.ElementQuad1(), facets=facets, intorder=4)
        on = np.unique(self._hats.get_dofs(facets).all())
        on = on[self._hats.doflocs[0, on] < reach_m]
        self.nodes = on[np.argsort(self._hats.doflocs[0, on])]
        self.distance_m = self._hats.doflocs[0, self.nodes]
        weights, points = self._weights()
        self.area = np.asarray(weights.sum(axis=1)).ravel()
        used = np.asarray(weights.sum(axis=0)).ravel() > 0
        self.mean = csr_matrix(weights[:, used].multiply(1 / self.area[:, None]))
        self.points_m = points[used]

    def pushes(self, component: int) -> Array:
        """(dofs, m) load of a unit force spread over each node's hat, along r (0) or z (1)."""

        @skfem.BilinearForm
        def along(u: Any, p: Any, w: Any) -> Any:
            return 2 * np.pi * w.x[0] * u[component] * p

        loads = along.assemble(self._moves, self._hats)
        return (loads[self.nodes].toarray() / self.area[:, None]).T

    def _weights(self) -> tuple[csr_matrix, Array]:
        """(m, q) integrals of the hats at the facets' quadrature points, and (q,) the radius of those."""
        radius = np.asarray(self._hats.global_coordinates())[0]
        measure = self._hats.dx * 2 * np.pi * radius
        index = np.arange(measure.size).reshape(measure.shape)
        rows, columns, values = [], [], []
        for k, dofs in enumerate(self._hats.element_dofs):
            rows.append(np.repeat(dofs, measure.shape[1]))
            columns.append(index.ravel())
            values.append((np.asarray(self._hats.basis[k][0]) * measure).ravel())
        place = np.concatenate(rows), np.concatenate(columns)
        whole = csr_matrix((np.concatenate(values), place), shape=(self._hats.N, measure.size))
        return csr_matrix(whole[self.nodes]), radius.ravel()


def solve(matrix: Any, fixed: npt.NDArray[np.bool_], loads: Array) -> Array:
    """(dofs, m) displacements under (dofs, m) loads with the dofs of the mask ``fixed`` held."""
    free = np.flatnonzero(~fixed)
    out = np.zeros_like(loads)
    # Minimum degree on A^T + A: these matrices are symmetric, and the default fills several times as much.
    factors = splu(matrix[free][:, free], permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    out[free] = factors.solve(np.ascontiguousarray(loads[free]))
    return out


def components(basis: Any) -> Array:
    """(dofs,) axis of each displacement: 0 along r, 1 along z."""
    axis = np.zeros(basis.N, int)
    for dofs in (basis.nodal_dofs, basis.facet_dofs, basis.interior_dofs):
        axis[dofs[1]] = 1
    return axis
