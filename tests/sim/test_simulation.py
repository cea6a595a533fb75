"""The world as physics: history, settling, passive response. Force balance: tests/validation."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import numpy.typing as npt
import pytest

from carecontact.episode import randomization as stored
from carecontact.errors import SceneError
from carecontact.lab.validation.subject import skin_points
from carecontact.recording.schema import SEGMENTS
from carecontact.sim.simulation import SensorHistory, Simulation
from carecontact.system import CACHE_VARIABLE
from carecontact.world.draws import Place, move_person
from carecontact.world.room import SUPPORT
from carecontact.world.scene import Scene
from tests.sim.conftest import COMFORT_ARM_DEG

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
    under_tool = np.linalg.norm(skin_points(pressing, "forearm") - data.site("tcp").xpos, axis=1) < 0.010
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
    drift = np.abs(simulation.advance(5000)[-1].human_joint[-1] - settled.joint_position)
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
    message = rf"the state of this world has {state.size} numbers; the given one has shape \({state.size - 1},\)"
    with pytest.raises(SceneError, match=message):
        pressing.restore(state[:-1], comfort_arm_deg=52.5)
    np.testing.assert_array_equal(pressing.integration_state(), state)


# The ring buffer of sensor samples, on a pendulum small enough to be stepped in every rhythm.

DEPTH = 7


def pendulum(*depths: int) -> mujoco.MjModel:
    """Sensors of dimension 1, 3 and 4, each with the history depth asked for."""
    spec = mujoco.MjSpec()
    spec.option.timestep = 0.002
    body = spec.worldbody.add_body(name="bob", pos=[0, 0, 1])
    body.add_joint(name="pivot", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 1, 0])
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, pos=[0.3, 0, 0], size=[0.05, 0, 0])
    kind, obj = mujoco.mjtSensor, mujoco.mjtObj
    rows = [
        ("angle", kind.mjSENS_JOINTPOS, obj.mjOBJ_JOINT, "pivot"),
        ("place", kind.mjSENS_FRAMEPOS, obj.mjOBJ_XBODY, "bob"),
        ("turn", kind.mjSENS_FRAMEQUAT, obj.mjOBJ_XBODY, "bob"),
    ]
    for (name, sensor, objtype, objname), depth in zip(rows, depths, strict=False):
        spec.add_sensor(name=name, type=sensor, objtype=objtype, objname=objname, nsample=depth)
    return spec.compile()


@pytest.mark.parametrize("rhythm", [[1] * 30, [7, 7, 7], [3, 5, 1, 7, 2, 6, 4, 7], [10, 25, 7]])
def test_last_steps_are_returned_oldest_first_in_every_rhythm(rhythm: list[int]) -> None:
    """Also across the wrap of the buffer, and after more steps than it holds."""
    model = pendulum(DEPTH, DEPTH, DEPTH)
    history, data, reference = SensorHistory(model), mujoco.MjData(model), mujoco.MjData(model)
    times, values = [], []
    for steps in rhythm:
        for _ in range(steps):
            times.append(reference.time)
            mujoco.mj_step(model, reference)
            values.append(reference.sensordata.copy())
        mujoco.mj_step(model, data, steps)
        count = min(steps, DEPTH)
        got_times, got = history.last(data, count)
        np.testing.assert_array_equal(got, values[-count:])
        np.testing.assert_allclose(got_times, times[-count:], atol=1e-12)
    assert len(np.unique(values, axis=0)) == len(values)


def test_columns_name_the_components() -> None:
    model = pendulum(DEPTH, DEPTH, DEPTH)
    history, data = SensorHistory(model), mujoco.MjData(model)
    data.qpos[0] = 0.4
    mujoco.mj_step(model, data)
    _, values = history.last(data, 1)
    # A sample holds what was true at the step's start.
    assert values[0, history.columns["angle"]].tolist() == [0.4]
    np.testing.assert_allclose(values[0, history.columns["place"]], [0, 0, 1])
    np.testing.assert_allclose(values[0, history.columns["turn"]], [np.cos(0.2), 0, np.sin(0.2), 0])


def test_what_is_returned_is_a_copy() -> None:
    model = pendulum(DEPTH, DEPTH, DEPTH)
    history, data = SensorHistory(model), mujoco.MjData(model)
    mujoco.mj_step(model, data, 5)
    times, values = history.last(data, 5)
    kept = times.copy(), values.copy()
    mujoco.mj_step(model, data, 5)
    np.testing.assert_array_equal(times, kept[0])
    np.testing.assert_array_equal(values, kept[1])


@pytest.mark.parametrize("count", [0, -1, DEPTH + 1])
def test_more_than_is_kept_is_refused(count: int) -> None:
    model = pendulum(DEPTH, DEPTH, DEPTH)
    history, data = SensorHistory(model), mujoco.MjData(model)
    mujoco.mj_step(model, data, 20)
    with pytest.raises(SceneError, match=f"count {count}: expected 1 to {DEPTH}"):
        history.last(data, count)


@pytest.mark.parametrize(
    ("depths", "counts"), [((7, 5, 7), r"\[5, 7\]"), ((7, 0, 7), r"\[0, 7\]"), ((0, 0, 0), r"\[0\]"), ((), r"\[\]")]
)
def test_sensors_must_keep_the_same_history(depths: tuple[int, ...], counts: str) -> None:
    with pytest.raises(SceneError, match=rf"same history, got sample counts {counts}"):
        SensorHistory(pendulum(*depths))


# A person who lies elsewhere lies there as before: on the bed, the arm on its board.

PLACE = Place(along_m=0.04, across_m=-0.03, yaw_deg=-5.0)


def elsewhere(scene: Scene, place: Place) -> Scene:
    moved = replace(scene, model=copy.copy(scene.model))
    move_person(moved.model, place)
    return moved


@pytest.fixture(scope="module")
def moved(forearm_scene: Scene) -> Simulation:
    simulation = Simulation(elsewhere(forearm_scene, PLACE))
    simulation.settle(COMFORT_ARM_DEG)
    simulation.refresh()
    return simulation


def on_board(simulation: Simulation, body: str) -> np.ndarray:
    """Origin of a body in the frame that moves with the person (3,)."""
    support, data = simulation.data.body(SUPPORT), simulation.data
    return support.xmat.reshape(3, 3).T @ (data.body(body).xpos - support.xpos)


@pytest.mark.parametrize("body", ["human_right_hand", "human_right_forearm", "human_head", "human_pelvis"])
def test_the_person_settles_as_in_the_protocols_place(moved: Simulation, settled: Simulation, body: str) -> None:
    settled.refresh()
    np.testing.assert_allclose(on_board(moved, body), on_board(settled, body), atol=0.003)
    assert moved.comfort_arm_deg() == pytest.approx(settled.comfort_arm_deg(), abs=0.3)
    away = moved.data.body(body).xpos - settled.data.body(body).xpos
    assert np.linalg.norm(away[:2]) > 0.02


def test_the_arm_rests_on_the_board_that_moved(moved: Simulation) -> None:
    board = moved.model.geom("bed_armboard").id
    met = {moved.model.geom(int(g)).name for c in moved.data.contact for g in c.geom if board in c.geom}
    assert {"human_proxy_right_elbow", "human_proxy_right_wrist"} <= met


def test_robot_bed_and_cameras_stay(moved: Simulation, settled: Simulation) -> None:
    np.testing.assert_array_equal(moved.pose_base_in_world, settled.pose_base_in_world)
    for name in ("bed_mattress", "bed_head"):
        np.testing.assert_array_equal(moved.data.geom(name).xpos, settled.data.geom(name).xpos)
    np.testing.assert_array_equal(moved.data.camera("overhead").xpos, settled.data.camera("overhead").xpos)


def test_a_stored_person_is_not_taken_for_one_who_lies_elsewhere(
    forearm_scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All have the compiled model's hash, so that their scores pool: the place alone must tell them apart."""
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    asked: list[Simulation] = []
    real = stored.Settled(duration_s=2.0, comfort_arm_deg=50.0, joint_position=np.zeros(3), wrist_in_world=np.zeros(3))
    monkeypatch.setattr(Simulation, "settle", lambda self, angle: asked.append(self) or real)
    places = [Place(), PLACE, replace(PLACE, yaw_deg=-4.99), replace(PLACE, along_m=0.0), PLACE]
    for place in places:
        stored.settle(Simulation(elsewhere(forearm_scene, place)), 50.0, model_sha256="0" * 64)
    assert len(asked) == 4, "the last is the second again"
