"""The finite elements against closed forms of contact mechanics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from carecontact.validation.fem.contact import balance
from carecontact.validation.fem.glide import glide, stuck_stiffness
from carecontact.validation.fem.ground import Ground, Medium
from carecontact.validation.fem.kernel import Kernel, Spectrum, finest
from carecontact.validation.fem.materials import PLAIN, Skin
from carecontact.validation.fem.surface import PRESS, Surface, around
from carecontact.validation.fem.tools import Tool
from carecontact.validation.result import Array

DEEP_M = 0.15
"""Thickness of the ground that stands for a half-space; contacts are 2 to 4 mm wide."""


@dataclass(frozen=True, kw_only=True)
class Paraboloid(Tool):
    """With ``semi_axes_m[0]`` as the radius of curvature."""

    def height(self, along_m: Array, across_m: Array) -> Array:
        return (along_m**2 + across_m**2) / (2 * self.semi_axes_m[0])


@dataclass(frozen=True, kw_only=True)
class Sharp(Tool):
    """A disc without rounding."""

    def height(self, along_m: Array, across_m: Array) -> Array:
        return np.where(np.hypot(along_m, across_m) <= self.semi_axes_m[0], 0.0, 0.1)


def paraboloid(radius_m: float) -> Tool:
    return Paraboloid(name="", shape="ellipsoid", semi_axes_m=(radius_m,) * 3)


def sharp(radius_m: float) -> Tool:
    return Sharp(name="", shape="disc", semi_axes_m=(radius_m,) * 3)


def kernel(*, thickness_m: float, poisson: float, step_m: float, period_m: float = 0.3, skin: Skin = PLAIN) -> Kernel:
    """Of a flat layer with a modulus of 1 Pa."""
    medium = Medium(ground=Ground(thickness_m=thickness_m, poisson=poisson), skin=skin, tissue_pa=1.0)
    return Kernel(Spectrum(medium, finest(step_m)), step_m, period_m=period_m)


def press(surface: Surface, tool: Tool, depth_m: float) -> tuple[float, Array]:
    push, _ = balance(surface.compliance((PRESS,), (PRESS,)), surface.gap(tool, depth_m))
    return surface.count * float(push.sum()), push


@pytest.fixture(scope="module")
def half_space() -> Surface:
    return around(kernel(thickness_m=DEEP_M, poisson=0.3, step_m=0.0003), None, 0.0055)


def test_a_ball_on_a_half_space_follows_hertz(half_space: Surface) -> None:
    radius, depths = 0.05, np.array([0.0001, 0.0002, 0.0004])
    force = [press(half_space, paraboloid(radius), float(d))[0] for d in depths]
    np.testing.assert_allclose(force, 4 / 3 / (1 - 0.3**2) * np.sqrt(radius) * depths**1.5, rtol=0.03)


def test_a_sharp_disc_on_a_half_space_follows_sneddon(half_space: Surface) -> None:
    force, push = press(half_space, sharp(0.004), 0.001)
    assert force == pytest.approx(2 * 0.004 * 0.001 / (1 - 0.3**2), rel=0.03)
    places, sunk, along_normal = half_space.everywhere(push)
    np.testing.assert_array_equal(along_normal, sunk)
    distance = np.hypot(*places.T)
    for r in (0.005, 0.007, 0.010):
        ring = sunk[np.abs(distance - r) < 0.0003].mean()
        # The ground is not endless: it holds the surface back by a share of about the contact's width over its depth.
        assert ring == pytest.approx(0.001 * 2 / np.pi * np.arcsin(0.004 / r), abs=0.00004)


def test_a_ball_on_a_bonded_layer_follows_dimitriadis() -> None:
    """Dimitriadis et al. 2002, Biophys J 82:2798: an incompressible layer bonded to rigid ground."""
    thickness, radius = 0.05, 0.01
    for depth, step in ((0.0005, 0.0002), (0.002, 0.0005)):
        surface = around(kernel(thickness_m=thickness, poisson=0.499, step_m=step), None, 1.5 * np.sqrt(radius * depth))
        x = np.sqrt(radius * depth) / thickness
        series = 1 + 1.133 * x + 1.283 * x**2 + 0.769 * x**3 + 0.0975 * x**4
        exact = 16 / 9 * np.sqrt(radius) * depth**1.5 * series
        assert press(surface, paraboloid(radius), depth)[0] == pytest.approx(exact, rel=0.01)


def test_a_thin_compressible_layer_is_a_bed_of_springs() -> None:
    """Winkler's: pressure = (1 - nu) E d / ((1 + nu) (1 - 2 nu) h) under a disc (Johnson 1985, section 5.8)."""
    poisson, disc, depth = 0.3, 0.02, 1e-5
    surface = around(kernel(thickness_m=0.001, poisson=poisson, step_m=0.0007, period_m=0.08), None, disc + 0.002)
    pressure = (1 - poisson) / ((1 + poisson) * (1 - 2 * poisson)) * depth / 0.001
    assert press(surface, sharp(disc), depth)[0] == pytest.approx(pressure * np.pi * disc**2, rel=0.03)


