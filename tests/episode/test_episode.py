"""An episode in a plain loop, without a wire and without a process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from carecontact.episode.episode import Episode, first_look
from carecontact.episode.perception import Peak
from carecontact.episode.randomization import World
from carecontact.errors import ActionError, ConfigError, PolicyError
from carecontact.interface.action import ACTION_SPACES, Action
from carecontact.interface.action_spaces import DAMPING_RATIO, MAX_FEEDFORWARD_N, MAX_FEEDFORWARD_NM
from carecontact.interface.geometry import matrix_from_quat, quat_from_matrix
from carecontact.interface.observation import Observation
from carecontact.interface.policy import PolicyCard, controls_for
from carecontact.interface.robot import Session
from carecontact.lab.validation.subject import axes, in_base, surface_point
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from carecontact.protocol.sections import Variation
from carecontact.recording import SEGMENTS, Recording, canonical_hash
from carecontact.recording.notes import perception_errors
from carecontact.recording.provenance import ARITHMETIC, arithmetic
from carecontact.report.failures import cause_text
from carecontact.running.trial import run_trial
from carecontact.scoring import score_recording
from carecontact.serving.codec import observation_sha256
from carecontact.serving.conversation import PolicySetup
from tests.scoring.synthetic import GENTLE, PROTOCOL

POLICY = """
import numpy as np
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard

class Wave:
    card = PolicyCard(name="wave", modalities=("rgb", "landmarks"), control_hz=15)

    def __init__(self):
        self.looks = 0

    def reset(self, instruction):
        self.instruction = instruction

    def act(self, observation):
        self.looks += 1
        poses = np.tile(observation.pose_tcp_in_base, (8, 1))
        poses[:, 2] -= 0.02 * np.sin(np.linspace(0, np.pi, 8))
        # Norms that differ from 1 in the last digits: how often they are divided out decides the last bits.
        poses[:, 3:] += np.random.default_rng(self.looks).normal(scale=1e-3, size=(8, 4))
        wave = [Action(pose_tcp_in_base=p, stiffness=(300.0, 20.0)) for p in poses]
        return wave if self.looks < 3 else [Action(done=True)]
