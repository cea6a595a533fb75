"""The compiled tissue as a part of a model: balance of forces and of energy, states, copies, and wrong models."""

from __future__ import annotations

import re
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carecontact.errors import SceneError
from carecontact.protocol.person import Tissue
from carecontact.tissue import plugin
from carecontact.tissue.plugin import RING_ROWS, Readings
from tests.tissue.sheets import (
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    HEAVY_KG,
    MESH,
    SPHERE,
    Array,
    Sheet,
    corners_of_a_prism,
    model_xml,
    sheet,
    tissue,
)

STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
TOOLS: dict[str, dict[str, Any]] = {
    "cap": {"bottom_m": 0.012, "type": ELLIPSOID, "size": [0.012, 0.019, 0.012]},
    "pad": {"bottom_m": 0.006, "type": BOX, "size": [0.015, 0.020, 0.006]},
    "disc": {"bottom_m": 0.02, "type": CYLINDER, "size": [0.011, 0.02, 0]},
    "flank": {"bottom_m": 0.03, "type": CAPSULE, "size": [0.03, 0.03, 0], "quat": [0.5, 0.5, 0.5, 0.5]},
    "hull": {
        "bottom_m": 0.02 * np.cos(np.pi / 8),
        "type": MESH,
        "meshname": "tool",
        "vertices": corners_of_a_prism(8, 0.02, 0.03),
    },
    "cap in a pad": {
        "bottom_m": 0.012,
        "type": ELLIPSOID,
        "size": [0.012, 0.019, 0.012],
        "more": ({"type": BOX, "size": [0.015, 0.020, 0.006], "pos": [0, 0, 0.0075]},),
    },
}


def soft(**fields: float) -> Tissue:
    return tissue(
        **{"coupling_length_m": 0.005, "membrane_n_m": 250.0, "contact_n_m3": 5e7, "damping_ns_m3": 2e4, **fields}
    )


