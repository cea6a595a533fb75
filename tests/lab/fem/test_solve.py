"""The finite elements against closed forms of contact mechanics."""

from __future__ import annotations

import ast
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from carecontact.cli import main
from carecontact.errors import CarecontactError
from carecontact.lab import fem
from carecontact.lab.fem import solve
from carecontact.lab.fem.cases import (
    CAP,
    CASES,
    DEPTHS_M,
    MATCHED_M,
    MIDDLE,
    PLAIN,
    Ground,
    Medium,
    Skin,
    Tool,
    ball,
    disc,
)
from carecontact.lab.fem.solve import MARGIN, Block, Sample, balance, glide, stuck_stiffness
from carecontact.lab.fem.surface import (
    GROWTH,
    PRESS,
    TOP_M,
    Kernel,
    Spectrum,
    Surface,
    around,
    finest,
    surface_compliance,
)
from carecontact.lab.validation.result import Array

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


def test_springs_under_a_cone_push_with_their_own_gap_and_never_pull() -> None:
    push, active = balance(np.diag(1 / np.array([100.0, 200.0, 300.0])), 0.0015 - 0.001 * np.arange(3))
    np.testing.assert_allclose(push, [0.15, 0.1, 0.0])
    np.testing.assert_array_equal(active, [True, True, False])


def test_changing_one_patch_at_a_time_gives_the_same_balance(monkeypatch) -> None:
    place = np.arange(30)
    compliance = np.exp(-np.abs(place[:, None] - place) / 6) + 0.05 * np.eye(30)
    gap = 0.002 - 0.002 * np.sin(0.7 * place) ** 2 - 0.0001 * place
    together, _ = balance(compliance, gap)
    monkeypatch.setattr(solve, "TOGETHER", 0)
    np.testing.assert_allclose(balance(compliance, gap)[0], together, atol=1e-12)
    assert (together >= 0).all()
    assert 0 < np.count_nonzero(together) < 30


def test_any_guess_ends_in_the_same_balance() -> None:
    place = np.arange(20)
    compliance = np.exp(-np.abs(place[:, None] - place) / 4) + 0.1 * np.eye(20)
    gap = 0.001 - 0.0002 * place
    usual, _ = balance(compliance, gap)
    np.testing.assert_allclose(balance(compliance, gap, place % 2 == 0)[0], usual, atol=1e-12)


# The second method: quadratic hexahedra against Fourier series, and against finer hexahedra.

TRAVELS_M = np.array([0.002, 0.004])


@pytest.mark.parametrize(
    ("case", "skin"),
    [
        (CASES[0], MIDDLE), (CASES[1], PLAIN),
        pytest.param(CASES[1], MIDDLE, marks=pytest.mark.slow), pytest.param(CASES[2], MIDDLE, marks=pytest.mark.slow),
    ],
)  # fmt: skip
def test_two_methods_give_the_same_force(case, skin) -> None:
    medium = Medium(ground=case.ground, skin=skin, tissue_pa=15e3)
    block = Block(medium, MARGIN * case.main.reach_m(0.004) + 0.001, side_m=0.004)
    force = [block.press(case.main, float(travel)) for travel in TRAVELS_M]
    # Elements of 4 mm: finer ones come closer, below.
    np.testing.assert_allclose(force, Sample(medium).press(case.main, TRAVELS_M), rtol=0.025)


@pytest.mark.slow
def test_finer_hexahedra_come_closer() -> None:
    forearm = CASES[1]
    medium = Medium(ground=forearm.ground, skin=MIDDLE, tissue_pa=15e3)
    (exact,) = Sample(medium).press(forearm.main, TRAVELS_M[1:])
    off = [abs(Block(medium, 0.0125, side_m=side).press(forearm.main, 0.004) / exact - 1) for side in (0.006, 0.003)]
    assert off[1] < 0.006
    assert off[1] < off[0]


