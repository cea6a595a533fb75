"""The ring buffer of sensor samples, on a pendulum small enough to be stepped in every rhythm."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from carecontact.errors import SceneError
from carecontact.sim.history import SensorHistory

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
    assert values[0, history.columns("angle")].tolist() == [0.4]
    np.testing.assert_allclose(values[0, history.columns("place")], [0, 0, 1])
    np.testing.assert_allclose(values[0, history.columns("turn")], [np.cos(0.2), 0, np.sin(0.2), 0])
    with pytest.raises(KeyError):
        history.columns("weight")


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
