"""The finite elements against closed forms of contact mechanics."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.sim.bench import Indenter
from carecontact.validation.fem.contact import press, press_sticking
from carecontact.validation.fem.layer import FINE_M, layer
from carecontact.validation.fem.profiles import Profile, profile
from carecontact.validation.fem.surface import Surface
from carecontact.validation.result import Array

DISC_M = 0.01


def sharp_disc(radius_m: float) -> Profile:
    return lambda r: np.where(r <= radius_m, 0.0, 1.0)


def paraboloid(radius_m: float) -> Profile:
    return lambda r: r**2 / (2 * radius_m)


@pytest.fixture(scope="module")
def half_space() -> Surface:
    """A layer a hundred times thicker than the contact is wide, of modulus 1 Pa and Poisson's ratio 0.3."""
    return layer(thickness_m=1.0, radius_m=1.0, poisson=0.3, reach_m=0.012, fine_m=0.0005)


def test_a_ball_on_a_half_space_follows_hertz(half_space: Surface) -> None:
    radius, depths = 0.05, np.array([0.0005, 0.001, 0.002])
    force = [press(half_space, paraboloid(radius), float(d)).force_n for d in depths]
    hertz = 4 / 3 / (1 - 0.3**2) * np.sqrt(radius) * depths**1.5
    np.testing.assert_allclose(force, hertz, rtol=0.015)


def test_the_contact_of_a_ball_is_as_wide_as_hertz_says(half_space: Surface) -> None:
    contact = press(half_space, paraboloid(0.05), 0.001)
    assert contact.radius_m == pytest.approx(np.sqrt(0.05 * 0.001), abs=0.0005)


def test_a_sharp_disc_on_a_half_space_follows_sneddon(half_space: Surface) -> None:
    """A sharp edge falls between two nodes: the error is in proportion to the mesh, and two meshes take it away.
    What is left is the ground below, about 100 radii deep."""
    coarse = layer(thickness_m=1.0, radius_m=1.0, poisson=0.3, reach_m=0.012, fine_m=0.001)
    far, near = (press(surface, sharp_disc(DISC_M), 0.001).force_n for surface in (coarse, half_space))
    exact = 2 * DISC_M * 0.001 / (1 - 0.3**2)
    assert near == pytest.approx(exact, rel=0.02)
    assert 2 * near - far == pytest.approx(exact, rel=0.01)


def test_the_surface_about_a_disc_sinks_as_sneddon_says(half_space: Surface) -> None:
    contact = press(half_space, sharp_disc(DISC_M), 0.001)
    r = np.array([0.012, 0.015, 0.02, 0.03])
    sunk = np.interp(r, half_space.outline_m, half_space.dimple(contact.nodal_n))
    np.testing.assert_allclose(sunk, 0.001 * 2 / np.pi * np.arcsin(DISC_M / r), rtol=0.06)


def test_a_disc_that_sticks_follows_mossakovskii(half_space: Surface) -> None:
    """F = 4 G a d ln(3 - 4 nu) / (1 - 2 nu): the disc glued to the half-space."""
    shear = 1 / (2 * 1.3)
    force = press_sticking(half_space, sharp_disc(DISC_M), np.array([0.001]))[-1].force_n
    assert force == pytest.approx(4 * shear * DISC_M * 0.001 * np.log(3 - 4 * 0.3) / (1 - 2 * 0.3), rel=0.015)


def test_a_ball_that_sticks_follows_spence(half_space: Surface) -> None:
    """Spence's ball without slip is stiffer than Hertz's by (1 - nu) ln(3 - 4 nu) / (1 - 2 nu), nearly; 2.9 % here."""
    shape = paraboloid(0.05)
    stuck = press_sticking(half_space, shape, np.linspace(0.0, 0.002, 17)[1:])[-1].force_n
    gain = 0.7 * np.log(3 - 4 * 0.3) / (1 - 2 * 0.3)
    assert stuck / press(half_space, shape, 0.002).force_n == pytest.approx(gain, abs=0.01)


