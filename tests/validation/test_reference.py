"""The table against the published secants that it was entered from."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.protocols.tissue_sets import shipped_tissue_sets
from carecontact.validation.calibration_residual import held_out_m
from carecontact.validation.reference import (
    ABDOMEN,
    FITTED,
    FOREARM,
    FOREARM_POSTERIOR,
    REFERENCES,
    UPPER_ARM_ANTERIOR,
    UPPER_ARM_POSTERIOR,
)


@pytest.mark.parametrize(
    ("reference", "depth_mm", "secant", "band"),
    [(FOREARM, 4.487, 1.190, (0.7445, 2.1519)), (FOREARM_POSTERIOR, 4.207, 1.469, (0.8053, 2.7353)),
     (UPPER_ARM_ANTERIOR, 8.163, 0.6445, (0.4341, 1.4601)),
     (UPPER_ARM_POSTERIOR, 7.951, 0.797, (0.3890, 1.3969))],
)  # fmt: skip
def test_limb_curves_end_at_the_measured_secants(reference, depth_mm: float, secant: float, band) -> None:
    depth = 1000 * reference.depth_m[-1]
    assert depth == pytest.approx(depth_mm, rel=1e-6)
    assert reference.force_n[-1] / depth == pytest.approx(secant, rel=0.002)
    assert [reference.low_n[-1] / depth, reference.high_n[-1] / depth] == pytest.approx(list(band), rel=0.002)


def test_abdomen_is_the_published_polynomial() -> None:
    depth = 1000 * ABDOMEN.depth_m
    np.testing.assert_allclose(ABDOMEN.force_n, 0.1665 * depth + 0.00873 * depth**2, atol=0.12)


@pytest.mark.parametrize("reference", REFERENCES, ids=lambda r: r.name)
def test_curves_rise_inside_their_band(reference) -> None:
    assert (np.diff(reference.depth_m) > 0).all()
    assert (np.diff(reference.force_n) > 0).all()
    assert (reference.low_n <= reference.force_n).all()
    assert (reference.force_n <= reference.high_n).all()
    assert len(held_out_m(reference.region)) >= 3


def test_what_a_set_was_fitted_to_is_known_and_the_set_shipped() -> None:
    assert set(FITTED) < set(shipped_tissue_sets())
    names = {reference.name for reference in REFERENCES}
    assert len(names) == len(REFERENCES)
    for fitted in FITTED.values():
        assert {reference.name for reference in fitted} < names
