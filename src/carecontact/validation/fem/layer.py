"""A flat layer of tissue with skin, bonded to bone and pressed along its axis of symmetry."""

from __future__ import annotations

import numpy as np

from carecontact.validation.fem.elastic import Reach, components, skfem, solve, stiffness
from carecontact.validation.fem.surface import Surface, graded

FINE_M = 0.0005
"""Side of the elements under the indenter; half of it changes the forces of the compared indenters by 0.7 % at
most, at 1 mm, and 0.2 % at 4 mm; a test holds 1 %."""
WIDTHS = 5.0
"""Radius of the layer in thicknesses: a bonded layer forgets a load within about two."""


def layer(
    *,
    thickness_m: float,
    poisson: float,
    skin_m: float = 0.0,
    skin_ratio: float = 1.0,
    reach_m: float = 0.03,
    fine_m: float = FINE_M,
    radius_m: float | None = None,
) -> Surface:
    """The surface of a layer whose tissue has a Young's modulus of 1 Pa (``scaled`` gives others).

    Args:
        skin_m: thickness of the skin, which is the top of ``thickness_m``; 0: none.
        skin_ratio: Young's modulus of the skin over that of the tissue.
        reach_m: farthest distance from the axis at which the indenter can touch.
        radius_m: of the layer; its side is free. Default: WIDTHS thicknesses.
    """
    radius = radius_m or max(WIDTHS * thickness_m, 3 * reach_m)
    r = graded(fine_m, reach_m, radius)
    skin = np.linspace(0.0, skin_m, max(2, int(np.ceil(skin_m / fine_m))) + 1)[1:] if skin_m else np.empty(0)
    below = thickness_m - skin_m
    z = -np.r_[0.0, skin, skin_m + graded(fine_m, min(reach_m / 2, below / 3), below)[1:]]
    mesh = skfem.MeshQuad.init_tensor(r, z[::-1])
    depth = -mesh.p[1][mesh.t].mean(0)
    modulus = np.where(depth < skin_m, skin_ratio, 1.0)
    basis, matrix = stiffness(mesh, skfem.ElementVector(skfem.ElementQuad2()), modulus, poisson)
    axis, x = components(basis), basis.doflocs
    fixed = (x[1] < -thickness_m + 1e-9) | ((x[0] < 1e-9) & (axis == 0))
    top = mesh.facets_satisfying(lambda x: x[1] > -1e-9)
    reach = Reach(basis, top, reach_m)
    inward, radial = -reach.pushes(1), reach.pushes(0)
    moved, slid = np.split(solve(matrix, fixed, np.c_[inward, radial]), 2, axis=1)
    outline = np.flatnonzero((x[1] > -1e-9) & (axis == 1))
    outline = outline[np.argsort(x[0, outline])]
    return Surface(
        normal=inward.T @ moved, cross=inward.T @ slid, radial=radial.T @ slid, distance_m=reach.distance_m,
        mean=reach.mean, mean_distance_m=reach.points_m,
        outline_m=x[0, outline], outline=-moved[outline],
    )  # fmt: skip
