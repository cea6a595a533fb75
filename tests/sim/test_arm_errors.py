"""An arm that is not its model: a force that was not commanded, friction that was not compensated, and what is left out
of it for a protocol without such errors."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from pydantic import ValidationError

from carecontact.episode.randomization import settled_world, under_control
from carecontact.interface.robot import CONTROLS, EMBODIMENTS, PANDA
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import Protocol
from carecontact.protocol.sections import ArmErrors
from carecontact.sim.impedance import tcp_pose_in_base
from carecontact.sim.simulation import Simulation
from carecontact.world.draws import arm_bias_of
from carecontact.world.scene import build_scene

IDEAL = load_protocol("bathing-v3")
STIFFNESS = IDEAL.impedance.translational_n_m


def with_errors(errors: ArmErrors | None) -> Protocol:
    return IDEAL.model_copy(update={"arm_errors": errors})


def simulation(errors: ArmErrors | None) -> Simulation:
    """The robot parked beside the person, who lies still and far away."""
    made = Simulation(build_scene(with_errors(errors), target=None, skin=False))
    made.park()
    made.start()
    return made


def off_n(made: Simulation) -> np.ndarray:
    """(3,) force of the spring in base [N]."""
    made.refresh()
    return STIFFNESS * (made.control.target_in_base[:3] - tcp_pose_in_base(made.model, made.data, made.robot)[:3])


def test_the_bias_is_a_force_at_the_tool_along_the_axes_of_the_base() -> None:
    made = simulation(ArmErrors(force_bias_n=1.0, friction=0.0))
    made.force_bias_n = np.array([1.0, -2.0, 1.5])
    made.advance(2000)
    assert off_n(made) == pytest.approx(-made.force_bias_n, abs=0.01)


def test_friction_takes_one_to_two_newtons_at_the_tool_and_lets_it_stick() -> None:
    """Beside the lag of the damper, which is 126 N s/m at 0.02 m/s."""
    made = simulation(ArmErrors(force_bias_n=0.0))
    goal = made.control.target_in_base
    goal[2] -= 0.08
    made.set_goal(goal, 4.0)
    made.advance(1500)
    damper_n = 2 * np.sqrt(STIFFNESS * IDEAL.impedance.effective_mass_kg) * 0.02
    assert 1.0 < -off_n(made)[2] - damper_n < 2.0
    made.advance(1500)
    stuck = off_n(made)[2]
    made.advance(1000)
    assert -2.0 < stuck < -1.0
    assert off_n(made)[2] == pytest.approx(stuck, abs=0.15), "it hardly creeps in two seconds"


def test_the_default_friction_is_that_of_the_published_identification() -> None:
    """phi_1 and phi_2 of Gaz et al. 2019."""
    amplitude = np.array([0.54615, 0.87224, 0.64068, 1.2794, 0.83904, 0.30301, 0.56489])
    slope = np.array([5.1181, 9.0657, 10.136, 5.5903, 8.3469, 17.133, 10.336])
    assert pytest.approx(amplitude / 2 * np.tanh(slope * 0.15 / 2), abs=5e-4) == np.array(PANDA.friction_nm)


def test_an_ideal_arm_has_neither() -> None:
    made = simulation(None)
    assert not made.model.dof_frictionloss[made.model.joint(made.robot.joints[0]).dofadr].any()
    made.force_bias_n = np.array([1.0, 0.0, 0.0])
    made.advance(500)
    assert not made.data.xfrc_applied.any()


def test_friction_is_in_the_hash_of_the_model_and_the_bias_is_not() -> None:
    hashes = [
        build_scene(with_errors(errors), target=None, skin=False).model_sha256
        for errors in (None, ArmErrors(force_bias_n=0.0), ArmErrors(force_bias_n=2.0))
    ]
    assert hashes[0] != hashes[1] == hashes[2]


def test_the_seed_draws_the_bias_once_for_all_tasks_and_its_size_scales_it() -> None:
    one, two = (
        np.array([arm_bias_of(with_errors(ArmErrors(force_bias_n=size)), seed, "") for seed in range(400)])
        for size in (1.0, 2.0)
    )
    assert two == pytest.approx(2 * one)
    assert one.std(axis=0) == pytest.approx(np.ones(3), abs=0.1)
    assert abs(one.mean()) < 0.1
    assert not arm_bias_of(IDEAL, 0, "").any()
    assert arm_bias_of(with_errors(ArmErrors()), 0, "salt") != pytest.approx(one[0])


@pytest.mark.parametrize("control", ["cartesian-impedance", "droid"])
def test_a_trials_world_has_the_bias_under_every_control(control: str) -> None:
    protocol = with_errors(ArmErrors())
    made, _, _ = settled_world(protocol, task_id="T1", seed=3)
    if CONTROLS[control].joint is not None:
        made, _ = under_control(made, CONTROLS[control])
    assert made.force_bias_n == pytest.approx(arm_bias_of(protocol, 3, ""))
    made.advance(10)
    flange = made.model.body(made.robot.flange_body).id
    assert np.linalg.norm(made.data.xfrc_applied[flange, :3]) == pytest.approx(np.linalg.norm(made.force_bias_n))
    # The same power on the tool as a force at its centre point.
    jacobian = np.zeros((3, made.model.nv))
    mujoco.mj_forward(made.model, made.data)
    mujoco.mj_jacSite(made.model, made.data, jacobian, None, made.model.site(made.robot.tcp_site).id)
    applied = np.zeros(made.model.nv)
    force, moment = made.data.xfrc_applied[flange, :3], made.data.xfrc_applied[flange, 3:]
    mujoco.mj_applyFT(made.model, made.data, force, moment, made.data.xipos[flange], flange, applied)
    assert applied == pytest.approx(jacobian.T @ force, abs=1e-3)


def test_friction_that_was_never_identified_cannot_act(monkeypatch: pytest.MonkeyPatch) -> None:
    content = IDEAL.model_dump() | {"arm_errors": {}}
    assert Protocol.model_validate(content).arm_errors == ArmErrors()
    monkeypatch.setitem(EMBODIMENTS._rows, "caps", replace(PANDA, friction_nm=()))
    with pytest.raises(ValidationError, match=r"arm_errors\.friction: .* is not known; expected 0, got 1"):
        Protocol.model_validate(content)
    Protocol.model_validate(content | {"arm_errors": {"friction": 0.0}})
