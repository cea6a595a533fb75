from __future__ import annotations

import numpy as np
import pytest

from carecontact.validation.fem.ground import Ground, Medium
from carecontact.validation.fem.kernel import Kernel, Spectrum, finest
from carecontact.validation.fem.materials import MIDDLE
from carecontact.validation.fem.waves import surface_compliance

STEP_M = 0.002


@pytest.fixture(scope="module", params=[None, 0.034])
def spectrum(request) -> Spectrum:
    ground = Ground(thickness_m=0.018, limb_radius_m=request.param)
    return Spectrum(Medium(ground=ground, skin=MIDDLE, tissue_pa=1.5e4), finest(STEP_M))


def test_between_its_waves_a_spectrum_is_interpolated_well(spectrum: Spectrum) -> None:
    rng = np.random.default_rng(1)
    q, k = 10 ** rng.uniform(0.5, 3.4, (2, 60))
    exact = surface_compliance(spectrum.medium, q, k)
    for a in range(3):
        for b in range(3):
            found = [spectrum(np.array([one]), np.array([two]), a, b)[0, 0] for one, two in zip(q, k, strict=True)]
            scale = np.sqrt(exact[:, a, a] * exact[:, b, b])
            np.testing.assert_allclose(found / scale, exact[:, a, b] / scale, atol=2e-3)


def test_a_force_here_moves_there_as_a_force_there_moves_here(spectrum: Spectrum) -> None:
    kernel = Kernel(spectrum, STEP_M)
    for a in range(3):
        for b in range(3):
            back = np.roll(kernel.values(b, a)[::-1, ::-1], (1, 1), (0, 1))
            scale = kernel.values(a, a)[0, 0]
            np.testing.assert_allclose(kernel.values(a, b) / scale, back / scale, atol=1e-9)


def test_a_push_moves_the_surface_beside_it_away_or_towards_it_alike_on_both_sides(spectrum: Spectrum) -> None:
    kernel = Kernel(spectrum, STEP_M)
    along = kernel.values(2, 0)[0]
    np.testing.assert_allclose(along[1:6], -along[-1:-6:-1], atol=1e-9 * abs(along).max())
    assert abs(along[1:6]).max() > 0
