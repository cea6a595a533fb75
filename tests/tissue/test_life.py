"""What a person does by itself, in small worlds whose forces are known."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
import numpy.typing as npt
import pytest

import carecontact.tissue.life
from carecontact.errors import SceneError
from carecontact.lab.validation.alive import TENSES_S
from carecontact.report.timeline import TENSE_S
from carecontact.tissue.life import Life, MotionScript, Move, Pull, add_life, breath
from carecontact.tissue.plugin import Readings, add_region
from tests.tissue.sheets import CYLINDER, sheet, tissue

STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
BREATH = MotionScript(breath_hz=0.3, inspiration_share=0.45, phase=0.2, breath_m=(0.004, 0.0))
ABDUCTION = "human_right_upper_arm_abduction"
SHIFT = np.array([0.12, 0.0, 0.0, 0.0])
MOVES = MotionScript(moves=(Move(time_s=0.5, duration_s=1.0, lift_rad=0.0, shift_rad=SHIFT),))
RADIUS_M, DEPTH_M = 0.04, 0.001


def breathing_sheet(*, half_m: float = 0.05, spacing_m: float = 0.0025) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A sheet on a breathing wall, which the fixed disc is DEPTH_M deep in at the end of a breath out."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.timestep, spec.option.gravity = 0.002, [0, 0, 0]
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    wall = spec.worldbody.add_body(name="wall", mass=0.001, explicitinertial=True, inertia=[1e-5] * 3)
    wall.add_joint(name="wall", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1], armature=2.0)
    joint, affine = mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtBias.mjBIAS_AFFINE
    servo = spec.add_actuator(name="breathes_abdomen", trntype=joint, target="wall", biastype=affine)
    servo.gainprm[0], servo.biasprm[:3] = 1e5, [0, -1e5, -900]
    tool = spec.worldbody.add_body(name="tool", pos=[0, 0, 0.02 - DEPTH_M])
    tool.add_geom(type=CYLINDER, size=[RADIUS_M, 0.02, 0], contype=1, conaffinity=0)
    law = tissue(a_n_m3=1e6, contact_n_m3=2e8, damping_ns_m3=100.0)
    mesh = sheet(half_m=half_m, spacing_m=spacing_m)
    add_region(spec, name="sheet", bone=wall, mesh=mesh, tissue=law, tools="tool", layer_m=0.0, entry_m=0.0)
    add_life(spec, spec.worldbody.add_body(name="carrier"))
    model = spec.compile()
    return model, mujoco.MjData(model)


def arm() -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A forearm of 0.3 m on the shoulder's abduction, with a spring and muscles, on which a finger can be set."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.timestep, spec.option.gravity = 0.002, [0, 0, 0]
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    made = spec.worldbody.add_body(name="human_right_forearm")
    made.add_geom(type=CYLINDER, size=[0.03, 0.15, 0], pos=[0.3, 0, 0], quat=[0.7071, 0, 0.7071, 0], mass=2.0)
    passive = {"stiffness": [1.5, 0, 0], "damping": [0.5, 0, 0]}
    made.add_joint(name=ABDUCTION, axis=[0, 0, 1], range=[-1, 1], limited=mujoco.mjtLimited.mjLIMITED_TRUE, **passive)
    affine = mujoco.mjtGain.mjGAIN_AFFINE
    for kind, gain, numbers in (("holds", affine, [0, -200, -15]), ("turns", mujoco.mjtGain.mjGAIN_FIXED, [1, 0, 0])):
        made = spec.add_actuator(
            name=f"{kind}_right_upper_arm_abduction", trntype=mujoco.mjtTrn.mjTRN_JOINT, target=ABDUCTION, gaintype=gain
        )
        made.gainprm[:3] = numbers
    finger = spec.worldbody.add_body(name="finger", pos=[0.4, 0.1, 0.0])
    finger.add_joint(name="finger", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 1, 0])
    finger.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.02, 0, 0], mass=0.2)
    body, contact = mujoco.mjtObj.mjOBJ_BODY, mujoco.mjtSensor.mjSENS_CONTACT
    pair = {"objtype": body, "objname": "finger", "reftype": body, "refname": "human_right_forearm"}
    spec.add_sensor(name="net_right_forearm", type=contact, intprm=[1 << 1, 3, 1], **pair)
    add_life(spec, spec.worldbody.add_body(name="carrier"))
    model = spec.compile()
    for joint in ("right_upper_arm_flexion", "right_upper_arm_rotation", "right_forearm_flexion"):
        assert mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, f"human_{joint}") < 0
    return model, mujoco.MjData(model)


def run(model: mujoco.MjModel, data: mujoco.MjData, seconds: float) -> npt.NDArray[np.float64]:
    """(n, state) after every step."""
    out = []
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
        state = np.zeros(mujoco.mj_stateSize(model, STATE))
        mujoco.mj_getState(model, data, state, STATE)
        out.append(state)
    return np.array(out)


def test_a_wall_that_is_not_awake_stays_where_it_is() -> None:
    model, data = breathing_sheet(spacing_m=0.005)
    mujoco.mj_step(model, data, 500)
    # Only the disc pushes on it, with nearly 5 N.
    assert data.qpos[0] == pytest.approx(-4.7 / 1e5, rel=0.1)


def test_the_force_of_a_fixed_tool_swings_with_the_breath_as_the_law_says() -> None:
    """A flat disc on independent springs in series with a contact layer 200 times as stiff, and with the servo of the
    wall."""
    model, data = breathing_sheet()
    life, felt = Life(model), Readings(model, "sheet")
    fast = replace(BREATH, breath_hz=0.5)
    life.wake(data, fast)
    mujoco.mj_step(model, data, 250)
    out, force = [], []
    for _ in range(1020):
        mujoco.mj_step(model, data)
        height, _ = breath(fast, data.time)
        assert life.breath_m(data)[0] == data.actuator_length[0]
        out.append([0.004 * height, data.qpos[0]])
        force.append(-felt.last(data, 1)["force_n"][0, 2])
    wanted, moved = np.array(out).T
    assert np.ptp(wanted) > 0.0039
    stiffness = 1e6 / 1.005 * np.pi * RADIUS_M**2
    expected = (DEPTH_M + wanted) / (1 / stiffness + 1 / 1e5)
    np.testing.assert_allclose(moved, wanted - np.array(force) / 1e5, atol=5e-6)
    # The disc's rim is rounded with 2 mm, and bears less the shallower the disc lies.
    np.testing.assert_allclose(force, expected, rtol=0.03, atol=0.03 * max(expected))
    assert np.ptp(force) == pytest.approx(np.ptp(expected), rel=0.02)
    assert max(force) > 4.5 * min(force)


def test_breath_is_half_a_cosine_in_and_another_out() -> None:
    still = replace(BREATH, phase=0.0)
    assert breath(still, 0.0) == (0.0, 0.0)
    assert breath(still, 0.45 / 0.3)[0] == pytest.approx(1.0)
    for time_s in np.linspace(0, 4, 41):
        rate = (breath(BREATH, time_s + 1e-6)[0] - breath(BREATH, time_s - 1e-6)[0]) / 2e-6
        assert breath(BREATH, time_s)[1] == pytest.approx(rate, abs=1e-4)


def test_the_arm_changes_its_place_and_stays_there() -> None:
    model, data = arm()
    Life(model).wake(data, MOVES)
    angle = run(model, data, 4.0)[:, 1]
    at = {time_s: angle[round(time_s / 0.002) - 1] for time_s in (0.5, 1.5, 4.0)}
    assert at[0.5] == pytest.approx(0.0, abs=1e-6)
    assert at[1.5] == pytest.approx(0.12, abs=0.005)
    # The passive spring rests at the new place.
    assert at[4.0] == pytest.approx(0.12, abs=0.001)
    assert 0.0 < Life(model).work_j(data)[1] < 1.0
    assert (np.diff(angle) > -1e-4).all()


def test_an_arm_that_was_pushed_aside_moves_from_where_it_lies() -> None:
    """It does not first spring back to its old place, against the tool that holds it."""
    model, data = arm()
    data.joint("finger").qpos[:] = 1.0
    life = Life(model)
    life.wake(data, MotionScript(moves=(replace(MOVES.moves[0], time_s=3.0),)))
    data.joint(ABDUCTION).qfrc_applied[:] = -0.15
    torque, angle = [], []
    for _ in range(3000):
        mujoco.mj_step(model, data)
        torque.append(float(life.torque_nm(data)[0]))
        angle.append(data.joint(ABDUCTION).qpos[0])
    assert angle[1449] == pytest.approx(-0.1, abs=0.005)
    assert angle[1550] == pytest.approx(angle[1449], abs=0.003)
    assert angle[2100] == pytest.approx(angle[1449] + 0.12, abs=0.005)
    assert max(np.abs(torque)) < 2.0
    assert max(np.abs(np.diff(torque))) < 0.1


def test_a_withdrawal_ends_the_change_of_posture_and_none_begins_meanwhile() -> None:
    model, data = arm()
    life = Life(model)
    moves = (*MOVES.moves, Move(time_s=1.5, duration_s=1.0, lift_rad=0.0, shift_rad=3 * SHIFT))
    pull = Pull(force_n=20.0, for_s=0.05, delay_s=0.1, duration_s=1.0, shift_rad=-SHIFT)
    life.wake(data, MotionScript(moves=moves, pull=pull))
    data.joint("finger").qpos[:] = -0.05
    run(model, data, 0.8)
    angle = press(model, data, 60.0, 0.4)[:, 1]
    pulled = life.pulls_s(data)[0]
    assert pulled == pytest.approx(0.95, abs=0.03)
    last = np.append(angle, press(model, data, 0.0, 3.0)[:, 1])
    from_rad = last[round((pulled - 0.1 - 0.8) / 0.002)]
    assert last[-1] == pytest.approx(from_rad - 0.12, abs=0.02)
    assert last[round((pulled - 0.8) / 0.002) :].max() < from_rad


@pytest.mark.parametrize(
    ("script", "stiffness_nm_rad"),
    [(MotionScript(), 1.5), (MotionScript(tone=0.15), 1.5 + 0.15 * 200.0), (MotionScript(help=0.8), 0.2 * 1.5)],
    ids=["passive", "holds", "helps"],
)
def test_a_push_turns_the_joint_as_far_as_the_manner_s_stiffness_says(
    script: MotionScript, stiffness_nm_rad: float
) -> None:
    model, data = arm()
    data.joint("finger").qpos[:] = 1.0
    Life(model).wake(data, script)
    data.joint(ABDUCTION).qfrc_applied[:] = 0.05
    run(model, data, 12.0)
    assert data.joint(ABDUCTION).qpos[0] == pytest.approx(0.05 / stiffness_nm_rad, rel=0.01)


def test_a_person_that_is_not_awake_has_no_muscles() -> None:
    model, data = arm()
    data.ctrl[:] = 5.0
    mujoco.mj_step(model, data, 10)
    assert (data.ctrl == 0).all()
    assert data.qpos[0] == 0.0


@pytest.mark.parametrize("number", ["NOW", "MOVED", "PULLED", "DRAWN"])
def test_a_state_that_the_person_did_not_write_is_refused(number: str) -> None:
    model, data = arm()
    scalars = ("LIFTED", "EFFORT", "FROM", "NOW", "ONSET", "MOVED", "OVER", "PULLED", "DRAWN")
    data.plugin_state[2 + 4 * 4 + scalars.index(number)] = 1e8
    with pytest.raises(mujoco.FatalError, match=r"carecontact\.life: plugin_state was not written by it"):
        mujoco.mj_step(model, data)


def press(model: mujoco.MjModel, data: mujoco.MjData, newton: float, seconds: float) -> npt.NDArray[np.float64]:
    data.joint("finger").qfrc_applied[:] = -newton
    return run(model, data, seconds)


@pytest.mark.parametrize(("newton", "seconds", "pulled"), [(15.0, 1.0, 0), (30.0, 0.03, 0), (30.0, 0.3, 1)])
def test_the_arm_is_withdrawn_after_more_than_a_force_for_a_time(newton: float, seconds: float, pulled: int) -> None:
    model, data = arm()
    life = Life(model)
    life.wake(
        data, MotionScript(tone=1.0, pull=Pull(force_n=20.0, for_s=0.05, delay_s=0.1, duration_s=0.5, shift_rad=-SHIFT))
    )
    data.joint("finger").qpos[:] = -0.05
    press(model, data, 5.0, 1.0)
    assert (life.pulls_s(data) < 0).all()
    began = data.time
    angle = press(model, data, newton, seconds)[:, 1]
    press(model, data, 1.0, 1.0)
    assert (life.pulls_s(data) > 0).sum() == pulled
    if pulled:
        # Contact takes a few steps to bear the new force.
        assert life.pulls_s(data)[0] == pytest.approx(began + 0.05 + 0.1, abs=0.012)
        from_rad = angle[round((life.pulls_s(data)[0] - began - 0.1) / 0.002)]
        assert from_rad < -0.01
        assert data.joint(ABDUCTION).qpos[0] == pytest.approx(from_rad - 0.12, abs=0.01)


@pytest.mark.parametrize("when_s", [0.3, 0.9])
def test_a_state_restored_in_the_middle_goes_on_bit_for_bit(when_s: float) -> None:
    """In mid-breath, and in the middle of a movement and of a withdrawal that is about to begin."""
    for world, script in (
        (partial(breathing_sheet, spacing_m=0.01), BREATH),
        (arm, replace(MOVES, pull=Pull(force_n=1.0, for_s=0.05, delay_s=0.6, duration_s=0.5, shift_rad=-SHIFT))),
    ):
        model, data = world()
        Life(model).wake(data, script)
        if world is arm:
            data.joint("finger").qpos[:], data.joint("finger").qfrc_applied[:] = -0.05, -3.0
        first = run(model, data, when_s)[-1]
        rest = run(model, data, 1.0)[-1]
        if world is arm:
            assert (Life(model).pulls_s(data) > 0).any()
        other = mujoco.MjData(model)
        mujoco.mj_setState(model, other, first, STATE)
        np.testing.assert_array_equal(run(model, other, 1.0)[-1], rest)


def test_a_model_without_it_is_refused() -> None:
    with pytest.raises(SceneError, match="does nothing by itself"):
        Life(mujoco.MjSpec().compile())


def test_pages_and_checks_know_when_muscles_tense() -> None:
    source = Path(carecontact.tissue.life.__file__).with_name("c") / "life.c"
    found = re.search(r"RISE = ([0-9.]+)", source.read_text())
    assert found is not None
    assert float(found[1]) == TENSE_S == TENSES_S


def test_the_state_of_a_person_who_is_awake_needs_a_world_that_knows_what_it_does() -> None:
    model, data = arm()
    Life(model).wake(data, MOVES)
    state = run(model, data, 0.1)[-1]
    fresh, other = arm()
    Life(fresh).check_known(other)
    mujoco.mj_setState(fresh, other, state, STATE)
    with pytest.raises(SceneError, match="the person of this world never woke"):
        Life(fresh).check_known(other)
    Life(fresh).wake(other, MOVES)
    mujoco.mj_setState(fresh, other, state, STATE)
    Life(fresh).check_known(other)


@pytest.mark.parametrize(
    ("script", "message"),
    [
        (replace(BREATH, breath_hz=np.nan), "breath: every number must be finite"),
        (replace(BREATH, breath_hz=50.0), r"frequency_hz: .* both in 0.05 to 1, got \[50, 50\]"),
        (replace(BREATH, breath_m=(0.5, 0.0)), "abdomen_m: .* in 0 to 0.03"),
        (replace(BREATH, phase=-0.1), "phase: expected 0 to 1, got -0.1"),
        (replace(BREATH, inspiration_share=0.0), "inspiration_share: .* greater than or equal to 0.2"),
        (MotionScript(tone=1.5), "tone: expected 0 to 1"),
        (MotionScript(moves=(replace(MOVES.moves[0], duration_s=0.01),)), "duration_s: .* in 0.4 to 5"),
        (
            MotionScript(moves=(replace(MOVES.moves[0], shift_rad=np.full(4, 3.0)),)),
            "shift_rad: expected -1 to 1, got 3",
        ),
        (MotionScript(moves=MOVES.moves * 65), "with 65 moves; expected at most 64"),
        (MotionScript(pull=Pull(force_n=1e4, for_s=0.05, delay_s=0.1, duration_s=0.5, shift_rad=SHIFT)), "force_n: "),
    ],
)
def test_a_script_that_no_protocol_could_ask_for_is_refused(script: MotionScript, message: str) -> None:
    model, data = arm()
    with pytest.raises(SceneError, match=message):
        Life(model).wake(data, script)
    assert not data.plugin_state.any()


def test_a_person_may_hold_its_breath() -> None:
    model, data = breathing_sheet()
    Life(model).wake(data, replace(BREATH, breath_hz=0.0))
