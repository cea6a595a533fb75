"""An episode in a plain loop, without a wire and without a process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from carecontact.contract.action import ACTION_SPACES, Action
from carecontact.contract.observation import Observation
from carecontact.contract.policy import PolicyCard, controls_for
from carecontact.contract.trial import TrialSpec
from carecontact.episode.episode import Episode
from carecontact.episode.peak import Peak
from carecontact.episode.prepare import World
from carecontact.errors import ActionError, ConfigError, PolicyError
from carecontact.hosting.setup import PolicySetup
from carecontact.hosting.wire.messages import observation_sha256
from carecontact.protocols import load_protocol
from carecontact.recording import Recording, canonical_hash
from carecontact.recording.provenance import ARITHMETIC, arithmetic
from carecontact.scoring import score_recording
from carecontact.trials.trial import run_trial

POLICY = """
import numpy as np
from carecontact.contract.action import Action
from carecontact.contract.policy import PolicyCard

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
    return TrialSpec(protocol=load_protocol(), task_id="T1", seed=0, policy=policy)


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
    protocol = load_protocol()
    short = protocol.model_copy(update={"phases": protocol.phases.model_copy(update={"time_limit_s": 0.05})})
    with Episode(spec().model_copy(update={"protocol": short}), card=BLIND, prepare=again) as episode:
        first = episode.reset()
        assert (first.sim_time_s, first.instruction) == (0.0, episode.instruction)
        steps = [episode.step(Action()), episode.step(Action(), observe=False), episode.step(Action())]
        assert [step.observation is not None for step in steps] == [True, False, False]
        assert [(s.terminated, s.truncated, s.reason) for s in steps[1:]] == [
            (False, False, None), (False, True, "time_limit"),
        ]  # fmt: skip
        with pytest.raises(ConfigError, match="before the episode has ended"):
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
    with pytest.raises(ConfigError, match="no task 'T99' in bathing-v3-draft; valid: T1, T2"):
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


@pytest.mark.parametrize("wrong", ["twice", "no card", "no reset"])
def test_calls_out_of_order_are_refused(again: Callable[[TrialSpec], World], wrong: str) -> None:
    with Episode(spec(), card=None if wrong == "no card" else BLIND, prepare=again) as episode:
        if wrong == "twice":
            episode.reset()
        with pytest.raises(ConfigError, match=r"Episode\.(reset|step): "):
            episode.step(Action()) if wrong == "no reset" else episode.reset()


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
    assert recording.header.control == card.control
    used = set(recording.arrays)
    assert {"actions/joint"} & used == ({"actions/joint"} if ACTION_SPACES[name].in_joints else set())
    # What no action used is not in the recording.
    assert not {"actions/axis_stiffness", "actions/damping_ratio", "actions/wrench_in_tcp"} & used
    assert score_recording(recording).trial_id
