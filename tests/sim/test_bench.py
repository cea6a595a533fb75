"""The indentation bench against mechanics."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.errors import ConfigError, SceneError
from carecontact.human.library import load_body
from carecontact.protocol.load import load_protocol
from carecontact.protocol.person import Tissue
from carecontact.sim.bench import LAW_FIELDS, Bench, Indenter, touch_depth
from carecontact.tissue.plugin import Law
from carecontact.world.scene import region_shell

TISSUE = load_protocol("bathing-v3").person.tissue
BALL = Indenter(shape="hemisphere", size_m=0.010)


def scaled(tissue: Tissue, factor: float) -> Tissue:
    return tissue.model_copy(update={name: factor * getattr(tissue, name) for name in LAW_FIELDS})


def anchor_force(bench: Bench) -> np.ndarray:
    """(3,) force of the anchors' springs and dampers at the end of the last press, in the bone's frame [N]."""
    law, felt = bench.tissue, bench.felt
    u = felt.displacement(bench.data)
    spring = Law.of(law).anchors_pa(u, lock=float(bench.model.numeric(f"{bench.region}/contact").data[2]))
    growth = law.damping_growth_ns_m4 * np.maximum(u[:, :1], 0.0)
    borne = spring + (law.damping_ns_m3 + growth) * felt.rate(bench.data)
    return np.einsum("i,ij,ijk->k", felt.areas, borne, felt.frames)


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench(body=load_body("man-adult"), region="forearm", tissue=TISSUE["forearm"], indenter=BALL)


@pytest.fixture
def restored(bench: Bench) -> Bench:
    bench.set_law(TISSUE["forearm"])
    return bench


@pytest.mark.parametrize(
    "indenter", [BALL, Indenter(shape="flat", size_m=0.0107), Indenter(shape="cap")], ids=lambda i: i.shape
)
@pytest.mark.parametrize("region", ["forearm", "abdomen"])
def test_force_is_what_the_anchors_bear(region: str, indenter: Indenter) -> None:
    """But for what coupling and membrane carry past them: on a limb, neighbours' normals lean from one another."""
    made = Bench(body=load_body("man-adult"), region=region, tissue=TISSUE[region], indenter=indenter)
    press = made.press(along_m=0.012, across_m=0.004, depth_m=0.006, speed_m_s=0.002)
    _, inward, _ = made.place(0.012, 0.004)
    past = 1 - anchor_force(made) @ inward / press.force_n[-1]
    assert -0.01 < past < (0.07 if region == "forearm" else 0.02)
    # Contact points come and go without a jump: two samples are at most 40 um apart.
    assert np.abs(np.diff(press.force_n)).max() < 0.15


@pytest.mark.parametrize(("along_m", "across_m"), [(0.02, 0.009), (0.0, 0.0), (-0.01, 0.009)])
def test_the_force_of_a_disc_never_falls_with_depth(along_m: float, across_m: float) -> None:
    """Where the limb falls away beside it, skin is pushed round its rim: bit by bit, and it goes on bearing there."""
    disc = Indenter(shape="flat", size_m=0.0107)
    made = Bench(body=load_body("man-adult"), region="upper_arm", tissue=TISSUE["upper_arm"], indenter=disc)
    press = made.press(along_m=along_m, across_m=across_m, depth_m=0.0102, speed_m_s=0.01)
    depth = np.arange(0.001, 0.0102, 0.0005)
    rises = np.diff(np.interp(depth, press.indentation_m, press.force_n))
    assert rises.min() > 0.2 * np.median(rises)