def test_a_ball_on_a_bonded_layer_follows_dimitriadis() -> None:
    """Dimitriadis et al. 2002, Biophys J 82:2798: an incompressible layer bonded to rigid ground."""
    thickness, radius = 0.05, 0.01
    surface = layer(thickness_m=thickness, poisson=0.499, reach_m=0.012)
    for depth in (0.0005, 0.002):
        x = np.sqrt(radius * depth) / thickness
        series = 1 + 1.133 * x + 1.283 * x**2 + 0.769 * x**3 + 0.0975 * x**4
        exact = 16 / 9 * np.sqrt(radius) * depth**1.5 * series
        assert press(surface, paraboloid(radius), depth).force_n == pytest.approx(exact, rel=0.01)


def thin(disc_m: float, poisson: float) -> Surface:
    return layer(thickness_m=0.001, poisson=poisson, fine_m=0.0002, reach_m=disc_m + 0.002, radius_m=disc_m + 0.01)


def test_a_thin_compressible_layer_is_a_bed_of_springs() -> None:
    """Winkler's: pressure = (1 - nu) E d / ((1 + nu) (1 - 2 nu) h) under a disc (Johnson 1985, section 5.8)."""
    poisson, disc, depth = 0.3, 0.02, 1e-5
    pressure = (1 - poisson) / ((1 + poisson) * (1 - 2 * poisson)) * depth / 0.001
    force = press(thin(disc, poisson), sharp_disc(disc), depth).force_n
    assert force == pytest.approx(pressure * np.pi * disc**2, rel=0.02)


def fourth_root_beyond(pick: str) -> Array:
    """(2,) fourth root of force over lubrication's force, of discs of 10 and 20 thicknesses."""
    found = []
    for disc in (0.01, 0.02):
        surface, shape, depth = thin(disc, 0.49999), sharp_disc(disc), 1e-5
        if pick == "sliding":
            force, exact = press(surface, shape, depth).force_n, np.pi * disc**4 * depth / (8 * 0.001**3)
        else:
            force = press_sticking(surface, shape, np.array([depth]))[-1].force_n
            exact = np.pi * disc**4 * depth / (2 * 0.001**3)
        found.append((force / exact) ** 0.25)
    return np.array(found)


@pytest.mark.parametrize("pick", ["sliding", "sticking"])
def test_a_thin_incompressible_layer_flows_as_in_lubrication(pick: str) -> None:
    """Johnson 1985, section 5.8: F = pi E a^4 d / (8 h^3) for a disc that slides, and four times that where it sticks.
    Beside a disc, the layer resists over about a thickness more: the excess in a is in proportion to h / a."""
    ten, twenty = fourth_root_beyond(pick)
    assert 2 * twenty - ten == pytest.approx(1.0, abs=0.025)


def test_a_finer_mesh_gives_the_same_force() -> None:
    skin = {"thickness_m": 0.018, "poisson": 0.49, "skin_m": 0.0015, "skin_ratio": 30.0, "reach_m": 0.014}
    coarse, fine = layer(**skin), layer(fine_m=FINE_M / 2, **skin)
    for indenter in (
        Indenter(shape="hemisphere", size_m=0.01), Indenter(shape="flat", size_m=0.0107), Indenter(shape="cap"),
    ):  # fmt: skip
        for depth in (0.001, 0.004):
            shape = profile(indenter)
            assert press(coarse, shape, depth).force_n == pytest.approx(press(fine, shape, depth).force_n, rel=0.01)


def test_a_skin_as_soft_as_the_tissue_changes_nothing() -> None:
    same = {"thickness_m": 0.03, "poisson": 0.45, "reach_m": 0.012}
    force = [
        press(layer(skin_m=skin, skin_ratio=1.0, **same), paraboloid(0.01), 0.002).force_n for skin in (0.0, 0.0015)
    ]
    assert force[0] == pytest.approx(force[1], rel=0.005)


def test_a_stiff_skin_makes_the_force_depend_less_on_the_balls_size() -> None:
    exponent = []
    for ratio in (1.0, 30.0):
        surface = layer(thickness_m=0.05, poisson=0.49, skin_m=0.0015, skin_ratio=ratio, reach_m=0.016)
        force = [press(surface, paraboloid(r), 0.004).force_n for r in (0.005, 0.02)]
        exponent.append(np.log(force[1] / force[0]) / np.log(4))
    assert exponent[1] < exponent[0] - 0.1
