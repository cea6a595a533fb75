"""The joint impedance: its law, its limits, and DROID's velocities against a wall."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import repeat

import mujoco
import numpy as np
import pytest

from carecontact.episode.drivers import DROID_STEP_RAD
from carecontact.interface.robot import CONTROLS, JointImpedance
from carecontact.protocol.load import load_protocol
from carecontact.sim.controllers import JointControl
from carecontact.sim.impedance import steps_of_period
from carecontact.world.robot import add_robot, replace_impedance

PROTOCOL = load_protocol("bathing-v3")
PARKED = np.array(PROTOCOL.scene.parked_joint_rad)
DROID_HZ, PERIOD_STEPS = 15.0, 10
LAWS = [name for name, control in CONTROLS.items() if control.joint is not None]


def law_of(name: str) -> JointImpedance:
    law = CONTROLS[name].joint
    assert law is not None
    return law


def arm(name: str, *, wall_below_m: float | None = None) -> tuple[mujoco.MjModel, mujoco.MjData, JointControl]:
    """The robot alone under joint control, parked; optionally a hard floor that far below its tool."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.timestep = PROTOCOL.physics.dt_s
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    add_robot(spec, PROTOCOL)
    replace_impedance(spec, PROTOCOL.scene.robot, law_of(name))
    if wall_below_m is not None:
        model = spec.compile()
        data = parked(model)
        box, pos = mujoco.mjtGeom.mjGEOM_BOX, data.site("tcp").xpos - [0, 0, 0.05 + wall_below_m]
        spec.worldbody.add_geom(type=box, size=[0.3, 0.3, 0.05], pos=pos, contype=0, conaffinity=1)
    model = spec.compile()
    data = parked(model)
    control = JointControl(model, data, PROTOCOL, law_of(name))
    control.park()
    return model, data, control