def test_a_softening_law_is_followed(restored: Bench) -> None:
    """The anchor law with b below zero and damping that grows, against the force that its anchors bear."""
    a, depth = TISSUE["forearm"].a_n_m3, 0.005
    law = {"a_n_m3": a, "b_n_m4": -0.6 * a / depth, "c_n_m5": 0.2 * a / depth**2, "damping_growth_ns_m4": 1e7}
    straight = restored.press(depth_m=depth, speed_m_s=0.01).force_n[-1]
    restored.set_law(TISSUE["forearm"].model_copy(update=law))
    press = restored.press(depth_m=depth, speed_m_s=0.01)
    _, inward, _ = restored.place(0.0, 0.0)
    assert anchor_force(restored) @ inward == pytest.approx(press.force_n[-1], rel=0.05)
    assert press.force_n[-1] < 0.9 * straight


def test_stiffer_law_gives_nearly_as_much_more_force(restored: Bench) -> None:
    """The contact layer is a spring in series with the anchors: the force grows a little less than the law."""
    depths = np.array([0.001, 0.002, 0.004])
    soft = restored.response(depths, speed_m_s=0.002)
    restored.set_law(scaled(TISSUE["forearm"], 1.5))
    ratio = restored.response(depths, speed_m_s=0.002) / soft
    assert np.all((ratio > 1.15) & (ratio < 1.5))


def test_changed_law_is_the_law_that_would_have_been_compiled(restored: Bench) -> None:
    other = TISSUE["forearm"].model_copy(
        update={"a_n_m3": 3e6, "b_n_m4": 2e8, "c_n_m5": 7e9, "damping_ns_m3": 5e4, "source": "another"}
    )
    restored.set_law(other)
    compiled = Bench(body=restored.body, region="forearm", tissue=other, indenter=BALL, shell=restored.shell)
    np.testing.assert_array_equal(
        restored.model.numeric("forearm/law").data, compiled.model.numeric("forearm/law").data
    )
    np.testing.assert_array_equal(
        restored.press(depth_m=0.003, speed_m_s=0.02).force_n, compiled.press(depth_m=0.003, speed_m_s=0.02).force_n
    )


def test_another_mesh_needs_another_bench(restored: Bench) -> None:
    with pytest.raises(ConfigError, match="areal_mass_kg_m2"):
        restored.set_law(TISSUE["forearm"].model_copy(update={"areal_mass_kg_m2": 5.0}))


def test_same_press_twice_is_the_same_to_the_bit(restored: Bench) -> None:
    first = restored.press(depth_m=0.003, along_m=0.01, unload=True)
    restored.press(depth_m=0.005, speed_m_s=0.05)
    np.testing.assert_array_equal(restored.press(depth_m=0.003, along_m=0.01, unload=True).force_n, first.force_n)


def test_press_goes_in_brakes_holds_and_comes_out(restored: Bench) -> None:
    press = restored.press(depth_m=0.003, speed_m_s=0.02, unload=True, hold_s=0.1, acceleration_m_s2=0.5)
    held = press.indentation_m > 0.003 - 1e-9
    assert np.ptp(press.time_s[held]) == pytest.approx(0.1, abs=0.006)
    # Time starts at geometric touch; the brake takes v^2 / 2 a = 0.4 mm.
    cruising = press.loading & (press.indentation_m < 0.0025)
    np.testing.assert_allclose(press.indentation_m[cruising], 0.02 * press.time_s[cruising], atol=1e-9)
    assert np.abs(np.diff(press.speed_m_s)).max() <= 0.5 * np.diff(press.time_s).max() * 1.01
    assert press.speed_m_s[-1] == pytest.approx(-0.02)
    assert press.indentation_m[-1] < 0.0
    assert np.trapezoid(press.force_n, press.indentation_m) > 0


def test_any_path_is_followed(restored: Bench) -> None:
    time = np.linspace(0.0, 1.0, 60)
    path = 0.002 * np.sin(4 * np.pi * time) ** 2 - 0.0002
    press = restored.follow(time, path)
    # Half a sample of delay in a sensor would show at once: the force falls and rises with the path.
    assert np.corrcoef(press.indentation_m, press.force_n)[0, 1] > 0.9
    assert press.indentation_m.max() == pytest.approx(path.max(), abs=2e-5)