"""
BLIND = PolicyCard(name="blind", cameras=(), control_hz=50)


def spec(policy: str = "blind") -> TrialSpec:
    return TrialSpec(protocol=load_protocol("bathing-v3"), task_id="T1", seed=0, policy=policy)


@pytest.fixture
def again(parked_world: Callable[[TrialSpec], World]) -> Callable[[TrialSpec], World]:
    """The same settled world for every episode."""
    return parked_world


def by_loop(spec: TrialSpec, policy, prepare: Callable[[TrialSpec], World]) -> Recording:
    """All that it takes to run a policy object in this process."""
    with Episode(spec, card=policy.card, prepare=prepare, digest=observation_sha256) as episode:
        policy.reset(episode.instruction)
        observation: Observation | None = episode.reset()
        while observation is not None:
            chunk = policy.act(observation)
            for number, action in enumerate(chunk, start=1):
                step = episode.step(action, observe=number == len(chunk))
                if step.reason is not None:
                    break
            observation = step.observation
        return episode.finish()


def test_a_loop_and_a_trial_s_process_make_the_same_recording(
    again: Callable[[TrialSpec], World], tmp_path: Path
) -> None:
    (tmp_path / "waving.py").write_text(POLICY)
    scope: dict = {}
    exec(POLICY, scope)
    asked = spec("waving:Wave")
    here = by_loop(asked, scope["Wave"](), again)
    there = run_trial(asked, policy=PolicySetup.of(asked.policy, search_path=[str(tmp_path)]), prepare=again)
    assert here.header == there.header
    assert here.header.ended == "done"
    assert here.header.control == "cartesian-impedance"
    assert len(here["policy/observation_sha256"]) == 3
    arrays = {path for path in here.arrays.keys() | there.arrays.keys() if not path.startswith("wall/")}
    differ = {path for path in arrays if not np.array_equal(here[path], there[path], equal_nan=True)}
    assert differ == set()
    assert canonical_hash(here) == canonical_hash(there)
    assert there[ARITHMETIC].tobytes().decode() == arithmetic()


def test_what_step_says_is_how_it_ended(again: Callable[[TrialSpec], World], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Peak, "pictures", lambda self, renderer, region: {})
    protocol = load_protocol("bathing-v3")
    short = protocol.model_copy(update={"phases": protocol.phases.model_copy(update={"time_limit_s": 0.05})})
    with Episode(spec().model_copy(update={"protocol": short}), card=BLIND, prepare=again) as episode:
        first = episode.reset()
        assert (first.sim_time_s, first.instruction) == (0.0, episode.instruction)
        steps = [episode.step(Action()), episode.step(Action(), observe=False), episode.step(Action())]
        assert [step.observation is not None for step in steps] == [True, False, False]
        assert [(s.terminated, s.truncated, s.reason) for s in steps[1:]] == [
            (False, False, None),
            (False, True, "time_limit"),
        ]
        with pytest.raises(ConfigError, match="the trial has ended"):
            episode.step(Action())
        recording = episode.finish()
    assert len(recording["scorer/time_s"]) == 25
    assert recording["actions/observation_index"].tolist() == [0, 1, 1]
    assert not recording["policy/observation_sha256"].any(), "sent nowhere"


def test_an_action_outside_the_space_moves_nothing(again: Callable[[TrialSpec], World]) -> None:
    with Episode(spec(), card=BLIND, prepare=again) as episode:
        episode.reset()
        with pytest.raises(ActionError, match="inside the workspace"):
            episode.step(Action(pose_tcp_in_base=np.array([9.0, 0, 0, 1, 0, 0, 0])))
        assert episode.simulation.time_s == 0
        assert episode.step(Action(done=True)).terminated


def test_a_card_that_clips_is_counted(again: Callable[[TrialSpec], World], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Peak, "pictures", lambda self, renderer, region: {})
    with Episode(spec(), card=replace(BLIND, out_of_bounds="clip"), prepare=again) as episode:
        outside = episode.reset().pose_tcp_in_base.copy()
        outside[0] = 9.0
        for action in (Action(pose_tcp_in_base=outside), Action(), Action(done=True)):
            episode.step(action, observe=False)
        recording = episode.finish()
        high = episode.session.action_bounds.workspace_high_m[0]
    assert recording["actions/clipped"].tolist() == [1, 0, 0]
    assert recording["actions/pose_tcp_in_base"][0, 0] == high
    assert score_recording(recording).clipped_actions == 1


def test_mistakes_of_a_loop_are_named(again: Callable[[TrialSpec], World]) -> None:
    with pytest.raises(ConfigError, match="no task 'T99' in bathing-v3; valid: T1, T2"):
        Episode(spec().model_copy(update={"task_id": "T99"}), card=BLIND, prepare=again)
    with Episode(spec(), card=BLIND, prepare=again) as episode:
        episode.reset()
        for wrong in ([Action()], None, np.zeros(7)):
            with pytest.raises(ActionError, match="expected one Action, got"):
                episode.step(wrong)
        with pytest.raises(ConfigError, match="cannot change after reset"):
            episode.card = replace(BLIND, control_hz=10)
    with pytest.raises(ConfigError, match="inside its with"):
        episode.step(Action())


def test_a_failure_of_the_policy_ends_it(again: Callable[[TrialSpec], World], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Peak, "pictures", lambda self, renderer, region: {})
    with Episode(spec(), card=BLIND, prepare=again) as episode:
        episode.reset()
        with pytest.raises(ConfigError, match="has not ended"):
            episode.finish()
        episode.fail(PolicyError("died", "gone", notes={"last": 1}))
        recording = episode.finish()
    assert recording.header.ended == "process_failure"
    assert len(recording["policy/observation_time_s"]) == 0
    assert "policy/notes/0000/json" in recording.arrays


@pytest.mark.parametrize("wrong", ["closed", "no card", "no reset", "look too early"])
def test_calls_out_of_order_are_refused(again: Callable[[TrialSpec], World], wrong: str) -> None:
    with Episode(spec(), card=None if wrong == "no card" else BLIND, prepare=again) as episode:
        if wrong == "closed":
            episode.close()
        calls = {"no reset": lambda: episode.step(Action()), "look too early": episode.look}
        with pytest.raises(ConfigError, match=r"Episode\.(reset|step|look): "):
            calls.get(wrong, episode.reset)()


def test_the_tool_s_velocity_is_the_slope_of_its_pose(again: Callable[[TrialSpec], World]) -> None:
    card = replace(BLIND, tool_velocity=True)
    with Episode(spec(), card=card, prepare=again) as episode:
        goal = episode.reset().pose_tcp_in_base.copy()
        np.testing.assert_allclose(episode.look().velocity_tcp_in_base, 0, atol=1e-3)
        goal[:3] += [0.05, 0.03, -0.02]
        goal[3:] = quat_from_matrix(matrix_from_quat(goal[3:]) @ matrix_from_quat(np.array([0.98, 0.2, 0, 0])))
        seen = [look for _ in range(20) if (look := episode.step(Action(pose_tcp_in_base=goal)).observation)]
        compliance, impedance = episode.session.compliance, episode.protocol.impedance
    pose, time_s = np.array([look.pose_tcp_in_base for look in seen]), [look.sim_time_s for look in seen]
    moved = np.array([look.velocity_tcp_in_base for look in seen])
    np.testing.assert_allclose(moved[1:-1, :3], np.gradient(pose[:, :3], time_s, axis=0)[1:-1], atol=4e-3)
    assert np.abs(moved[:, :3]).max() > 0.05
    # The rotation from each look to the one after the next, as a vector in base over the time between.
    for before, now, after in zip(pose, moved[1:], pose[2:], strict=False):
        turn = matrix_from_quat(after[3:]) @ matrix_from_quat(before[3:]).T
        slope = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2 / 0.04
        np.testing.assert_allclose(now[3:], slope, atol=0.05)
    assert np.abs(moved[:, 3:]).max() > 0.2
    assert compliance is not None
    assert compliance.stiffness == (impedance.translational_n_m, impedance.rotational_nm_rad)
    # What the session says of the damping is what the model has.
    rows = [episode.simulation.model.actuator(f"impedance_{axis}") for axis in (0, 3)]
    masses = compliance.effective_mass_kg, compliance.effective_inertia_kgm2
    for row, stiffness, mass in zip(rows, compliance.stiffness, masses, strict=True):
        assert row.gainprm[0] == stiffness
        assert -row.biasprm[2] >= 2 * compliance.damping_ratio * np.sqrt(stiffness * mass) * (1 - 1e-12)


@pytest.mark.parametrize("name", ACTION_SPACES)
def test_every_action_space_has_a_driver_that_fills_arrays_of_the_schema(
    name: str, again: Callable[[TrialSpec], World]
) -> None:
    card = PolicyCard(name="any", action_space=name, control=controls_for(name)[0])
    with Episode(spec(), card=card, prepare=again) as episode:
        episode.reset()
        episode.step(Action(), observe=False)
        episode.step(Action(done=True), observe=False)
        recording = episode.finish()
        assert (episode.session.compliance is None) == ACTION_SPACES[name].in_joints
    assert (recording.header.control, recording.header.origin) == (card.control, "in-process")
    used = set(recording.arrays)
    assert {"actions/joint"} & used == ({"actions/joint"} if ACTION_SPACES[name].in_joints else set())
    # What no action used is not in the recording.
    assert not {"actions/axis_stiffness", "actions/damping_ratio", "actions/wrench_in_tcp"} & used
    assert score_recording(recording).trial_id


FIRST_LOOK_POLICY = """
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard

