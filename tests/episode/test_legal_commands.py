"""Random legal commands on L3: nothing breaks, and the robot that the recording shows is never fast."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from carecontact.contract.action import Action
from carecontact.contract.policy import PolicyCard
from carecontact.contract.trial import TrialSpec
from carecontact.episode.ended import STOPPED_OVER
from carecontact.episode.episode import Episode
from carecontact.episode.prepare import World, settled_world
from carecontact.protocols import load_protocol
from carecontact.recording import Recording
from carecontact.scoring import score_recording
from carecontact.sim.cartesian_control import CartesianControl
from carecontact.validation.moves import in_base
from carecontact.validation.stability import random_compliance

PROTOCOL = load_protocol("bathing-wide-v2-draft", level="L3")
STOP_M_S = STOPPED_OVER * PROTOCOL.physics.max_tcp_speed_m_s
CARD = PolicyCard(name="legal", cameras=(), control_hz=5)
ACTIONS = 25
HARDEST_N_M, HEAVIEST_KG = 75_000.0, 12.0
"""The stiffest spring of ISO/TS 15066:2016 for a part that a tool reaches here (hands and fingers; from secondary
transcriptions), and the robot's largest effective mass at its tool in its parked and working postures. A mass m that a
spring k stops from the speed v adds v sqrt(k m) to what pushes it."""
MOST_N = np.sqrt(3) * PROTOCOL.impedance.force_clamp_n + STOP_M_S * np.sqrt(HARDEST_N_M * HEAVIEST_KG)


def trials(count: int, *, worlds: int, task: str = "T3") -> list[Recording]:
    """Recordings of random legal commands near the target region: poses, and a compliance with each of them."""
    out = []
    for seed in range(worlds):
        simulation, settled, sha256 = settled_world(PROTOCOL, task_id=task, seed=seed)
        begin = simulation.integration_state()
        place = simulation.data.site(f"region_{PROTOCOL.task(task).region}").xpos.copy()

        def prepare(spec: TrialSpec, world: World = (simulation, settled, sha256), begin: np.ndarray = begin) -> World:
            fresh = type(world[0])(world[0].scene)
            fresh.restore(begin, comfort_arm_deg=world[1].comfort_arm_deg)
            fresh.control.park()
            return fresh, world[1], world[2]

        for number in range(count // worlds):
            spec = TrialSpec(protocol=PROTOCOL, task_id=task, seed=seed, policy="legal")
            with Episode(spec, card=CARD, prepare=prepare) as episode:
                out.append(played(episode, place, np.random.default_rng([seed, number])))
    return out


def played(episode: Episode, place: np.ndarray, rng: np.random.Generator) -> Recording:
    episode.reset()
    bounds, reason, given = episode.session.action_bounds, None, 0
    middle = in_base(episode.simulation, place)
    while reason is None:
        stiffness, ratio, wrench = random_compliance(PROTOCOL.impedance, rng)
        at = np.clip(rng.normal(middle, [0.08, 0.08, 0.05]), bounds.workspace_low_m, bounds.workspace_high_m)
        quat = rng.normal([0.0, 1.0, 0.0, 0.0], 0.15)
        action = Action(
            pose_tcp_in_base=np.r_[at, quat / np.linalg.norm(quat)], stiffness=stiffness, damping_ratio=ratio,
            wrench_in_tcp=wrench, done=given == ACTIONS,
        )  # fmt: skip
        reason, given = episode.step(action, observe=False).reason, given + 1
    return episode.finish()


def check(recordings: list[Recording]) -> None:
    for recording in recordings:
        failure, speed = recording.header.failure, recording["scorer/tcp_speed"]
        assert failure is None or failure.kind in ("force", "tool_speed"), failure
        assert all(np.isfinite(values).all() for path, values in recording.arrays.items() if path.startswith("scorer/"))
        assert speed.max() <= 1.05 * STOP_M_S
        assert np.linalg.norm(recording["scorer/force_human_from_robot_in_world"], axis=2).max() <= MOST_N
        assert score_recording(recording).trial_id


def test_random_legal_commands_do_not_make_the_tool_fast() -> None:
    check(trials(4, worlds=1))


def test_without_the_law_a_trial_is_cut_and_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(CartesianControl, "_hold_back", lambda self: None)
    recordings = trials(4, worlds=1)
    check(recordings)
    cut = [r for r in recordings if r.header.failure is not None and r.header.failure.kind == "tool_speed"]
    assert len(cut) >= 3
    assert "the robot stops itself above 0.40 m/s" in cut[0].header.failure.message
    score = score_recording(cut[0])
    assert (score.c3_success, score.failure_mode) == (False, "safety_truncation")


@pytest.mark.slow
@pytest.mark.parametrize("task", ["T3", "T5", "T7"])
def test_a_hundred_trials_of_each_region(task: str) -> None:
    recordings = trials(100, worlds=10, task=task)
    check(recordings)
    speed = np.array([r["scorer/tcp_speed"].max() for r in recordings])
    force = [np.linalg.norm(r["scorer/force_human_from_robot_in_world"], axis=2).max() for r in recordings]
    ends = [r.header.failure.kind if r.header.failure else r.header.ended for r in recordings]
    sys.stdout.write(
        f"{task}: tool {np.median(speed):.3f}, {np.quantile(speed, 0.9):.3f}, {speed.max():.3f} m/s, "
        f"largest force {max(force):.0f} N of {MOST_N:.0f}, ends { ({e: ends.count(e) for e in ends}) }\n"
    )
    assert np.mean([end == "tool_speed" for end in ends]) < 0.05
