"""The compiled tissue against closed forms of foundations: Winkler's springs, Pasternak's sheet, Coulomb's friction."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ive, k0, k1

from carecontact.tissue.plugin import LOCK, Law
from tests.tissue.sheets import BOX, CYLINDER, MESH, SPHERE, Sheet, corners_of_a_box, sheet, tissue


def test_a_flat_disc_on_independent_springs() -> None:
    """Springs that are as stiff along the surface as across it give way along the disc's normal, also under its rim,
    which is rounded with 2 mm; the contact layer is in series."""
    law = tissue(a_n_m3=1e6, contact_n_m3=4e6, friction=0.01)
    made = Sheet(law, sheet(spacing_m=0.00125), bottom_m=0.02, type=CYLINDER, size=[0.02, 0.02, 0])
    row = made.hold(0.001, steps=200)
    r = np.linspace(0.0, 0.02, 4001)
    from_rim = np.hypot(np.clip(r - 0.018, 0.0, None), 0.001)
    upward = np.clip(0.002 - from_rim, 0.0, None) * 0.001 / from_rim
    assert -row["force_n"][2] == pytest.approx(0.8e6 * 2 * np.pi * np.trapezoid(r * upward, r), rel=0.03)
    assert row["area_m2"] == pytest.approx(np.pi * 0.0197**2, rel=0.06), "the mesh has triangles"
    middle = np.linalg.norm(made.felt.places, axis=1) < 0.01
    np.testing.assert_allclose(made.felt.displacement(made.data)[middle, 0], 0.8 * 0.001, rtol=3e-3)


def test_a_tool_that_gives_way_is_a_third_spring_in_series() -> None:
    """Anchors, skin and pile of 1, 4 and 2.5 MN/m^3: together 0.606, without the pile 0.8."""
    law, together = tissue(a_n_m3=1e6, contact_n_m3=4e6, friction=2.0), 1 / (1 / 1e6 + 1 / 4e6 + 1 / 2.5e6)
    rigid, soft = (
        Sheet(law, sheet(half_m=0.03, spacing_m=0.0025), bottom_m=0.04, give_m3_n=give, type=SPHERE, size=[0.04, 0, 0])
        for give in (0.0, 1 / 2.5e6)
    )
    forces = [-made.hold(0.003)["force_n"][2] for made in (rigid, soft)]
    assert forces[1] / forces[0] == pytest.approx(together / 0.8e6, rel=0.02)


@pytest.mark.parametrize(("b", "c"), [(0.0, 0.0), (2e8, 0.0), (0.0, 5e10), (-1e8, 3e10)])
def test_a_sphere_on_independent_springs(b: float, c: float) -> None:
    """F = 2 pi times the integral of r p(w(r)), w being how deep the sphere lies."""
    # Friction keeps the sheet from sliding off the sphere's slope, as the closed form has it.
    law = tissue(a_n_m3=1e6, b_n_m4=b, c_n_m5=c, friction=2.0)
    radius, depth = 0.02, 0.004
    made = Sheet(law, sheet(half_m=0.03, spacing_m=0.0015), bottom_m=radius, type=SPHERE, size=[radius, 0, 0])
    r = np.linspace(0, np.sqrt(2 * radius * depth - depth**2), 4001)
    w = np.sqrt(radius**2 - r**2) - (radius - depth)
    pressure = 1e6 * w + b * w**2 + c * w**3
    wanted = 2 * np.pi * np.trapezoid(r * pressure, r)
    # The layer of contact, a thousand times as stiff, gives way by 0.1 %; the rest is the mesh.
    assert -made.hold(depth)["force_n"][2] == pytest.approx(wanted, rel=0.02)


def test_tissue_that_is_pressed_nearly_to_the_bone_locks() -> None:
    """A wide disc, eight and nine tenths of the thickness deep; friction holds the skin, and the layer gives way."""
    law = tissue(a_n_m3=1e6, c_n_m5=1e10, thickness_m=0.01, measured_depth_m=0.005, friction=2.0)
    made = Sheet(law, sheet(half_m=0.03, spacing_m=0.0025), bottom_m=0.02, type=CYLINDER, size=[0.02, 0.02, 0])
    for depth, lock in ((0.006, 0.0), (0.008, 8e3), (0.009, 27e3)):
        made.hold(depth)
        inward = made.felt.displacement(made.data)[np.linalg.norm(made.felt.places, axis=1) < 0.01, 0]
        pressure = 2e8 * (depth - inward.mean())
        assert pressure == pytest.approx(Law.of(law).normal_pa(inward).mean(), rel=0.01)
        assert Law.of(law).normal_pa(np.array([depth]))[0] == pytest.approx(1e6 * depth + 1e10 * depth**3 + lock)


def test_tissue_that_does_not_lock_is_firmer_across_where_it_is_deep() -> None:
    """At 0.75 of the thickness: secants of 1.5625 and, where it begins, 1.25 MN/m^3; a quarter is left. Of the growth,
    5 of 7 parts have set in."""
    law = Law.of(tissue(a_n_m3=1e6, c_n_m5=1e10, thickness_m=0.01, measured_depth_m=0.005))
    moved = np.array([[0.005, 1e-4, 0.0], [0.0075, 1e-4, 0.0]])
    assert law.anchors_pa(moved, lock=0.0)[:, 1] / 1e-4 == pytest.approx([1e6, 1e6 + 0.3125e6 / 0.25 * 5 / 7])
    assert law.anchors_pa(moved)[:, 1] / 1e-4 == pytest.approx([1e6, 1e6])


@pytest.mark.parametrize(("depth", "lock"), [(0.004, 0.0), (0.0075, 0.0), (0.0095, 0.0), (0.0075, LOCK)])
def test_sheared_tissue_bears_what_its_law_says(depth: float, lock: float) -> None:
    """A wide disc that presses and moves aside without slipping: its force is that of the anchors in all directions."""
    law = tissue(a_n_m3=1e6, c_n_m5=1e10, thickness_m=0.01, measured_depth_m=0.005, friction=2.0)
    made = Sheet(
        law, sheet(half_m=0.03, spacing_m=0.0025), bottom_m=0.02, lock=lock, type=CYLINDER, size=[0.02, 0.02, 0]
    )
    aside = np.concatenate([np.zeros(600), np.linspace(0, 0.001, 200), np.full(600, 0.001)])
    down = np.concatenate([np.linspace(0.0005, -depth, 200), np.full(1200, -depth)])
    force = made.move(np.stack([aside, down], 1))[-1]["force_n"]
    pressure = Law.of(law).anchors_pa(made.felt.displacement(made.data), lock=lock)
    borne = (pressure * made.felt.areas[:, None]).sum(0)
    assert abs(force[0]) > 1
    assert abs(force[0]) == pytest.approx(np.linalg.norm(borne[1:]), rel=5e-3)
    assert abs(force[2]) == pytest.approx(borne[0], rel=5e-3)


def test_a_coarse_mesh_meets_a_round_tool_like_a_fine_one() -> None:
    """A triangle of 5 mm is a chord of the bowl that a ball of 10 mm presses; its middle does not lie on the ball."""
    law = tissue(a_n_m3=1e6, coupling_length_m=0.005, membrane_n_m=200.0)
    forces = []
    for spacing in (0.005, 0.0015):
        mesh = sheet(half_m=0.03, spacing_m=spacing)
        made = [
            Sheet(law, mesh, bottom_m=0.01, type=SPHERE, size=[0.01, 0, 0]).hold(0.006, x_m=x)["force_n"][2]
            for x in (0.0, 0.001, 0.002, 0.0025)
        ]
        forces.append(np.mean(made))
    assert forces[0] == pytest.approx(forces[1], rel=0.04)


def rim_of_ball(radius: float, depth: float, *, a: float, length: float, layer: float) -> float:
    """Radius of a shallow ball's contact on Pasternak's foundation, with a layer of stiffness ``layer`` between both.

    The indentation is K0(r / l) outside, and a bowl and I0(r / end) inside, without a corner between them.
    """
    share = layer / (a + layer)
    end = length * np.sqrt(1 - share)

    def corner(c: float) -> float:
        over = depth - c**2 / (2 * radius)
        inside = (over - share * (over - 2 * end**2 / radius)) / end * ive(1, c / end) / ive(0, c / end)
        return inside - share * c / radius + over / length * k1(c / length) / k0(c / length)

    return brentq(corner, 1e-4, np.sqrt(2 * radius * depth) - 1e-9)


@pytest.mark.parametrize(("radius", "depth", "within"), [(0.02, 0.002, 0.12), (0.06, 0.002, 0.05), (0.06, 0.004, 0.04)])
def test_the_area_in_contact_ends_inside_triangles(radius: float, depth: float, within: float) -> None:
    """On the shipped mesh of 5 mm, wherever the ball stands on it."""
    law = tissue(a_n_m3=1e6, coupling_length_m=0.005, contact_n_m3=5e7)
    rim = rim_of_ball(radius, depth, a=law.a_n_m3, length=law.coupling_length_m, layer=law.contact_n_m3)
    mesh = sheet(half_m=0.045)
    for x in (0.0, 0.0012, 0.0025, 0.0037):
        made = Sheet(law, mesh, bottom_m=radius, type=SPHERE, size=[radius, 0, 0])
        assert made.hold(depth, x_m=x, steps=100)["area_m2"] == pytest.approx(np.pi * rim**2, rel=within)


def test_a_flat_disc_on_a_sheet_that_spreads_the_load() -> None:
    """Pasternak: under the disc springs, outside w = depth K0(r/l) / K0(R/l), and a line load at the rim.

    The rim is rounded with 2 mm: at this depth the sheet leaves it about 1 mm inside.
    """
    length, radius, depth = 0.006, 0.040, 0.0005
    law = tissue(a_n_m3=1e6, coupling_length_m=length)
    made = Sheet(
        law, sheet(half_m=0.065, spacing_m=0.0025), bottom_m=0.02, type=CYLINDER, size=[radius + 0.001, 0.02, 0]
    )
    wanted = 1e6 * depth * (np.pi * radius**2 + 2 * np.pi * radius * length * k1(radius / length) / k0(radius / length))
    assert -made.hold(depth, steps=200)["force_n"][2] == pytest.approx(wanted, rel=0.08)
    u, places = made.felt.displacement(made.data)[:, 0], made.felt.places
    r = np.linalg.norm(places[:, :2], axis=1)
    outside = (r > radius + 0.004) & (r < radius + 0.010)
    np.testing.assert_allclose(u[outside], depth * k0(r[outside] / length) / k0(radius / length), atol=0.08 * depth)


@pytest.mark.parametrize("depth", [0.001, 0.004])
def test_the_hull_of_a_mesh_presses_like_the_box_that_it_is(depth: float) -> None:
    """Its faces and its sides; only its edges are rounded otherwise, with 2.4 mm for 2."""
    law, half_m = tissue(coupling_length_m=0.005, membrane_n_m=200.0, contact_n_m3=5e7), (0.015, 0.02, 0.006)
    box, hull = (
        Sheet(law, sheet(), bottom_m=0.006, **shape).hold(depth, steps=100)
        for shape in (
            {"type": BOX, "size": half_m},
            {"type": MESH, "meshname": "tool", "vertices": corners_of_a_box(*half_m)},
        )
    )
    assert hull["force_n"][2] == pytest.approx(box["force_n"][2], rel=0.06)
    assert hull["area_m2"] == pytest.approx(box["area_m2"], rel=0.05)
    np.testing.assert_allclose(hull["centroid_m"], box["centroid_m"], atol=1e-4)


def test_the_dimple_of_a_point_is_the_green_function_of_the_screened_poisson_equation() -> None:
    """w(r) = P / (2 pi G) K0(r / l) beyond the small disc that presses."""
    length = 0.004
    law = tissue(a_n_m3=1e6, coupling_length_m=length)
    made = Sheet(law, sheet(half_m=0.04, spacing_m=0.001), bottom_m=0.02, type=CYLINDER, size=[0.002, 0.02, 0])
    load = -made.hold(0.002)["force_n"][2]
    r = np.linalg.norm(made.felt.places[:, :2], axis=1)
    ring = (r > 0.004) & (r < 0.012)
    wanted = load / (2 * np.pi * 1e6 * length**2) * k0(r[ring] / length)
    np.testing.assert_allclose(made.felt.displacement(made.data)[ring, 0], wanted, rtol=0.06)


def test_friction_sticks_as_the_anchors_and_their_layer_then_slips_at_its_coefficient() -> None:
    law = tissue(a_n_m3=1e6, contact_n_m3=4e6, friction=0.4)
    made = Sheet(law, sheet(spacing_m=0.0025), bottom_m=0.02, type=CYLINDER, size=[0.02, 0.02, 0])
    pressed = made.hold(0.003)
    push = -pressed["force_n"][2]
    # Slowly enough that dampers bear nothing: 0.2 mm in 1 s, then on.
    stick = made.move(np.stack([np.linspace(0, 2e-4, 500), np.full(500, -0.003)], 1))[-1]
    # The rim is rounded: there the points bear less and slip first.
    assert stick["force_n"][0] == pytest.approx(0.8e6 * 2e-4 * pressed["area_m2"], rel=0.05)
    slip = made.move(np.stack([np.linspace(2e-4, 0.006, 1500), np.full(1500, -0.003)], 1))[-1]
    assert slip["force_n"][0] == pytest.approx(0.4 * push, rel=0.04)
    assert slip["normal_n"] == pytest.approx(push, rel=0.03)


def test_without_friction_nothing_is_dragged() -> None:
    law = tissue(friction=1e-9, contact_n_m3=5e7)
    made = Sheet(law, sheet(), bottom_m=0.02, type=CYLINDER, size=[0.02, 0.02, 0])
    made.hold(0.002)
    # A slow slide: the dampers of the dimple that moves along bear 2 % of the press.
    row = made.move(np.stack([np.linspace(0, 0.005, 2000), np.full(2000, -0.002)], 1))[-1]
    assert abs(row["force_n"][0]) < 0.03 * row["normal_n"]
    assert abs(row["force_n"][1]) < 1e-3 * row["normal_n"]


def test_a_press_relaxes_with_the_time_constant_of_its_dampers() -> None:
    """Held at a depth after a fast press, the force of a Kelvin-Voigt bed falls at once to that of its springs; let go,
    the sheet comes back with D / a."""
    law = tissue(a_n_m3=1e6, damping_ns_m3=1e5)
    made = Sheet(law, sheet(), bottom_m=0.02, dt_s=0.001, type=CYLINDER, size=[0.02, 0.02, 0])
    made.hold(0.003, steps=2000)
    start = made.felt.displacement(made.data)[:, 0].max()
    steps = 100
    made.move(np.tile([0.0, 0.05], (steps, 1)))
    left = made.felt.displacement(made.data)[:, 0].max() / start
    assert left == pytest.approx(np.exp(-steps * 0.001 / 0.1), rel=0.03)


def test_damping_that_grows_with_indentation() -> None:
    """While a heavy disc sinks at a constant speed, the dampers bear (d + d' w) v per area."""
    speed, fields = 0.05, {"a_n_m3": 1e5, "damping_ns_m3": 1e4, "contact_n_m3": 3e7}
    for growth in (0.0, 1e7):
        law = tissue(**fields, damping_growth_ns_m4=growth)
        made = Sheet(law, sheet(spacing_m=0.0025), bottom_m=0.02, dt_s=0.0005, type=CYLINDER, size=[0.02, 0.02, 0])
        path = np.arange(0.0005, -0.004, -speed * 0.0005)
        row = made.move(np.stack([np.zeros(len(path)), path], 1))[-1]
        middle = np.linalg.norm(made.felt.places, axis=1) < 0.01
        u, rate = (of(made.data)[middle, 0].mean() for of in (made.felt.displacement, made.felt.rate))
        wanted = (1e5 * u + (1e4 + growth * u) * rate) * np.pi * 0.02**2
        assert -row["force_n"][2] == pytest.approx(wanted, rel=0.08)


@pytest.mark.parametrize("mass", [12.0, 1.2])
def test_free_skin_swings_with_the_period_of_its_inertia_and_spring(mass: float) -> None:
    """T = 2 pi sqrt(m / a) for every vertex of a sheet that was kicked as a whole, hardly damped; a kick with speed
    v goes v sqrt(m / a) deep."""
    law = tissue(a_n_m3=1e6, damping_ns_m3=1.0, coupling_length_m=0.005, membrane_n_m=200.0, areal_mass_kg_m2=mass)
    rate, speed = np.sqrt(1e6 / mass), 0.05
    steps_each = 2000
    made = Sheet(
        law, sheet(half_m=0.02), bottom_m=0.02, dt_s=2 * np.pi / rate / steps_each, type=SPHERE, size=[0.02, 0, 0]
    )
    made.felt.set_motion(made.data, np.array([1e-12, 0.0, 0.0]), np.array([speed, 0.0, 0.0]))
    path = []
    for _ in range(round(1.3 * steps_each)):
        made.data.qpos[-1], made.data.qvel[-2:] = 0.1, 0.0
        mujoco.mj_step(made.model, made.data)
        path.append(np.median(made.felt.displacement(made.data)[:, 0]))
    w = np.array(path)
    returns = np.flatnonzero((w[:-1] < 0) & (w[1:] >= 0))
    assert returns[0] == pytest.approx(steps_each, rel=0.01)
    assert w.max() == pytest.approx(speed / rate, rel=0.01)