def test_more_damping_loses_more(restored: Bench) -> None:
    """Not twice as much for twice the damping: friction loses some of its own."""
    areas = []
    for factor in (1.0, 2.0):
        row = TISSUE["forearm"]
        restored.set_law(row.model_copy(update={"damping_ns_m3": factor * row.damping_ns_m3}))
        press = restored.press(depth_m=0.004, speed_m_s=0.003, unload=True)
        areas.append(np.trapezoid(press.force_n, press.indentation_m))
    assert 1.3 < areas[1] / areas[0] < 2.1


def test_ball_does_not_care_which_way_it_is_turned(restored: Bench) -> None:
    """A quarter turn of the carriage about its axis leaves a hemisphere's press as it was."""
    restored.press(depth_m=0.003)
    point, inward, axis = restored.place(0.0, 0.0)
    crosswise = np.cross(inward, axis)
    normal = restored.press(depth_m=0.003).force_n
    original = restored.place
    try:
        restored.place = lambda *_: (point, inward, crosswise)  # type: ignore[method-assign]
        turned = restored.press(depth_m=0.003).force_n
    finally:
        restored.place = original  # type: ignore[method-assign]
    np.testing.assert_allclose(turned[: len(normal)], normal[: len(turned)], atol=0.01)


def test_the_skin_sinks_under_the_indenter_and_not_far_from_it(restored: Bench) -> None:
    restored.press(depth_m=0.004, speed_m_s=0.01)
    places, sunk, _ = restored.skin()
    distance = np.hypot(*places.T)
    under, far = distance < 0.006, distance > 0.04
    assert under.any()
    assert far.any()
    # The ball's own surface; the contact gives way by some tenths, and the shell is a polyhedron.
    ball = 0.004 - (0.010 - np.sqrt(0.010**2 - distance[under] ** 2))
    np.testing.assert_allclose(sunk[under], ball, atol=0.0007)
    assert np.abs(sunk[far]).max() < 0.0002


def test_place_lies_on_the_shell_and_tilt_turns_toward_the_axis(bench: Bench) -> None:
    shell = region_shell(bench.body, "forearm", TISSUE["forearm"])
    point, inward, axis = bench.place(0.012, -0.006)
    local = (point + bench._bone_in_mesh - shell.frame_origin) @ shell.frame
    np.testing.assert_allclose(local[:2], [0.012, -0.006], atol=1e-9)
    assert np.linalg.norm(shell.vertices - point - bench._bone_in_mesh, axis=1).min() < TISSUE["forearm"].spacing_m
    assert inward @ shell.frame[:, 2] < -0.8
    _, tilted, _ = bench.place(0.012, -0.006, 20.0)
    assert np.degrees(np.arccos(tilted @ inward)) == pytest.approx(20.0)
    assert tilted @ axis == pytest.approx(np.sin(np.radians(20.0)))


def test_off_the_region_is_an_error(bench: Bench) -> None:
    with pytest.raises(SceneError, match="no surface of the forearm"):
        bench.place(0.5, 0.0)


def test_touch_is_interpolated() -> None:
    assert touch_depth(np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.5, 1.0]), 0.75) == pytest.approx(1.5)
    with pytest.raises(SceneError, match="never exceeds"):
        touch_depth(np.array([0.0, 1.0]), np.array([0.0, 0.5]), 0.75)


def test_a_disc_as_large_as_a_palm_presses_evenly() -> None:
    made = Bench(
        body=load_body("man-adult"),
        region="abdomen",
        tissue=TISSUE["abdomen"],
        indenter=Indenter(shape="flat", size_m=0.0214),
    )
    press = made.press(depth_m=0.006, speed_m_s=0.005)
    assert np.abs(np.diff(press.force_n)).max() < 0.2
    assert press.force_n[-1] > 5.0
