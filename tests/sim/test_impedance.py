from __future__ import annotations

from itertools import islice

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carecontact.interface.geometry import matrix_from_quat
from carecontact.protocol.load import load_protocol
from carecontact.sim.impedance import (
    Posture,
    TargetInterpolator,
    set_gains,
    steps_of_period,
    tcp_pose_in_base,
    write_target,
)
from carecontact.world.robot import add_robot

PROTOCOL = load_protocol("bathing-v3")
ROBOT, PARKED = PROTOCOL.scene.robot, np.array(PROTOCOL.scene.parked_joint_rad)


def parked(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos[:] = PARKED
    mujoco.mj_forward(model, data)
    return data


def build(*, wall_below_m: float | None = None) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Robot alone, parked, target on the TCP; optionally a stiff floor that far below the TCP."""
    spec = mujoco.MjSpec()
    spec.option.timestep = PROTOCOL.physics.dt_s
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    add_robot(spec, PROTOCOL)
    model = spec.compile()
    data = parked(model)
    if wall_below_m is not None:
        box, pos = mujoco.mjtGeom.mjGEOM_BOX, data.site("tcp").xpos - [0, 0, 0.05 + wall_below_m]
        spec.worldbody.add_geom(type=box, size=[0.3, 0.3, 0.05], pos=pos, contype=0, conaffinity=1)
        model = spec.compile()
        data = parked(model)
    write_target(model, data, ROBOT, tcp_pose_in_base(model, data, ROBOT))
    mujoco.mj_forward(model, data)
    return model, data


def ramp(model: mujoco.MjModel, data: mujoco.MjData, goal: np.ndarray, *, settle_s: float = 2.0) -> None:
    """Drive the target to ``goal`` under the speed limits, then wait."""
    interpolator = TargetInterpolator(PROTOCOL.physics)
    interpolator.reset(tcp_pose_in_base(model, data, ROBOT))
    interpolator.set_goal(goal, 0.1)
    steps = round(PROTOCOL.physics.target_period_s / PROTOCOL.physics.dt_s)
    for _ in range(75):
        write_target(model, data, ROBOT, interpolator.advance())
        mujoco.mj_step(model, data, steps)
    np.testing.assert_allclose(interpolator.advance(), goal, atol=1e-9)
    mujoco.mj_step(model, data, round(settle_s / PROTOCOL.physics.dt_s))
    mujoco.mj_forward(model, data)


def turned(pose: np.ndarray, angle_rad: float, axis: np.ndarray) -> np.ndarray:
    out, q = pose.copy(), np.zeros(4)
    mujoco.mju_axisAngle2Quat(q, axis, angle_rad)
    mujoco.mju_mulQuat(out[3:], q, pose[3:])
    return out


def test_settles_on_the_target_in_free_space() -> None:
    model, data = build()
    goal = tcp_pose_in_base(model, data, ROBOT)
    goal[:3] += [0.05, -0.08, -0.06]
    ramp(model, data, goal, settle_s=4.0)
    np.testing.assert_allclose(tcp_pose_in_base(model, data, ROBOT)[:3], goal[:3], atol=1e-6)


def test_target_and_tcp_use_the_same_base_frame() -> None:
    _, data = build()
    target = data.body("tcp_target")
    np.testing.assert_allclose(target.xpos, data.site("tcp").xpos, atol=1e-12)
    np.testing.assert_allclose(target.xmat, data.site("tcp").xmat, atol=1e-12)
    assert np.abs(data.actuator_force).max() < 1e-9


def test_follows_a_reorientation_of_46_degrees() -> None:
    model, data = build()
    start = tcp_pose_in_base(model, data, ROBOT)
    goal = turned(start, np.deg2rad(46), np.array([0.6, 0.8, 0.0]))
    ramp(model, data, goal, settle_s=4.0)
    now = tcp_pose_in_base(model, data, ROBOT)
    error = np.trace(matrix_from_quat(goal[3:]).T @ matrix_from_quat(now[3:]))
    assert np.arccos(np.clip((error - 1) / 2, -1, 1)) < 1e-3
    assert np.linalg.norm(now[:3] - goal[:3]) < 1e-4


@pytest.mark.parametrize("stiffness", [200.0, 400.0, 1000.0])
def test_push_on_a_wall_is_stiffness_times_overtravel(stiffness: float) -> None:
    model, data = build(wall_below_m=0.02)
    set_gains(model, np.repeat([stiffness, 20.0], 3), 1.0, PROTOCOL)
    goal = tcp_pose_in_base(model, data, ROBOT)
    goal[2] -= 0.06
    ramp(model, data, goal)
    overtravel = tcp_pose_in_base(model, data, ROBOT)[2] - goal[2]
    force = np.zeros(6)
    total = 0.0
    for i in range(data.ncon):
        mujoco.mj_contactForce(model, data, i, force)
        total += force[0]
    assert total == pytest.approx(stiffness * overtravel, rel=0.02)
    assert total == pytest.approx(stiffness * 0.04, rel=0.05)


def test_force_is_clamped_on_every_axis() -> None:
    model, data = build()
    pose = tcp_pose_in_base(model, data, ROBOT)
    pose[:3] += [2.0, -2.0, 2.0]
    write_target(model, data, ROBOT, turned(pose, 2.5, np.array([0.0, 0.0, 1.0])))
    mujoco.mj_forward(model, data)
    clamp = PROTOCOL.impedance.force_clamp_n
    np.testing.assert_allclose(np.abs(data.actuator_force[:3]), clamp)
    assert np.abs(data.actuator_force[3:]).max() == pytest.approx(PROTOCOL.impedance.torque_clamp_nm)
    assert (np.abs(data.qfrc_actuator) <= [87.0] * 4 + [12.0] * 3).all()


def test_gravity_is_compensated_with_the_gains_off() -> None:
    model, data = build()
    model.actuator_gainprm[:] = 0
    model.actuator_biasprm[:] = 0
    mujoco.mj_step(model, data, 1000)
    assert np.abs(data.qpos - PARKED).max() < 1e-9


def test_elbow_returns_to_the_posture_and_the_tcp_stays() -> None:
    model, data = build()
    start = tcp_pose_in_base(model, data, ROBOT)
    # Drive the elbow off along the null direction of the Jacobian, as a disturbance would, then let go.
    for hold, seconds in ((False, 1.0), (True, 8.0)):
        for _ in range(round(seconds / 0.02)):
            posture = PARKED if hold else PARKED + np.array([0.3, 0, -0.3, 0, 0, 0, 0])
            data.qfrc_applied[:7] = Posture(model, ROBOT, posture).torque(data)
            mujoco.mj_step(model, data, 10)
            assert np.linalg.norm(tcp_pose_in_base(model, data, ROBOT)[:3] - start[:3]) < 1e-3
        if not hold:
            assert np.abs(data.qpos - PARKED).max() > 0.05
    assert np.abs(data.qpos - PARKED).max() < 0.01


poses = st.builds(
    lambda p, q: np.array([*p, *(np.array(q) / np.linalg.norm(q))]),
    st.tuples(*[st.floats(-1, 1)] * 3),
    st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1),
)


@settings(max_examples=60, deadline=None)
@given(start=poses, goals=st.lists(st.tuples(poses, st.floats(0.02, 1.0)), min_size=1, max_size=3))
def test_target_never_exceeds_its_speed_limits_and_arrives(
    start: np.ndarray, goals: list[tuple[np.ndarray, float]]
) -> None:
    physics = PROTOCOL.physics
    interpolator = TargetInterpolator(physics)
    interpolator.reset(start)
    last = start
    for goal, period in goals:
        interpolator.set_goal(goal, period)
        for _ in range(12):
            pose = interpolator.advance()
            assert np.linalg.norm(pose[:3] - last[:3]) <= physics.max_tcp_speed_m_s * physics.target_period_s * (
                1 + 1e-6
            )
            turn = 2 * np.arccos(np.clip(abs(pose[3:] @ last[3:]), -1, 1))
            assert turn <= physics.max_tcp_rotation_rad_s * physics.target_period_s + 1e-6
            assert np.linalg.norm(pose[3:]) == pytest.approx(1.0)
            last = pose
    for _ in range(1500):
        last = interpolator.advance()
    np.testing.assert_allclose(last[:3], goals[-1][0][:3], atol=1e-12)
    assert abs(last[3:] @ goals[-1][0][3:]) == pytest.approx(1.0)


def test_short_way_is_spread_over_the_period() -> None:
    interpolator = TargetInterpolator(PROTOCOL.physics)
    start = np.array([0.4, 0, 0.3, 0, 1, 0, 0.0])
    interpolator.reset(start)
    interpolator.set_goal(start + np.array([0.01, 0, 0, 0, 0, 0, 0]), 0.1)
    x = [interpolator.advance()[0] for _ in range(6)]
    np.testing.assert_allclose(x, 0.4 + np.array([0.002, 0.004, 0.006, 0.008, 0.01, 0.01]), atol=1e-12)
    interpolator.set_goal(None, 0.1)
    assert interpolator.advance()[0] == pytest.approx(0.41)


def test_fifteen_hertz_alternates_33_33_34() -> None:
    assert list(islice(steps_of_period(15, 0.002), 6)) == [33, 33, 34, 33, 33, 34]


@given(rate_hz=st.integers(1, 50), dt_s=st.sampled_from([0.001, 0.002, 0.004]), seconds=st.integers(1, 5))
def test_mean_rate_is_exact(rate_hz: int, dt_s: float, seconds: int) -> None:
    steps = list(islice(steps_of_period(rate_hz, dt_s), rate_hz * seconds))
    assert sum(steps) == round(seconds / dt_s)
    assert max(steps) - min(steps) <= 1


def test_rate_beyond_the_physics_is_refused() -> None:
    with pytest.raises(ValueError, match="faster than the physics"):
        steps_of_period(600, 0.002)