def scrub_path(steps: int = 400) -> Array:
    down = np.linspace(0.0005, -0.004, steps // 2)
    over = 0.01 * np.sin(np.linspace(0, 2 * np.pi, steps - steps // 2))
    return np.concatenate([np.stack([0 * down, down], 1), np.stack([over, np.full(len(over), -0.004)], 1)])


@pytest.mark.parametrize("tool", TOOLS)
def test_what_pushes_the_tool_pushes_the_bone_as_much_the_other_way(tool: str) -> None:
    """Force and moment about the world's origin, where the bone's is, seen by two bodies that nothing else holds."""
    made = Sheet(soft(), sheet(), mass_kg=1.0, bone_mass_kg=2.0, free=True, **TOOLS[tool])
    model, data = made.model, made.data
    place = [0.012, 0.008, -0.003]
    data.qpos[7:10], data.qvel[6:9] = place, [0.05, 0.03, -0.05]
    mujoco.mj_forward(model, data)
    force = made.felt.generalised_force(model, data)
    np.testing.assert_array_equal(force, data.qfrc_passive)
    row = made.felt.now(data)
    assert row["force_n"][2] < -0.5
    np.testing.assert_allclose(force[:3], row["force_n"], atol=1e-9)
    np.testing.assert_allclose(force[6:9], -force[:3], atol=1e-9)
    np.testing.assert_allclose(force[3:6], -force[9:12] - np.cross(place, force[6:9]), atol=1e-9)
    assert np.linalg.norm(force[3:5]) > 0.01 * np.linalg.norm(force[:3]), "the tool presses beside the bone's origin"
    before = momenta(model, data)
    mujoco.mj_step(model, data, 50)
    np.testing.assert_allclose(momenta(model, data), before, atol=1e-6)


def momenta(model: mujoco.MjModel, data: mujoco.MjData) -> Array:
    """(6,) linear and angular, of all bodies together."""
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    return np.concatenate([model.body_mass.sum() * data.subtree_linvel[0], data.subtree_angmom[0]])


@pytest.mark.parametrize("tool", TOOLS)
def test_the_moment_on_the_bone_is_that_of_the_anchors_and_of_the_force_where_it_acts(tool: str) -> None:
    """A tool that was pushed sideways rests beside the bone's origin: each vertex bears what its springs say, where it
    is."""
    law = soft()
    made = Sheet(law, sheet(), bone_mass_kg=HEAVY_KG, **TOOLS[tool])
    made.hold(0.004, x_m=0.012, steps=50)
    row = made.move(np.array([[min(0.016, 0.012 + 1e-4 * k), -0.004] for k in range(600)]))[-1]
    felt, data = made.felt, made.data
    force = felt.generalised_force(made.model, data)
    moved = felt.displacement(data)
    borne = law.a_n_m3 * felt.areas[:, None] * moved
    for (first, second), weight in zip(*sheet().edges, strict=True):
        stiffness = weight * np.array([law.a_n_m3 * law.coupling_length_m**2, law.membrane_n_m, law.membrane_n_m])
        apart = stiffness * (moved[first] - moved[second])
        borne[first] += apart
        borne[second] -= apart
    moving = (moved != 0).any(1)
    in_bone = np.einsum("ij,ijk->ik", borne, felt.frames)[moving]
    moment = np.cross(felt.vertices(data)[moving], in_bone).sum(0)
    np.testing.assert_allclose(force[:3], in_bone.sum(0), atol=0.002 * np.linalg.norm(force[:3]))
    assert force[0] > 0.05, "friction drags the skin along"
    lever_m = 0.012
    np.testing.assert_allclose(force[3:6], moment, atol=0.01 * lever_m * np.linalg.norm(force[:3]))
    at_centre = np.cross(row["centroid_m"], row["force_n"])
    # The wall of a flat tool that is pushed sideways presses too, and counts in the centre of pressure.
    np.testing.assert_allclose(force[3:6], at_centre, atol=0.2 * lever_m * np.linalg.norm(force[:3]))
    assert abs(force[4]) > 0.9 * lever_m * np.linalg.norm(force[:3])


@pytest.mark.parametrize("dt_s", [0.002, 0.004])
@pytest.mark.parametrize("tool", TOOLS)
def test_no_energy_is_made_when_a_body_bounces_and_slides(tool: str, dt_s: float) -> None:
    """What the tool loses is stored, damped or rubbed away; 2 % may stay unexplained."""
    made = Sheet(soft(), sheet(), mass_kg=1.0, dt_s=dt_s, ledger=True, **TOOLS[tool])
    made.data.qpos[-1], made.data.qvel[-2:] = 0.001, [0.1, -0.2]
    before = 0.5 * 0.05
    lost = 0.0
    for _ in range(round(0.25 / dt_s)):
        mujoco.mj_step(made.model, made.data)
        row = made.felt.last(made.data, 1)[0]
        lost += row["damped_j"] + row["rubbed_j"]
    after = 0.5 * float((made.data.qvel[-2:] ** 2).sum())
    assert after < 0.8 * before, "it touched"
    assert abs(before - after - row["stored_j"] - row["kinetic_j"] - lost) < 0.02 * before


@pytest.mark.parametrize(
    ("outer", "inner"),
    [
        ("pad", {"type": ELLIPSOID, "size": [0.008, 0.008, 0.003], "pos": [0, 0, 0.0032]}),
        ("cap", {"type": BOX, "size": [0.003, 0.003, 0.003], "pos": [0, 0, 0.0036]}),
    ],
)
def test_skin_in_two_geoms_of_a_tool_bears_once(outer: str, inner: dict[str, Any]) -> None:
    """What lies wholly inside a geom changes nothing, although skin is let in as far as there by a soft layer."""
    law = soft(contact_n_m3=4e6)
    alone, both, inside = (
        Sheet(law, sheet(), **{**TOOLS[tool], **more}).hold(0.005)
        for tool, more in [(outer, {}), (outer, {"more": (inner,)}), ("flank", {"bottom_m": 0.1, "more": (inner,)})]
    )
    assert inside["points"] >= 3, "alone, it touches"
    np.testing.assert_allclose(both["force_n"], alone["force_n"], atol=1e-6)
    assert both["points"] == alone["points"]
    assert both["area_m2"] == pytest.approx(alone["area_m2"])


def test_where_one_geom_of_a_tool_takes_over_from_another_the_force_does_not_jump() -> None:
    """A ball comes through the face of a pad that already presses."""
    steps = 400
    law, path = soft(damping_ns_m3=1e3), np.zeros((steps, 2))
    path[:, 1] = -np.linspace(0, 0.006, steps)
    force = Sheet(law, sheet(), **TOOLS["cap in a pad"]).move(path)["force_n"][:, 2]
    alone = Sheet(law, sheet(), **TOOLS["cap"]).move(path)["force_n"][:, 2]
    assert force[-1] < 1.2 * alone[-1]
    assert np.abs(np.diff(force)).max() < 0.02 * np.abs(force).max()


def test_nothing_depends_on_how_the_world_is_turned() -> None:
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, np.array([0.5, 0.1, -0.7, 0.4]) / np.linalg.norm([0.5, 0.1, -0.7, 0.4]))
    turn = turn.reshape(3, 3)
    straight, turned = (
        Sheet(soft(), sheet(), frame=frame, **TOOLS["cap"]).move(scrub_path()) for frame in (None, turn)
    )
    np.testing.assert_allclose(turned["force_n"], straight["force_n"] @ turn.T, atol=1e-4)
    np.testing.assert_allclose(turned["centroid_m"], straight["centroid_m"] @ turn.T, atol=1e-5)


def test_a_state_restored_in_the_middle_of_a_scrub_goes_on_bit_for_bit() -> None:
    path = scrub_path()
    whole = Sheet(soft(), sheet(), **TOOLS["cap"])
    whole.move(path[:300])
    state = np.zeros(mujoco.mj_stateSize(whole.model, STATE))
    mujoco.mj_getState(whole.model, whole.data, state, STATE)
    rest = whole.move(path[299:])
    again = Sheet(soft(), sheet(), **TOOLS["cap"])
    again.move(path[:100])
    mujoco.mj_setState(again.model, again.data, state, STATE)
    assert again.move(path[299:]).tobytes() == rest.tobytes()


def test_a_copy_made_between_a_forward_pass_and_its_step_goes_on_bit_for_bit() -> None:
    made = Sheet(soft(), sheet(), **TOOLS["cap"])
    made.move(scrub_path()[:300])
    mujoco.mj_step1(made.model, made.data)
    copy = mujoco.MjData(made.model)
    mujoco.mj_copyData(copy, made.model, made.data)
    for data in (made.data, copy):
        mujoco.mj_step2(made.model, data)
        mujoco.mj_step(made.model, data, 20)
    assert copy.plugin_state.tobytes() == made.data.plugin_state.tobytes()


def test_looking_ahead_changes_nothing_and_a_reset_forgets_everything() -> None:
    first, second = (Sheet(soft(), sheet(), **TOOLS["cap"]) for _ in range(2))
    for place in scrub_path():
        first.move(place[None])
        mujoco.mj_forward(first.model, first.data)
        second.move(place[None])
    assert first.data.plugin_state.tobytes() == second.data.plugin_state.tobytes()
    mujoco.mj_resetData(first.model, first.data)
    assert not first.data.plugin_state.any()


def test_ten_steps_in_one_call_are_ten_steps() -> None:
    one, ten = (Sheet(soft(), sheet(), mass_kg=1.0, **TOOLS["cap"]) for _ in range(2))
    for made in (one, ten):
        made.data.qvel[-1] = -0.2
    rows = []
    for _ in range(RING_ROWS):
        mujoco.mj_step(one.model, one.data)
        rows.append(one.felt.last(one.data, 1)[0])
    mujoco.mj_step(ten.model, ten.data, RING_ROWS)
    assert ten.felt.last(ten.data, RING_ROWS).tobytes() == np.array(rows).tobytes()
    with pytest.raises(SceneError, match=f"count {RING_ROWS + 1}: expected 1 to {RING_ROWS}"):
        ten.felt.last(ten.data, RING_ROWS + 1)


def test_cells_add_up_to_what_the_whole_region_felt() -> None:
    made = Sheet(soft(), sheet(), **TOOLS["pad"])
    rows = made.move(scrub_path())
    cells = made.felt.cells(made.data)
    dt = made.model.opt.timestep
    assert cells.press_ns.sum() == pytest.approx(rows["normal_n"].sum() * dt, rel=1e-9)
    assert cells.touch_m2s.sum() == pytest.approx(rows["area_m2"].sum() * dt, rel=1e-9)
    assert (cells.press_ns > 0).all(), "the pad lies on all four quarters"
    assert cells.slip_m3.sum() > 0


@settings(max_examples=25, deadline=None)
@given(
    tool=st.sampled_from(sorted(TOOLS)),
    depth=st.floats(0.0, 0.04),
    across=st.floats(-0.03, 0.03),
    speed=st.floats(0.01, 1.0),
    friction=st.floats(0.05, 1.5),
)
def test_whatever_the_tool_does_the_force_stays_finite_and_in_its_cone(
    tool: str, depth: float, across: float, speed: float, friction: float
) -> None:
    made = Sheet(soft(friction=friction), sheet(spacing_m=0.01), **TOOLS[tool])
    steps = max(2, int(depth / speed / 0.002))
    down = np.stack([np.zeros(steps), np.linspace(0.001, -depth, steps)], 1)
    over = np.stack([np.linspace(0, across, 50), np.full(50, -depth)], 1)
    rows = made.move(np.concatenate([down, over]))
    assert np.isfinite(made.data.plugin_state).all()
    assert (rows["normal_n"] >= 0).all()
    assert (rows["force_n"][:, 2] <= 1e-9).all(), "the tissue is pushed down, never pulled"
    # Coulomb at every point: the net force cannot lean more than all of them do.
    assert (np.linalg.norm(rows["force_n"], axis=1) <= np.hypot(1, friction) * rows["normal_n"] + 1e-9).all()
    assert (rows["left_m"] < 1e-5).all()


def test_a_tool_far_away_costs_no_solve_and_the_sheet_comes_to_rest() -> None:
    made = Sheet(soft(), sheet(), bottom_m=0.02, type=SPHERE, size=[0.02, 0, 0])
    made.hold(0.003, steps=10)
    away = made.move(np.tile([0.0, 0.2], (400, 1)))
    assert away["sweeps"][0] > 0
    assert away["sweeps"][-1] == 0
    assert not made.felt.displacement(made.data).any()


def test_a_region_that_the_model_does_not_have() -> None:
    made = Sheet(soft(), sheet(), **TOOLS["cap"])
    with pytest.raises(SceneError, match="no soft region knee"):
        Readings(made.model, "knee")


CONTACT = r'(/contact" )size="\d+" data="[^"]*"'


@pytest.mark.parametrize(
    ("pattern", "replacement", "message"),
    [
        ("<custom>", '<option integrator="RK4"/><custom>', "take another integrator than RK4"),
        (r'(/edges" size="\d+" data=")\S+', r"\g<1>81.0", "edges or triangles of sheet name vertices or cells outside"),
        (r'(/edges" size="\d+" data=")\S+', r"\g<1>-1.0", "edges or triangles of sheet name vertices or cells outside"),
        (r'(/triangles" size="\d+" data="\S+ )\S+', r"\g<1>1e9", "outside of its 81 and 4"),
        (r'(/triangles" size="\d+" data="(\S+ ){4})\S+', r"\g<1>4.0", "outside of its 81 and 4"),
        (CONTACT, r'\g<1>data="0.0015"', "sheet/contact of 3 numbers"),
        (CONTACT, r'\g<1>data="-0.0015 0.006 0"', "below what it may be"),
        (CONTACT, r'\g<1>data="0.0015 -0.006 0"', "below what it may be"),
        (CONTACT, r'\g<1>data="nan 0.006 0"', "not finite"),
        (r'(/law" size="\d+" data=")\S+', r"\g<1>nan", "not finite"),
        (r'(/options" size="\d+" data="(\S+ ){2})\S+', r"\g<1>0.5", "allows the solver no sweep"),
    ],
)
def test_a_model_that_the_step_cannot_follow_is_refused(pattern: str, replacement: str, message: str) -> None:
    plugin.load_plugins()
    text, count = re.subn(pattern, replacement, model_xml(tissue(), sheet(half_m=0.02)), count=1)
    assert count == 1
    with pytest.raises(ValueError, match=r"plugin->init failed") as refusal:
        mujoco.MjModel.from_xml_string(text)
    assert message in str(refusal.value)


@pytest.mark.parametrize(
    ("number", "value"),
    [(0, -5.0), (0, np.nan), (2, 1e7), (2, -1.0), (2, np.nan), ("point", 1e8), ("point", -1.0)],
    ids=["steps below 0", "steps nan", "holds many", "holds below 0", "holds nan", "point outside", "point below 0"],
)
def test_a_state_that_the_tissue_did_not_write_is_refused(number: int | str, value: float) -> None:
    made = Sheet(soft(), sheet(), **TOOLS["cap"])
    made.hold(0.004, steps=10)
    assert made.data.plugin_state[2] > 0, "points touch"
    at = number if isinstance(number, int) else 3 + 6 * len(made.felt.places)
    made.data.plugin_state[at] = value
    with pytest.raises(mujoco.FatalError, match="plugin_state of sheet was not written by it"):
        mujoco.mj_step(made.model, made.data)