class Once:
    card = PolicyCard(name="once", modalities=("rgb", "depth"), cameras=("overhead", "wrist"))
    def reset(self, instruction): ...
    def act(self, observation):
        return Action(done=True)
"""


def test_it_is_what_the_trial_shows_with_every_variation_on(tmp_path: Path) -> None:
    looks = {"appearance": "varied-v1", "light": "varied-v1", "depth_noise": "structured-light-v1"}
    place = {"place_along_m": 0.04, "place_across_m": 0.03, "place_yaw_deg": 5.0}
    variation = Variation.model_validate({**looks, **place, "encoder_noise_rad": 0.003})
    protocol = load_protocol("bathing-v3").model_copy(update={"variation": variation})
    (tmp_path / "look_once.py").write_text(FIRST_LOOK_POLICY)
    spec = TrialSpec(protocol=protocol, task_id="T1", seed=2, policy="look_once:Once")
    recording = run_trial(spec, policy=PolicySetup.of(spec.policy, search_path=[str(tmp_path)]))
    card = PolicyCard(name="once", modalities=("rgb", "depth"), cameras=("overhead", "wrist"))
    seen = first_look(protocol, task_id="T1", seed=2, card=card)
    for camera, view in seen.cameras.items():
        for modality in ("rgb", "depth"):
            stored = recording[f"policy/frames/0000/{camera}/{modality}"]
            np.testing.assert_array_equal(getattr(view, modality), stored)
    # Nothing else was rendered or measured than what the card requests: 2 RGB and 2 depth; two pictures for the report.
    assert recording["wall/renders"].tolist() == [2, 2, 0, 0, 0]
    assert recording["wall/report_renders"].tolist() == [2]
    assert perception_errors(recording) is None

    plain = first_look(load_protocol("bathing-v3"), task_id="T1", seed=2, card=card)
    away = seen.joint_position - plain.joint_position
    assert 0.0005 < np.abs(away).mean() < 0.01
    # The hand's pose and its camera follow the encoders, wrong as they are.
    shift = seen.pose_tcp_in_base[:3] - plain.pose_tcp_in_base[:3]
    assert 1e-4 < np.linalg.norm(shift) < 0.02
    moved = [v.pose_camera_in_base[:3, 3] for v in (seen.cameras["wrist"], plain.cameras["wrist"])]
    assert np.linalg.norm(moved[0] - moved[1]) > 1e-4
    overhead = [v.cameras["overhead"] for v in (seen, plain)]
    np.testing.assert_array_equal(overhead[0].pose_camera_in_base, overhead[1].pose_camera_in_base)
    assert overhead[0].rgb is not None
    assert overhead[1].rgb is not None
    assert (overhead[0].rgb != overhead[1].rgb).any(2).mean() > 0.5


# What a trial accepts of a policy can be scored: no action, however odd, makes a trial vanish from the count.

FIELDS = {
    "cartesian_pose": ("pose_tcp_in_base", "stiffness", "damping_ratio", "wrench_in_tcp"),
    "cartesian_delta": ("delta", "stiffness", "damping_ratio", "wrench_in_tcp"),
    "joint_position": ("joint",),
    "droid_joint_velocity": ("joint",),
}


def test_the_fields_drawn_here_are_those_of_the_spaces() -> None:
    assert {name: space.fields for name, space in ACTION_SPACES.items()} == FIELDS


class Draws:
    """Random actions: each optional field is given or not, with values inside, at and beyond its bounds, and zero."""

    def __init__(self, space: str, session: Session, parked: tuple[float, ...], *, seed: int) -> None:
        self.space, self.session, self.rng = space, session, np.random.default_rng(seed)
        self.parked = np.array(parked)

    def action(self) -> Action:
        given = {name: getattr(self, name)() for name in FIELDS[self.space] if self.rng.random() < 0.6}
        return Action(**given, gripper=self.number(0.0, 1.0) if self.rng.random() < 0.2 else None)

    def number(self, low: float, high: float, *, zero: float = 0.1) -> float:
        kind = self.rng.random()
        if kind < zero:
            return 0.0
        if kind < zero + 0.2:
            return float(self.rng.choice([low, high]))
        # The last one is just beyond a bound, as rounding leaves it; a fifth of a per mille of actions are refused.
        if kind > 0.99:
            return float(np.nextafter(high, np.inf))
        return float(self.rng.uniform(low, high))

    def pose_tcp_in_base(self) -> np.ndarray:
        low, high = self.session.action_bounds.workspace_low_m, self.session.action_bounds.workspace_high_m
        quat = self.rng.normal(size=4)
        near = np.array([0.5, 0.0, 0.3]) + self.rng.normal(0.0, 0.15, 3)
        far = [self.number(a, b, zero=0.0) for a, b in zip(low, high, strict=True)]
        place = np.clip(near, low, high) if self.rng.random() < 0.7 else np.array(far)
        return np.concatenate([place, quat / np.linalg.norm(quat)])

    def delta(self) -> np.ndarray:
        return self.rng.uniform(-1.0, 1.0, 6) * self.number(0.0, 1.0)

    def stiffness(self) -> tuple[float, ...]:
        bounds = self.session.action_bounds
        pairs = (bounds.translational_stiffness, bounds.rotational_stiffness)
        if self.rng.random() < 0.4:
            return tuple(self.number(*pair, zero=0.0) for pair in pairs)
        limp = self.rng.random()
        return tuple(self.number(*pair, zero=limp) for pair in pairs for _ in range(3))

    def damping_ratio(self) -> float:
        return self.number(*DAMPING_RATIO, zero=0.0)

    def wrench_in_tcp(self) -> np.ndarray:
        most = [MAX_FEEDFORWARD_N] * 3 + [MAX_FEEDFORWARD_NM] * 3
        return np.array([self.number(-m, m) * self.rng.choice([1.0, 1e-3]) for m in most])

    def joint(self) -> np.ndarray:
        if self.space == "droid_joint_velocity":
            return self.rng.normal(0.0, 3.0, 7)
        low, high = np.array(self.session.joint_low_rad), np.array(self.session.joint_high_rad)
        # A far target ends the trial by the speed of a joint, so that most are near where the robot stands.
        if self.rng.random() < 0.98:
            return np.clip(self.parked + self.rng.normal(0.0, 0.02, 7), low, high)
        return np.array([self.number(*pair, zero=0.0) for pair in zip(low, high, strict=True)])


@pytest.mark.parametrize("draws", [150, pytest.param(2000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("space", list(FIELDS))
def test_a_random_action_is_refused_or_scored(
    space: str, draws: int, parked_world: Callable[[TrialSpec], World], t1: TrialSpec
) -> None:
    control = "droid" if ACTION_SPACES[space].in_joints else "cartesian-impedance"
    card = PolicyCard(name="draws", cameras=(), control_hz=50, action_space=space, control=control)
    accepted = refused = episodes = 0
    ends = set[str]()
    while accepted + refused < draws:
        with Episode(t1, card=card, prepare=parked_world) as episode:
            episode.reset()
            source = Draws(space, episode.session, t1.protocol.scene.parked_joint_rad, seed=episodes)
            reason = None
            while reason is None and accepted + refused < draws:
                action = source.action()
                try:
                    reason = episode.step(action, observe=False).reason
                    accepted += 1
                except ActionError:
                    refused += 1
            if reason is None:
                reason = episode.step(Action(done=True), observe=False).reason
            score = score_recording(episode.finish())
        assert score.ended == reason
        assert score.is_judged
        ends.add(str(reason))
        episodes += 1
    assert accepted > draws / 3
    assert ends <= {"done", "time_limit", "safety_truncation"}


def limp(**given: object) -> Action:
    return Action(stiffness=(0, 0, 0, 20, 20, 20), wrench_in_tcp=np.array([1e-3, 1e-3, 1e-3, 0, 0, 0]), **given)


def test_a_limp_hand_is_a_failed_trial_and_not_a_lost_one(
    parked_world: Callable[[TrialSpec], World], t1: TrialSpec
) -> None:
    card = PolicyCard(name="limp", cameras=(), control_hz=15)
    with Episode(t1, card=card, prepare=parked_world) as episode:
        episode.reset()
        episode.step(limp(), observe=False)
        episode.step(limp(done=True), observe=False)
        recording = episode.finish()
    np.testing.assert_array_equal(recording["actions/stiffness"], [[0, 20], [0, 20]])
    score = score_recording(recording)
    assert (score.c3_success, score.failure_mode) == (False, "no_target_contact")


def test_a_joint_that_is_too_fast_is_a_failed_trial_and_not_a_lost_one(
    parked_world: Callable[[TrialSpec], World], t1: TrialSpec
) -> None:
    card = PolicyCard(name="fast", cameras=(), control_hz=15, action_space="joint_position", control="droid-sim-evals")
    with Episode(t1, card=card, prepare=parked_world) as episode:
        episode.reset()
        step = episode.step(Action(joint=np.array(episode.session.joint_low_rad) * 0.99), observe=False)
        while step.reason is None:
            step = episode.step(Action(), observe=False)
        recording = episode.finish()
    assert recording.header.failure is not None
    assert recording.header.failure.kind == "joint_speed"
    assert score_recording(recording).failure_mode == "safety_truncation"


# Contact is counted by part of the robot: hand and links that rest on the person are no touch of the tool.

UNDERSIDE_M = 0.051
"""How far the cap reaches out of the hand's underside."""
BESIDE_M = 0.084
WAY = ((0.12, 60), (0.02, 20), (-0.03, 20))
"""Heights [m] of the tool's target over the skin of the place, and steps there, before the last one."""


