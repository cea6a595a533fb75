from __future__ import annotations

import numpy as np
import pytest

from carecontact.validation.fem.ground import Ground, Medium
from carecontact.validation.fem.materials import MIDDLE, PLAIN
from carecontact.validation.fem.waves import GROWTH, TOP_M, surface_compliance

POISSON = 0.4
FLAT = Medium(ground=Ground(thickness_m=0.05, poisson=POISSON), skin=PLAIN, tissue_pa=1e4)


def test_short_waves_meet_a_half_space() -> None:
    """Displacement by a wave of pressure is 2 (1 - nu^2) / (E k), and by shear across it 2 (1 + nu) / (E k)."""
    k = np.array([500.0, 1500.0])
    found = surface_compliance(FLAT, np.zeros(2), k) * k[:, None, None] * 1e4
    np.testing.assert_allclose(found[:, 0, 0], 2 * (1 - POISSON**2), rtol=1e-3)
    np.testing.assert_allclose(found[:, 1, 1], 2 * (1 + POISSON), rtol=1e-3)
    np.testing.assert_allclose(found[:, 2, 2], 2 * (1 - POISSON**2), rtol=1e-3)


def test_even_pressure_on_a_flat_layer_meets_the_oedometers_modulus() -> None:
    modulus = 1e4 * (1 - POISSON) / ((1 + POISSON) * (1 - 2 * POISSON))
    found = surface_compliance(FLAT, np.zeros(1), np.zeros(1))[0]
    assert found[0, 0] == pytest.approx(0.05 / modulus)
    assert found[1, 1] == pytest.approx(0.05 / (1e4 / 2 / (1 + POISSON)))


def test_even_pressure_on_a_limb_follows_lame() -> None:
    """u = A r + B / r about rigid bone: a thick tube under plane strain."""
    outer, inner = 0.034, 0.016
    medium = Medium(
        ground=Ground(thickness_m=outer - inner, limb_radius_m=outer, poisson=POISSON), skin=PLAIN, tissue_pa=1e4
    )
    first, second = 1e4 * POISSON / ((1 + POISSON) * (1 - 2 * POISSON)), 1e4 / 2 / (1 + POISSON)
    stress = 2 * (first + second) + 2 * second * inner**2 / outer**2
    exact = (outer - inner**2 / outer) / stress
    assert surface_compliance(medium, np.zeros(1), np.zeros(1))[0, 0, 0] == pytest.approx(exact, rel=1e-3)


@pytest.mark.parametrize("radius", [None, 0.034])
def test_half_the_elements_give_the_same(radius: float | None) -> None:
    medium = Medium(ground=Ground(thickness_m=0.018, limb_radius_m=radius), skin=MIDDLE, tissue_pa=1.5e4)
    q, k = (wave.ravel() for wave in np.meshgrid(*[[0.0, 30.0, 300.0, 1000.0]] * 2))
    usual = surface_compliance(medium, q, k)
    fine = surface_compliance(medium, q, k, top_m=TOP_M / 2, growth=np.sqrt(GROWTH))
    scale = np.sqrt(np.einsum("nii,njj->nij", fine, fine))
    assert (np.abs(usual - fine) < 0.005 * scale).all()


def test_a_wide_limb_is_a_flat_layer() -> None:
    q, k = np.array([0.0, 50.0, 200.0]), np.array([40.0, 0.0, 300.0])
    flat, wide = (
        surface_compliance(
            Medium(ground=Ground(thickness_m=0.018, limb_radius_m=radius), skin=MIDDLE, tissue_pa=1.5e4), q, k
        )
        for radius in (None, 50.0)
    )
    np.testing.assert_allclose(wide, flat, rtol=2e-3, atol=1e-3 * np.abs(flat).max())


def test_a_skin_of_the_tissues_own_stuff_changes_nothing() -> None:
    same = MIDDLE.__class__(name="same", thickness_m=0.0015, modulus_pa=1e4)
    q, k = np.array([0.0, 100.0]), np.array([100.0, 1000.0])
    skinned = surface_compliance(Medium(ground=FLAT.ground, skin=same, tissue_pa=1e4), q, k)
    np.testing.assert_allclose(skinned, surface_compliance(FLAT, q, k), rtol=2e-3, atol=1e-9)