def test_a_stiff_skin_makes_the_force_depend_less_on_the_balls_size() -> None:
    exponent = []
    for skin in (PLAIN, Skin(name="", thickness_m=0.0015, modulus_pa=30.0)):
        surface = around(kernel(thickness_m=0.05, poisson=0.49, step_m=0.001, skin=skin), None, 0.014)
        force = [press(surface, paraboloid(r), 0.004)[0] for r in (0.005, 0.02)]
        exponent.append(np.log(force[1] / force[0]) / np.log(4))
    assert exponent[1] < exponent[0] - 0.1


@pytest.fixture(scope="module")
def gliding() -> Kernel:
    """Incompressible: pushes move nothing along, and Mindlin's results are exact."""
    return kernel(thickness_m=DEEP_M, poisson=0.4999, step_m=0.0005)


SHEAR = 1 / (2 * 1.4999)


def test_a_disc_glued_to_a_half_space_follows_mindlin(gliding: Kernel) -> None:
    """F = 8 G a x / (2 - nu)."""
    stiffness, radius = stuck_stiffness(around(gliding, None, 0.006, glides=True), sharp(0.004), 0.001)
    assert radius == pytest.approx(0.004, rel=0.06)
    assert stiffness == pytest.approx(8 * SHEAR * radius / (2 - 0.4999), rel=0.05)


def test_a_ball_slips_from_its_rim_inwards_as_cattaneo_and_mindlin_say(gliding: Kernel) -> None:
    """F = mu P (1 - (1 - 16 a G x / (3 mu P (2 - nu)))^(3/2)), and mu P once all of it slips."""
    tool, depth, friction, poisson = paraboloid(0.05), 0.0004, 0.5, 0.4999
    surface = around(gliding, None, 0.006, glides=True, ahead_m=0.001)
    load, width = press(surface, tool, depth)[0], np.sqrt(0.05 * depth)
    full = 3 * friction * load * (2 - poisson) / (16 * SHEAR * width)
    ways = full * np.array([0.0, 0.25, 0.5, 0.75, 1.0, 1.4])
    found = glide(surface, tool, depth, ways, friction)
    share = found.tangential_n / (friction * load)
    np.testing.assert_allclose(share, 1 - np.maximum(1 - ways / full, 0.0) ** 1.5, atol=0.03)
    np.testing.assert_allclose(found.normal_n, load, rtol=0.02)


def test_without_friction_nothing_drags(gliding: Kernel) -> None:
    surface = around(gliding, None, 0.006, glides=True, ahead_m=0.001)
    found = glide(surface, paraboloid(0.05), 0.0004, np.array([0.0, 0.0005, 0.001]), 1e-9)
    assert np.abs(found.tangential_n).max() < 1e-6 * found.normal_n.min()
