"""The world as physics: history, settling, passive response. Force balance: tests/validation."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
import numpy.typing as npt
import pytest

from carecontact.errors import SceneError
from carecontact.recording.schema import SEGMENTS
from carecontact.sim.simulation import Simulation
from carecontact.world.scene import Scene
from tests.sim.conftest import surface

FOREARM = SEGMENTS.index("right_forearm")
OUTWARD_M_S = 5.0
"""Of the skin under the tool, as if it had been kicked from within."""


def test_skin_that_is_not_a_number_is_a_warning(pressing: Simulation) -> None:
    pressing.advance(10)
    assert pressing.solver_warnings() == []
    displaced = pressing.tissue["forearm"].displacement(pressing.data)
    displaced[np.argmax(displaced[:, 0]), 0] = np.nan
    pressing.advance(10)
    assert pressing.solver_warnings() == ["TISSUE"]


def test_a_change_that_is_not_a_number_is_a_warning(pressing: Simulation, monkeypatch: pytest.MonkeyPatch) -> None:
    last = pressing._rings.last

    def spoilt(data: mujoco.MjData, count: int) -> npt.NDArray[np.void]:
        rows = last(data, count)
        rows["left_m"][0] = np.nan
        return rows

    monkeypatch.setattr(pressing._rings, "last", spoilt)
    pressing.advance(10)
    assert pressing.solver_warnings() == ["TISSUE"]


def test_every_step_of_a_period_is_kept_bit_for_bit(pressing: Simulation) -> None:
    model, data = pressing.model, pressing.data
    pressing.set_goal(pressing.control.target_in_base - np.r_[0, 0, 0.01, 0, 0, 0, 0], 0.1)
    state = pressing.integration_state()

    mujoco.mj_step(model, data, 10)
    times, together = pressing.history.last(data, 10)
    felt = pressing.tissue["forearm"]
    felt_together = felt.last(data, 10)
    mujoco.mj_setState(model, data, state, int(mujoco.mjtState.mjSTATE_INTEGRATION))
    singly, felt_singly = [], []
    for _ in range(10):
        mujoco.mj_step(model, data)
        singly.append(data.sensordata.copy())
        felt_singly.append(felt.last(data, 1)[0])

    assert np.array_equal(together, np.array(singly))
    assert np.array_equal(felt_together, np.array(felt_singly, felt_together.dtype))
    assert np.allclose(np.diff(times), model.opt.timestep)
    force = felt_together["force_n"]
    assert (np.linalg.norm(force, axis=1) > 3.0).all()
    assert len(np.unique(force, axis=0)) > 1


def test_a_one_step_spike_is_in_the_force_stream(pressing: Simulation) -> None:
    """A blow that lasts one physics step in the middle of a period, invisible at the period's end, is kept."""
    felt, data = pressing.tissue["forearm"], pressing.data
    under_tool = np.linalg.norm(surface(pressing, "forearm") - data.site("tcp").xpos, axis=1) < 0.010
    for step in range(10):
        if step == 4:
            felt.rate(data)[under_tool, 0] = -OUTWARD_M_S
        mujoco.mj_step(pressing.model, data)
    forces = np.linalg.norm(felt.last(data, 10)["force_n"], axis=1)
    assert forces.argmax() == 4
    assert forces[4] > forces[[3, 9]].max() + 3.0


@pytest.mark.parametrize("angle", [45.0, 52.5, 60.0])
def test_person_comes_to_rest_inside_every_joint_range(forearm_scene: Scene, angle: float) -> None:
    simulation = Simulation(forearm_scene)
    settled = simulation.settle(angle)
    assert abs(settled.comfort_arm_deg - angle) < 1.0
    assert simulation.human_speed() < 0.01
    margin = np.minimum(
        settled.joint_position - simulation.joint_range[:, 0], simulation.joint_range[:, 1] - settled.joint_position
    )
    assert np.degrees(margin).min() >= 5.0
    simulation.start()
    simulation.advance(5000)
    drift = np.abs(simulation.history.last(simulation.data, 1)[1][0, simulation.joint_columns] - settled.joint_position)
    assert np.degrees(drift).max() < 1.0
    touching = [
        (simulation.model.geom(c.geom[0]).name, simulation.model.geom(c.geom[1]).name)
        for c in simulation.data.contact[: simulation.data.ncon]
    ]
    assert all("bed_" in a or "bed_" in b for a, b in touching), touching