def pressed(*, along_m: float = 0.0, across_m: float = 0.0, depth_m: float) -> Recording:
    """The touch of the forearm with the hand's long side across the arm: from above, then ``depth_m`` below the skin at
    the place (along, across) of the region."""
    spec = TrialSpec(protocol=GENTLE, task_id="T1", seed=0, policy="scripted")
    with Episode(spec, card=PolicyCard(name="scripted", cameras=(), control_hz=20)) as episode:
        episode.reset()
        simulation = episode.simulation
        simulation.refresh()
        along, across = axes(simulation, "forearm")
        place = surface_point(simulation, "forearm") + along_m * along + across_m * across
        down = np.array([0.0, 0.0, -1.0])
        base = matrix_from_quat(simulation.pose_base_in_world[3:])
        quat = quat_from_matrix(base.T @ np.stack([np.cross(across, down), across, down], 1))
        for height, steps in (*WAY, (-depth_m, 70)):
            pose = np.r_[in_base(simulation, place + [0.0, 0.0, height]), quat]
            for _ in range(steps):
                episode.step(Action(pose_tcp_in_base=pose), observe=False)
        episode.step(Action(done=True), observe=False)
        return episode.finish()


def by_part(recording: Recording, segment: str) -> tuple[np.ndarray, np.ndarray]:
    """Normal force (T,) on a segment, and what hand and links did of it (T, 2)."""
    column = SEGMENTS.index(segment)
    return recording["scorer/normal_force"][:, column], recording["scorer/beside_normal_force"][:, :, column]


