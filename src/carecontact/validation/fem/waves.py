"""Linear elasticity of a layer or a limb, wave by wave: finite elements through the thickness, Fourier series along
the surface (a semi-analytical finite element method: Zienkiewicz and Taylor 2000, The Finite Element Method, vol. 2,
chapter 9; of layers Cheung and Zienkiewicz 1965).

Ground that is uniform along its surface responds to a load that varies as a wave with displacements of the same wave.
For each wave, this leaves a problem in one variable, the depth, with three displacements: outward u,
across i v and along i w, times exp(i (k x + q y)). The i makes every equation real.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.polynomial.legendre import leggauss

from carecontact.validation.fem.ground import Medium
from carecontact.validation.result import Array

TOP_M, GROWTH = 0.0002, 1.25
"""Thickness of the element at the surface, and how much thicker each next one is. A test halves both."""
POINTS_FULL, POINTS_REDUCED = 3, 2
"""Gauss points of the energy of shear and of volume: quadratic elements with one point less for the volume carry
nearly incompressible tissue without locking (Malkus and Hughes 1978, Comput Methods Appl Mech Eng 15:63)."""
_POWERS = ((0, 0), (0, 1), (1, 0), (1, 1), (0, 2), (2, 0))
"""Powers of q and k in the stiffness of an element, which is a polynomial in both."""


def surface_compliance(medium: Medium, q: Array, k: Array, *, top_m: float = TOP_M, growth: float = GROWTH) -> Array:
    """Return displacements (n, 3, 3) [m/Pa] of the surface, (u, v, w), by tractions of the same wave.

    Args:
        q: (n,) wavenumbers across [rad/m] at the surface; on a limb, around it.
        k: (n,) wavenumbers along [rad/m].
    """
    # From the bone up, all that lies below an element is condensed to a 3 x 3 stiffness at its lower face.
    powers = np.stack([q**a * k**b for a, b in _POWERS], 1)
    below: Array | None = None
    for low, high, modulus in _elements(medium, top_m, growth):
        element = np.einsum("np,pij->nij", powers, _element(medium, low, high, modulus))
        if below is None:
            element = element[:, 3:, 3:]  # bonded to bone
        else:
            element[:, :3, :3] += below
        inner, top = slice(0, -3), slice(-3, None)
        below = element[:, top, top] - element[:, top, inner] @ np.linalg.solve(
            element[:, inner, inner], element[:, inner, top]
        )
    assert below is not None
    return np.asarray(np.linalg.inv(below), np.float64)


def _elements(medium: Medium, top_m: float, growth: float) -> list[tuple[float, float, float]]:
    """Return each element's depths [m] of its lower and upper face and its Young's modulus [Pa], from the bone up."""
    skin, thickness = medium.skin.thickness_m, medium.ground.thickness_m
    faces = [0.0]
    if skin:
        count = max(2, int(np.ceil(skin / (2 * top_m))))
        faces += list(np.linspace(0.0, skin, count + 1)[1:])
    step, rest = top_m, [faces[-1]]
    while rest[-1] < thickness:
        rest.append(rest[-1] + step)
        step *= growth
    scale = (thickness - faces[-1]) / (rest[-1] - faces[-1])
    faces += [faces[-1] + scale * (z - rest[0]) for z in rest[1:]]
    stiff = medium.skin.modulus_pa
    return [(b, t, stiff if b <= skin * (1 + 1e-9) else medium.tissue_pa)
            for t, b in itertools.pairwise(faces)][::-1]  # fmt: skip


def _element(medium: Medium, low_m: float, high_m: float, modulus: float) -> Array:
    """Return the stiffness (6, 9, 9) of a quadratic element for each of _POWERS, with three nodes from below and (u, v,
    w) at each.
    """
    poisson = medium.ground.poisson
    first = modulus * poisson / ((1 + poisson) * (1 - 2 * poisson))
    second = modulus / (2 * (1 + poisson))
    # Strains zz, yy, xx, zy, zx, xy.
    shear = second * np.diag([2.0, 2.0, 2.0, 1.0, 1.0, 1.0])
    volume = np.zeros((6, 6))
    volume[:3, :3] = first
    return _integral(medium, low_m, high_m, shear, POINTS_FULL) + _integral(
        medium, low_m, high_m, volume, POINTS_REDUCED
    )


def _integral(medium: Medium, low_m: float, high_m: float, law: Array, points: int) -> Array:
    radius = medium.ground.limb_radius_m
    half = (low_m - high_m) / 2
    total = np.zeros((6, 9, 9))
    for s, weight in zip(*leggauss(points), strict=True):
        depth = (low_m + high_m) / 2 - half * s
        value = np.array([s * (s - 1) / 2, 1 - s**2, s * (s + 1) / 2])
        slope = np.array([s - 0.5, -2 * s, s + 0.5]) / half
        # On a limb, circumferences shrink with depth, and wavelengths with them.
        share, curvature = (1.0, 0.0) if radius is None else (1 - depth / radius, 1 / (radius - depth))
        strain = _strains(value, slope, share, curvature)
        for number, (a, b) in enumerate(_POWERS):
            for one in range(3):
                for two in range(3):
                    if (one == 1) + (two == 1) == a and (one == 2) + (two == 2) == b:
                        total[number] += weight * half * share * strain[one].T @ law @ strain[two]
    return total


def _strains(value: Array, slope: Array, share: float, curvature: float) -> Array:
    """Return the strains (3, 6, 9) by nodal displacements: the constant part, the part with q and the part with k."""
    strain = np.zeros((3, 6, 9))
    u, v, w = (slice(axis, None, 3) for axis in range(3))
    around = value / share
    strain[0, 0, u] = slope
    strain[0, 1, u] = curvature * value
    strain[0, 3, v] = slope - curvature * value
    strain[0, 4, w] = slope
    strain[1, 1, v], strain[1, 3, u], strain[1, 5, w] = -around, around, -around
    strain[2, 2, w], strain[2, 4, u], strain[2, 5, v] = -value, value, -value
    return strain