def parked(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos[:] = PARKED
    mujoco.mj_forward(model, data)
    return data


def law_torque(name: str, model: mujoco.MjModel, data: mujoco.MjData, target: np.ndarray) -> np.ndarray:
    """The law as it is written in ``JointImpedance``, from the state and nothing else."""
    law, now = law_of(name), mujoco.MjData(model)
    now.qpos[:], now.qvel[:] = data.qpos, data.qvel
    mujoco.mj_forward(model, now)
    jacobian = np.zeros((6, model.nv))
    mujoco.mj_jacBody(model, now, jacobian[:3], jacobian[3:], model.body("robot_hand").id)
    spring = jacobian.T @ np.diag(law.cartesian_stiffness) @ jacobian + np.diag(law.stiffness_nm_rad)
    damper = jacobian.T @ np.diag(law.cartesian_damping) @ jacobian + np.diag(law.damping_nms_rad)
    coriolis = now.qfrc_bias - now.qfrc_gravcomp
    torque = spring @ (target - now.qpos) - damper @ now.qvel
    return np.clip(torque, -np.array(law.torque_limit_nm), law.torque_limit_nm) + coriolis


def commanded_torque(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """What the compiled servos and the held Coriolis torque give in the present state."""
    now = mujoco.MjData(model)
    now.qpos[:], now.qvel[:], now.ctrl[:] = data.qpos, data.qvel, data.ctrl
    mujoco.mj_forward(model, now)
    return now.qfrc_actuator + data.qfrc_applied


def velocities(seconds: float) -> Iterator[np.ndarray]:
    """Normalised joint velocities of a reach out and back, smooth and with every joint moving."""
    ticks = int(seconds * DROID_HZ)
    for k in range(ticks):
        phase = 2 * np.pi * k / ticks
        yield 0.6 * np.sin(phase) * np.array([1.0, 0.7, -0.5, -0.8, 0.6, 0.9, -1.0])


def follow(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    control: JointControl,
    commands: Iterable[np.ndarray],
    before_step: Callable[[bool], None] = lambda refreshed: None,
) -> None:
    """DROID's loop: at each tick the target becomes the measured angles plus the step, held until the next.

    ``before_step`` is called before each physics step, with True where the control has just been refreshed.
    """
    periods = steps_of_period(DROID_HZ, model.opt.timestep)
    for v in commands:
        control.set_target(data.qpos + DROID_STEP_RAD * v / max(1.0, float(np.abs(v).max())))
        for step in range(next(periods)):
            if step % PERIOD_STEPS == 0:
                control.refresh()
            before_step(step % PERIOD_STEPS == 0)
            mujoco.mj_step(model, data)


def test_torque_of_a_case_computed_by_hand() -> None:
    """Without a Cartesian part, at rest and one joint 0.1 rad off, each joint's torque is its own spring's."""
    _, data, control = arm("droid-sim-evals")
    control.set_target(PARKED + np.array([0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0]))
    control.refresh()
    mujoco.mj_forward(control._model, data)
    np.testing.assert_allclose(data.qfrc_actuator, [0, 0, 0, 4.0, 0, 0, 0], atol=1e-12)


@pytest.mark.parametrize("name", LAWS)
def test_torque_is_the_law_at_a_refresh_and_nearly_so_inside_a_period(name: str) -> None:
    model, data, control = arm(name)
    apart: dict[bool, float] = {True: 0.0, False: 0.0}
    moved = 0.0

    def compare(refreshed: bool) -> None:
        nonlocal moved
        wanted = law_torque(name, model, data, control._target)
        apart[refreshed] = max(apart[refreshed], float(np.abs(commanded_torque(model, data) - wanted).max()))
        moved = max(moved, float(np.abs(data.qpos - PARKED).max()))

    follow(model, data, control, velocities(4.0), compare)
    assert apart[True] < 1e-9
    assert 1e-6 < apart[False] < 0.6
    assert moved > 0.3


@pytest.mark.parametrize("name", LAWS)
def test_follows_a_recorded_sequence_of_velocities_with_the_stated_lag(name: str) -> None:
    """docs/vla.md states the share of the commanded motion that is reached."""
    model, data, control = arm(name)
    commands = list(velocities(4.0))
    half = len(commands) // 2
    follow(model, data, control, commands[:half])
    commanded = DROID_STEP_RAD * np.sum(commands[:half], axis=0)
    share = (data.qpos - PARKED) / commanded
    low, high = {"droid": (0.30, 0.50), "droid-sim-evals": (0.25, 0.32)}[name]
    assert ((share > low) & (share < high)).all()


def test_pushing_on_a_rigid_box_does_not_wind_up() -> None:
    model, data, control = arm("droid", wall_below_m=0.001)
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jacSite(model, data, jacobian, None, model.site("tcp").id)
    down = np.linalg.pinv(jacobian) @ [0, 0, -1.0]
    force, steps = np.zeros(6), []

    def push(refreshed: bool) -> None:
        total = 0.0
        for i in range(data.ncon):
            mujoco.mj_contactForce(model, data, i, force)
            total += force[0]
        steps.append(total)

    follow(model, data, control, repeat(0.3 * down / np.abs(down).max(), int(10 * DROID_HZ)), push)
    newton = np.array(steps)
    first = int(np.argmax(newton > 0))
    second = round(1 / model.opt.timestep)
    assert newton[-second:].min() > 5.0
    assert newton[first + second :].max() <= 1.25 * newton[first : first + second].max()


def test_torque_stays_within_the_joints_limits() -> None:
    model, data, control = arm("droid-sim-evals")
    control.set_target(PARKED + 2.0)
    control.refresh()
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.qfrc_actuator, law_of("droid-sim-evals").torque_limit_nm)


def test_a_joint_faster_than_its_limit_is_remembered() -> None:
    _, data, control = arm("droid")
    data.qvel[3] = -2.0
    control.refresh()
    assert control.fastest is None
    data.qvel[3] = -2.1
    control.refresh()
    data.qvel[3] = -5.0
    control.refresh()
    assert control.fastest == (4, pytest.approx(2.1))


def test_the_target_in_base_is_where_the_tool_would_be() -> None:
    model, _, control = arm("droid")
    goal = PARKED + 0.1
    control.set_target(goal)
    there = mujoco.MjData(model)
    there.qpos[:] = goal
    mujoco.mj_forward(model, there)
    in_world = there.site("tcp").xpos - np.array(PROTOCOL.scene.robot_base_m)
    assert np.linalg.norm(control.target_in_base[:3]) == pytest.approx(np.linalg.norm(in_world))