def pushed_sideways(simulation: Simulation, newton: float) -> Iterator[None]:
    """Horizontal push at mid-forearm for 1.5 s, reached in 0.4 s; stops after each period of 20 ms."""
    data = simulation.data
    forearm = simulation.model.body("human_right_forearm").id
    along = data.site("region_forearm").xmat.reshape(3, 3)[:, 0]
    side = np.cross([0, 0, 1.0], along)
    side[2] = 0
    side /= np.linalg.norm(side)
    for period in range(75):
        force = newton * min(1.0, period / 20) * side
        data.xfrc_applied[forearm, :3] = force
        data.xfrc_applied[forearm, 3:] = np.cross(data.site("region_forearm").xpos - data.xipos[forearm], force)
        simulation.advance(10)
        yield


def wrist_motion(simulation: Simulation, newton: float, *, locked: bool) -> float:
    """How far the wrist centre moves horizontally under the push [m]."""
    model, data = simulation.model, simulation.data
    if locked:
        for name in simulation.joint_names:
            if name.startswith("right_"):
                model.dof_damping[model.joint(f"human_{name}").dofadr[0]] = 1e6
    wrist = model.body("human_right_hand").id
    before = data.xpos[wrist].copy()
    for _ in pushed_sideways(simulation, newton):
        pass
    return float(np.linalg.norm((data.xpos[wrist] - before)[:2]))


@pytest.mark.parametrize("newton", [10.0, -10.0, 20.0])
def test_arm_yields_passively(settled: Simulation, newton: float) -> None:
    assert wrist_motion(settled, newton, locked=False) > 0.020


def test_locked_arm_does_not_yield(settled: Simulation) -> None:
    damping = settled.model.dof_damping.copy()
    try:
        assert wrist_motion(settled, 20.0, locked=True) <= 0.002
    finally:
        settled.model.dof_damping[:] = damping


def test_arm_slides_on_its_board_with_the_protocols_friction(settled: Simulation) -> None:
    """Once the arm slides, tangential over normal force is the coefficient: without the board's priority it would be 1,
    the proxies' own."""
    model, data = settled.model, settled.data
    board = model.geom("bed_armboard").id
    ratios, wrench = [], np.zeros(6)
    for _ in pushed_sideways(settled, 15.0):
        if settled.human_speed() < 0.05:
            continue
        for i in range(data.ncon):
            if board in data.contact[i].geom:
                mujoco.mj_contactForce(model, data, i, wrench)
                if wrench[0] > 1.0:
                    ratios.append(np.linalg.norm(wrench[1:3]) / wrench[0])
    assert len(ratios) > 10, "the arm must have slid"
    assert np.median(ratios) == pytest.approx(settled.protocol.scene.board_friction, rel=0.01)
    assert max(ratios) < 1.05 * settled.protocol.scene.board_friction


def test_mass_is_the_bodys(forearm_scene: Scene) -> None:
    model = forearm_scene.model
    assert model.body_subtreemass[model.body("human_pelvis").id] == pytest.approx(forearm_scene.body.mass_kg, rel=1e-6)


def test_force_is_that_of_tissue_and_of_contacts(pressing: Simulation) -> None:
    samples = pressing.advance(10)[-1]
    model, data = pressing.model, pressing.data
    row, wrench = pressing.tissue["forearm"].last(data, 1)[0], np.zeros(6)
    total, normal = row["force_n"].copy(), float(row["normal_n"])
    assert np.linalg.norm(total) > 1.0
    assert np.linalg.norm(row["centroid_m"] - data.site("tcp").xpos) < 0.015
    # Sensors hold the forces of the last step, which are still those of the contact list: those of the bone's core.
    bone = model.body("human_right_forearm").id
    for i in range(data.ncon):
        contact = data.contact[i]
        on_forearm = model.geom_bodyid[contact.geom[1]] == bone
        by_robot = model.geom(contact.geom[0]).name.startswith("robot_")
        if not (on_forearm and by_robot) or contact.efc_address < 0:
            continue
        mujoco.mj_contactForce(model, data, i, wrench)
        total += contact.frame.reshape(3, 3).T @ wrench[:3]
        normal += wrench[0]
    assert samples.force[-1, FOREARM] == pytest.approx(total, abs=1e-9)
    assert samples.normal[-1, FOREARM] == pytest.approx(normal, abs=1e-9)


def test_a_state_of_another_size_is_refused(pressing: Simulation) -> None:
    state = pressing.integration_state()
    told = rf"the state of this world has {state.size} numbers; the given one has shape \({state.size - 1},\)"
    with pytest.raises(SceneError, match=told):
        pressing.restore(state[:-1], comfort_arm_deg=52.5)
    np.testing.assert_array_equal(pressing.integration_state(), state)
