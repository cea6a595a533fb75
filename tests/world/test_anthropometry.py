from __future__ import annotations

import numpy as np
import pytest

from carecontact.world.human.anthropometry import DE_LEVA, segment_ends, segment_inertias
from carecontact.world.human.body import Body

PAIRED = {"upper_arm", "forearm", "hand", "thigh", "shank", "foot"}


@pytest.mark.parametrize("sex", ["M", "F"])
def test_published_mass_fractions_sum_to_the_whole(sex: str) -> None:
    total = sum(row.mass * (2 if kind in PAIRED else 1) for kind, row in DE_LEVA[sex].items())
    # The table gives two decimals of a percent.
    assert total == pytest.approx(1.0, abs=2e-4)


@pytest.mark.parametrize(
    ("sex", "segment", "mass", "centre", "gyration"),
    [
        ("M", "forearm", 0.0162, 0.4574, (0.276, 0.265, 0.121)),
        ("F", "forearm", 0.0138, 0.4559, (0.261, 0.257, 0.094)),
        ("M", "upper_arm", 0.0271, 0.5772, (0.285, 0.269, 0.158)),
        ("F", "abdomen", 0.1465, 0.4512, (0.433, 0.354, 0.415)),
        ("M", "shank", 0.0433, 0.4395, (0.251, 0.246, 0.102)),
    ],
)
def test_rows_of_the_table(
    sex: str, segment: str, mass: float, centre: float, gyration: tuple[float, float, float]
) -> None:
    row = DE_LEVA[sex][segment]
    assert (row.mass, row.centre) == pytest.approx((mass, centre))
    assert row.gyration == pytest.approx(gyration)


def test_segment_masses_sum_to_the_bodys(body: Body) -> None:
    inertias = segment_inertias(body)
    assert set(inertias) == set(body.segments)
    assert sum(row.mass_kg for row in inertias.values()) == pytest.approx(body.mass_kg, rel=1e-12)
    assert min(row.mass_kg for row in inertias.values()) > 0.1


def test_shares_of_neck_and_clavicles_come_off_head_and_chest(body: Body) -> None:
    mass = {s: row.mass_kg for s, row in segment_inertias(body).items()}
    table, whole = DE_LEVA[body.sex], body.mass_kg
    assert mass["head"] + mass["neck"] == pytest.approx(table["head"].mass * whole, rel=1e-3)
    chest = mass["thorax"] + mass["left_clavicle"] + mass["right_clavicle"]
    assert chest == pytest.approx(table["thorax"].mass * whole, rel=1e-3)


def test_left_and_right_are_equal(body: Body) -> None:
    inertias = segment_inertias(body)
    for kind in (*PAIRED, "clavicle"):
        left, right = inertias[f"left_{kind}"], inertias[f"right_{kind}"]
        assert left.mass_kg == right.mass_kg
        np.testing.assert_allclose(left.moments_kgm2, right.moments_kgm2, rtol=0.02)
        np.testing.assert_allclose(left.centre_m * [-1, 1, 1], right.centre_m, atol=3e-3)


def test_inertias_are_those_of_real_bodies(body: Body) -> None:
    for segment, row in segment_inertias(body).items():
        np.testing.assert_allclose(row.axes.T @ row.axes, np.eye(3), atol=1e-9, err_msg=segment)
        assert np.linalg.det(row.axes) == pytest.approx(1), segment
        moments = np.sort(row.moments_kgm2)
        assert moments[0] > 0, segment
        assert moments[0] + moments[1] >= moments[2], segment


def test_centre_of_mass_lies_inside_the_segment(body: Body) -> None:
    for segment, row in segment_inertias(body).items():
        if segment.endswith("clavicle") or segment == "neck":
            continue
        first, second = segment_ends(body, segment)
        along = second - first
        share = (row.centre_m - first) @ along / (along @ along)
        assert share == pytest.approx(
            DE_LEVA[body.sex][segment.split("_", 1)[-1] if "_" in segment else segment].centre
        )
        # Longitudinal column along the segment; a limb is hardest to turn about the other two.
        assert abs(row.axes[:, 2] @ along) == pytest.approx(np.linalg.norm(along))
        if segment.split("_", 1)[-1] in PAIRED:
            assert row.moments_kgm2.argmin() == 2, segment


def test_sagittal_axis_points_front_to_back(body: Body) -> None:
    """The first column turns the trunk and a hanging limb forward, the second sideways."""
    inertias = segment_inertias(body)
    for segment in ("thorax", "pelvis", "left_thigh", "right_shank"):
        axes = np.abs(inertias[segment].axes)
        assert axes[0, 0] > 0.9, segment
        assert axes[1, 1] > 0.9, segment


def test_whole_body_centre_of_mass_is_near_the_navel(body: Body) -> None:
    """Standing adults: 53 to 60 % of stature above the soles, and on the mid-line."""
    inertias = segment_inertias(body)
    centre = sum(row.mass_kg * row.centre_m for row in inertias.values()) / body.mass_kg
    height = (centre[2] - body.vertices[:, 2].min()) / np.ptp(body.vertices[:, 2])
    assert 0.53 < height < 0.60
    assert abs(centre[0]) < 2e-3
