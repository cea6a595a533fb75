"""What cannot do a task passes no gate in simulation; what does not look fails where the person lies elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.audit.run import audit
from carecontact.human.library import body_names
from carecontact.lab.validation.run import CHECKS, Validation, validate
from carecontact.policies.registry import POLICIES, role_of
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording import Recording
from carecontact.running.trial import run_trial
from carecontact.scoring import TrialScore, score_recording
from carecontact.serving.conversation import PolicySetup
from carecontact.sim.impedance import steps_of_period
from carecontact.sim.simulation import Simulation
from carecontact.world.draws import posture_of
from carecontact.world.scene import build_scene
from tests.lab.validation.defects import (
    half_stiff,
    old_bone,
    overdamped,
    soft_contact,
    soft_upper_arm,
    uncoupled,
    undamped,
)

LEVEL = load_protocol("bathing-wide-v2", level="L1")


def run(policy: str, task_id: str, seed: int) -> TrialScore:
    spec = TrialSpec(protocol=LEVEL, task_id=task_id, seed=seed, policy=policy)
    return score_recording(run_trial(spec))


@pytest.mark.slow
@pytest.mark.parametrize("task_id", [task.id for task in LEVEL.tasks])
@pytest.mark.parametrize("policy", ["zero-action", "hover"])
def test_arms_that_never_touch_pass_no_gate(policy: str, task_id: str) -> None:
    score = run(policy, task_id, 1)
    assert score.ended in ("done", "time_limit")
    assert not score.c3_success
    assert score.peak_force_n == {}


@pytest.mark.slow
def test_another_person_needs_eyes() -> None:
    assert run("state-machine", "T4", 10).safety_gated
    assert not run("replay", "T4", 10).c3_success


# The push moves the wrist because the arm is passive: the same commands on a locked arm move nothing.

SEEDS = (0, 1, 2)


@pytest.fixture(scope="module")
def pushes() -> list[Recording]:
    protocol = load_protocol("bathing-v3")
    return [run_trial(TrialSpec(protocol=protocol, task_id="T2", seed=s, policy="state-machine")) for s in SEEDS]


@pytest.mark.slow
def test_wrist_moves_in_two_of_three_seeds(pushes: list[Recording]) -> None:
    moved = [score_recording(r).wrist_displacement_any_m for r in pushes]
    assert sum(m >= 0.020 for m in moved) >= 2, moved


@pytest.mark.slow
@pytest.mark.parametrize("index", range(len(SEEDS)))
def test_locked_arm_stays(pushes: list[Recording], index: int) -> None:
    recording = pushes[index]
    simulation = Simulation(build_scene(load_protocol("bathing-v3"), target="forearm", skin=False))
    simulation.settle(posture_of(simulation.protocol, SEEDS[index], "", 0).comfort_arm_deg)
    model = simulation.model
    for name in simulation.joint_names:
        if name.startswith("right_"):
            model.dof_damping[model.joint(f"human_{name}").dofadr[0]] = 1e6
    wrist = model.body("human_right_hand").id
    simulation.start()
    before = simulation.data.xpos[wrist].copy()
    assert recording.header.card is not None
    rate = float(recording.header.card["control_hz"])
    poses, periods = recording["actions/pose_tcp_in_base"], steps_of_period(rate, model.opt.timestep)
    moved, peak = 0.0, 0.0
    for pose in poses:
        simulation.set_goal(pose if np.isfinite(pose).all() else None, 1 / rate)
        for samples in simulation.advance(next(periods)):
            peak = max(peak, float(np.linalg.norm(samples.force, axis=2).max()))
        moved = max(moved, float(np.linalg.norm((simulation.data.xpos[wrist] - before)[:2])))
    assert peak > 8.0, "the locked arm must have been pushed"
    assert moved <= 0.002


# The whole audit on the level where a policy must not know most: every card of its own, the policies' trials to their
# end.


@pytest.mark.slow
def test_no_part_finds_a_leak() -> None:
    policies = [PolicySetup.of(name) for name in POLICIES if role_of(name) != "privileged"]
    tasks = ["T1", "T3", "T6"]
    result = audit(load_protocol("bathing-wide-v2", level="L3"), policies, quick=False, tasks=tasks, seed=3)
    assert [(part.name, part.findings, part.missing) for part in result.parts if not part.passed] == []
    assert {(trial.policy, trial.task_id) for trial in result.trials} == {
        (policy.ref.text, task) for policy in policies for task in tasks
    }
    assert [trial.error for trial in result.trials if trial.error or not trial.kept] == []
    counts = {part.name: part.counts for part in result.parts}
    assert counts["re-derivation"]["observations in contact"] >= 2 * 4 * 3


# The validation passes on the shipped persons and fails, by the right check, on persons with a planted defect.


def missed(validation: Validation) -> dict[str, str | list[str]]:
    return {r.check: r.error or [f"{m.name} {m.value:.3g}" for m in r.missed] for r in validation.results}


@pytest.mark.slow
@pytest.mark.parametrize("body", [name for name in body_names() if name != load_protocol("bathing-v3").person.body])
def test_a_shipped_body_misses_nothing_in_the_short_form(body: str) -> None:
    validation = validate(load_protocol("bathing-v3"), body=body, quick=True)
    assert len(validation.results) == len(CHECKS)
    assert missed(validation) == {name: [] for name in CHECKS}


@pytest.mark.slow
@pytest.mark.parametrize("body", ["man-adult", "man-adult-heavy", "man-old-heavy", "woman-adult-heavy"])
def test_a_body_misses_nothing_in_the_full_form(body: str) -> None:
    """Minutes each."""
    assert missed(validate(load_protocol("bathing-v3"), body=body)) == {name: [] for name in CHECKS}


@pytest.mark.slow
def test_zeroed_damping_fails_the_energy_check() -> None:
    result = validate(load_protocol("bathing-v3"), make_scene=undamped, quick=True, checks=["energy"]).results[0]
    assert not result.passed
    assert result.error or any("work of the declared law" in m.name for m in result.missed)


@pytest.mark.slow
def test_threefold_tissue_damping_fails_the_energy_check() -> None:
    result = validate(load_protocol("bathing-v3"), make_scene=overdamped, quick=True, checks=["energy"]).results[0]
    assert any("work against that of the declared law" in m.name for m in result.missed)


@pytest.mark.slow
def test_one_region_softer_than_declared_fails_the_energy_check() -> None:
    """The upper arm has no reference of its own in `paper-mapping`."""
    result = validate(load_protocol("bathing-v3"), make_scene=soft_upper_arm, checks=["energy"]).results[0]
    assert {m.name for m in result.missed} == {
        f"upper_arm loop at {speed} mm/s: deviation of the peak force from the declared law" for speed in (5, 20)
    }


@pytest.mark.slow
def test_a_softer_contact_fails_the_calibration_residual() -> None:
    result = validate(
        load_protocol("bathing-v3"), make_scene=soft_contact, quick=True, checks=["calibration-residual"]
    ).results[0]
    assert {m.name.partition(",")[0] for m in result.missed if "NRMSE" in m.name} >= {"forearm"}


@pytest.mark.slow
def test_half_stiffness_fails_the_calibration_residual() -> None:
    result = validate(
        load_protocol("bathing-v3"), make_scene=half_stiff, quick=True, checks=["calibration-residual"]
    ).results[0]
    missed = [m for m in result.missed if "NRMSE" in m.name]
    assert {m.name.partition(",")[0] for m in missed} == {"forearm", "abdomen"}
    assert min(m.value for m in missed) > 20.0


@pytest.mark.slow
def test_bone_of_the_arm_that_does_not_give_fails_the_knocks() -> None:
    """Elsewhere, the person is sound."""
    result = validate(load_protocol("bathing-v3"), make_scene=old_bone, quick=True, checks=["knocks"]).results[0]
    missed = {m.name.partition(":")[0] for m in result.missed}
    assert missed == {f"{site}, 10 kg at 0.2 m/s" for site in ("shoulder cap", "elbow", "forearm")}


@pytest.mark.slow
def test_missing_coupling_fails_the_calibration_residual() -> None:
    result = validate(
        load_protocol("bathing-v3"), make_scene=uncoupled, quick=True, checks=["calibration-residual"]
    ).results[0]
    assert {m.name.partition(",")[0] for m in result.missed if "NRMSE" in m.name} == {"forearm", "abdomen"}
