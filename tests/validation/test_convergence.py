"""What the convergence check holds the person against."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.protocols import load_protocol
from carecontact.validation.convergence import MESH_REFERENCES, RADIUS_FACTORS, TREND_DEPTH_M, TRENDS


def layer(u: np.ndarray) -> np.ndarray:
    """Surface compliance of an incompressible layer bonded to a rigid base over that of the half space, at wave number
    u per thickness (Hayes et al. 1972)."""
    u = np.minimum(u, 300.0)
    return (np.sinh(2 * u) / 2 - u) / (u**2 + 1 + np.sinh(u) ** 2)


def flat_punch(ratio: float) -> float:
    """Force over that on a half space for radius over thickness: Fredholm's equation by Gauss quadrature."""
    x, w = np.polynomial.legendre.leggauss(24)
    t, w = (x + 1) / 2, w / 2
    u = np.linspace(1e-6, 40.0, 8001)
    rest = (1 - layer(u)) * (u[1] - u[0])
    kernel = 2 / np.pi * ratio * (np.cos(np.outer(t, u) * ratio) * rest) @ np.cos(np.outer(u, t) * ratio)
    return float(w @ np.linalg.solve(np.eye(len(t)) - kernel * w, np.ones(len(t))))


def sphere(ratio: float) -> float:
    """Force over Hertz's for sqrt(radius depth) over thickness (Dimitriadis et al. 2002, bonded, incompressible)."""
    return 1 + 1.133 * ratio + 1.283 * ratio**2 + 0.769 * ratio**3 + 0.0975 * ratio**4


def exponents(thickness_m: float) -> dict[str, float]:
    out = {}
    for name, size in TRENDS.items():
        r = size.radius_m * np.array(RADIUS_FACTORS)
        if size.shape == "flat":
            force = r * [flat_punch(float(one / thickness_m)) for one in r]
        else:
            force = np.sqrt(r) * sphere(np.sqrt(r * TREND_DEPTH_M) / thickness_m)
        out[name] = float(np.polyfit(np.log(r), np.log(force), 1)[0])
    return out


def test_both_layer_solutions_begin_alike() -> None:
    """To first order both are the half space's sinking by the image of the load: 1.133 per ratio for the sphere."""
    assert (flat_punch(0.001) - 1) / 0.001 == pytest.approx(1.133, rel=0.01)


def test_known_exponents_are_those_of_layers_fifty_to_thirty_millimetres_thick() -> None:
    thick, thin = exponents(0.050), exponents(0.030)
    layers = {name: size.layer for name, size in TRENDS.items() if size.layer is not None}
    assert layers
    for name, known in layers.items():
        assert (thick[name], thin[name]) == pytest.approx(known, abs=0.01), name


def test_meshes_are_compared_on_every_soft_region() -> None:
    assert {reference.region for reference in MESH_REFERENCES} == set(load_protocol().soft_regions)