@pytest.fixture(scope="module")
def resting() -> Recording:
    """The hand's underside rests on the forearm with about 2 N; the tool is beside it, in the air."""
    return pressed(across_m=BESIDE_M, depth_m=UNDERSIDE_M + 0.007)


def test_a_hand_that_rests_on_the_arm_is_no_touch(resting: Recording) -> None:
    score = score_recording(resting)
    assert (score.reported_segment, score.c3_success, score.failure_mode) == ("right_forearm", False, "not_by_tool")
    assert score.additional["gentle_hold@2"] == 0.0
    assert "The forearm was touched by the hand, not by the tool, which applied 0% of" in (score.evidence or "")
    assert cause_text(score) == "the region was touched by the robot's hand or links, not by its tool"


def test_it_was_a_touch_where_any_part_of_the_robot_counted(resting: Recording) -> None:
    arrays = {path: array for path, array in resting.arrays.items() if not path.startswith("scorer/beside_")}
    assert score_recording(Recording(header=resting.header, arrays=arrays)).c3_success


def test_hand_and_links_are_a_part_of_the_whole_force(resting: Recording) -> None:
    whole, beside = by_part(resting, "right_forearm")
    assert whole.max() > 1.0
    np.testing.assert_array_equal(beside[:, 0], whole)
    assert not beside[:, 1].any()
    force = resting["scorer/force_human_from_robot_in_world"]
    np.testing.assert_array_equal(resting["scorer/beside_force_in_world"].sum(1), force)


def test_the_paper_s_gates_count_any_part(resting: Recording) -> None:
    spec = resting.header.spec.model_copy(update={"protocol": PROTOCOL})
    header = resting.header.model_copy(update={"spec": spec})
    assert score_recording(Recording(header=header, arrays=resting.arrays)).c3_success


def test_the_tool_alone_leaves_no_account_of_other_parts() -> None:
    recording = pressed(depth_m=0.012)
    assert not any(path.startswith("scorer/beside_") for path in recording)
    score = score_recording(recording)
    assert (score.c3_success, score.failure_mode) == (True, None)


def test_rigid_surfaces_know_the_part_too() -> None:
    """The person's hand is rigid: sensors and not the tissue feel what touches it."""
    whole, beside = by_part(pressed(along_m=0.2, across_m=BESIDE_M, depth_m=0.09), "right_hand")
    assert whole.max() > 5.0
    np.testing.assert_array_equal(beside.sum(1), whole)
    tool = pressed(along_m=0.2, depth_m=0.06)
    assert tool["scorer/normal_force"][:, SEGMENTS.index("right_hand")].max() > 5.0
    assert not any(path.startswith("scorer/beside_") for path in tool)