def test_without_scikit_fem_the_command_says_what_installs_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # What is imported again is forgotten afterwards.
    monkeypatch.setattr(sys.modules["carecontact.lab"], "fem", fem)
    for name in [n for n in sys.modules if n.split(".")[0] == "skfem" or "lab.fem" in n]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "skfem", None)
    with pytest.raises(SystemExit) as exit_:
        raise SystemExit(main(["verify", "physics", "--fem"]))
    assert exit_.value.code != 0
    printed = capsys.readouterr()
    assert "pip install 'carecontact[fem]'" in printed.out + printed.err
    assert "Traceback" not in printed.out + printed.err


BELLY, FOREARM, UPPER_ARM = CASES


def test_only_the_seam_knows_the_simulator() -> None:
    for path in Path(fem.__path__[0]).glob("*.py"):
        named = {
            node.module or ""
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, ast.ImportFrom)
        }  # fmt: skip
        knows = [name for name in named if name.startswith(("carecontact.sim", "carecontact.world", "mujoco"))]
        assert not knows or path.name == "simulated.py", path.name
        assert "carecontact.lab.fem.simulated" not in named or path.name == "compare.py", path.name


@pytest.mark.parametrize("skin", [pytest.param(PLAIN, marks=pytest.mark.slow), MIDDLE])
def test_the_tissues_modulus_gives_the_published_force(skin) -> None:
    found = solve.matched(UPPER_ARM, skin)
    published = np.interp(MATCHED_M, UPPER_ARM.reference.depth_m, UPPER_ARM.reference.force_n)
    assert found.curve(UPPER_ARM.main).at(np.array([MATCHED_M]))[0] == pytest.approx(published, rel=0.003)
    assert 5e3 < found.medium.tissue_pa < 30e3


def test_an_impossible_force_is_an_error() -> None:
    weak = replace(FOREARM.reference, force_n=1e-6 * FOREARM.reference.force_n)
    with pytest.raises(CarecontactError):
        solve.matched(replace(FOREARM, reference=weak), MIDDLE)


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.region)
def test_half_the_patches_side_gives_the_same_forces(case) -> None:
    medium = Medium(ground=case.ground, skin=MIDDLE, tissue_pa=15e3)
    travels = np.array([0.0015, 0.004])
    for tool in (ball(0.005), case.main):
        usual, fine = (Sample(medium, refined=factor).press(tool, travels) for factor in (1.0, 2.0))
        np.testing.assert_allclose(usual, fine, rtol=0.01)


@pytest.mark.slow
def test_finer_patches_under_a_gliding_tool_give_the_same_drag() -> None:
    medium = Medium(ground=FOREARM.ground, skin=MIDDLE, tissue_pa=2e4)
    usual, fine = (Sample(medium, refined=factor).drag(CAP, 0.003, 0.5) for factor in (1.0, 1.7))
    assert usual.stuck_n_m == pytest.approx(fine.stuck_n_m, rel=0.03)
    np.testing.assert_allclose(usual.force_n, fine.force_n, atol=0.02 * fine.force_n.max())
    np.testing.assert_allclose(usual.force_n[-1], 0.5 * usual.normal_n[-1], rtol=0.01)


def test_skin_flattens_the_exponent_widens_the_dimple_and_holds_a_tool_back() -> None:
    plain, skinned = (Sample(Medium(ground=BELLY.ground, skin=skin, tissue_pa=15e3)) for skin in (PLAIN, MIDDLE))
    growth = [
        np.log(sample.press(ball(0.02), [0.004])[0] / sample.press(ball(0.005), [0.004])[0])
        for sample in (plain, skinned)
    ]
    assert growth[1] < growth[0] - 0.1
    assert skinned.dimple(BELLY.main, 0.004)[0][3] > plain.dimple(BELLY.main, 0.004)[0][3]
    assert skinned.drag(CAP, 0.004, 0.5).stuck_n_m > 2 * plain.drag(CAP, 0.004, 0.5).stuck_n_m


def test_a_round_limb_lets_a_wide_disc_sink_more_easily() -> None:
    flat = replace(FOREARM.ground, limb_radius_m=None)
    forces = [
        Sample(Medium(ground=ground, skin=PLAIN, tissue_pa=1e4)).press(disc(0.0214), DEPTHS_M[-1:])[0]
        for ground in (flat, FOREARM.ground)
    ]
    assert forces[1] < 0.5 * forces[0]


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
