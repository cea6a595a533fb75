"""Worlds that are kept: what begins in one again is the same trial, to the last bit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from carecontact.episode.episode import Episode
from carecontact.episode.perception import Peak
from carecontact.episode.randomization import World, settled_world
from carecontact.episode.worlds import Worlds
from carecontact.errors import ConfigError, SceneError
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard
from carecontact.lab.validation.subject import in_base
from carecontact.protocol.load import load_protocol
from carecontact.protocol.person import Alive, Breathing, Repositioning, Withdrawal
from carecontact.protocol.protocol import TrialSpec
from carecontact.protocol.sections import Variation
from carecontact.recording import Recording, canonical_hash
from carecontact.scoring import score_recording
from carecontact.serving.codec import observation_sha256
from carecontact.sim.simulation import Simulation

HZ = 20.0
BLIND = PolicyCard(name="blind", cameras=(), control_hz=HZ)
SEEING = PolicyCard(
    name="seeing", modalities=("rgb", "depth"), cameras=("overhead", "wrist"), control_hz=HZ, tool_velocity=True
)
JOINTS = replace(BLIND, action_space="joint_position", control="droid")
Prepare = Callable[[TrialSpec], World]


def roll(episode: Episode, spec: TrialSpec | None = None, *, actions: int = 60) -> Recording:
    """Go to the middle of the region and press, with gains and feedforward of all kinds, and look at the end."""
    look, rng = episode.reset(spec), np.random.default_rng(0)
    simulation, card = episode.simulation, episode.card
    assert card is not None
    region = simulation.data.site(f"region_{episode.task.region}").xpos.copy()
    goal, start = look.pose_tcp_in_base.copy(), simulation.encoders.joint_position(simulation.data)
    bounds = episode.session.action_bounds
    goal[:3] = np.clip(in_base(simulation, region + [0, 0, 0.03]), bounds.workspace_low_m, bounds.workspace_high_m)
    for number in range(actions):
        if card.action_space == "joint_position":
            action = Action(joint=start + 0.05 * number / actions * rng.normal(size=7))
        else:
            more = {"wrench_in_tcp": np.r_[0, 0, rng.uniform(0, 3), 0, 0, 0]} if number > actions / 2 else {}
            action = Action(pose_tcp_in_base=goal, stiffness=(rng.uniform(300, 900), 20.0), **more)
        done = replace(action, done=number == actions - 1)
        if episode.step(done, observe=number % 20 == 0).reason:
            break
    episode.look()
    return episode.finish()


def bytes_of(model: mujoco.MjModel) -> bytes:
    buffer = np.zeros(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer.tobytes()


def touched(recording: Recording) -> bool:
    return bool(recording["scorer/normal_force"].any())


def alive() -> TrialSpec:
    protocol = load_protocol("bathing-v3")
    own = Alive(breathing=Breathing(), repositioning=Repositioning(), withdrawal=Withdrawal())
    noisy = Variation(depth_noise="structured-light-v1", encoder_noise_rad=1e-4, tissue="published-v1")
    person = protocol.person.model_copy(update={"alive": own})
    protocol = protocol.model_copy(update={"person": person, "variation": noisy})
    return TrialSpec(protocol=protocol, task_id="T6", seed=1, policy="blind")


@pytest.mark.parametrize(
    ("card", "late"),
    [(SEEING, False), (BLIND, True), (JOINTS, False), (JOINTS, True)],
    ids=["seeing", "a card that comes later", "joints", "joints later"],
)
def test_a_trial_that_begins_again_is_the_same_trial(
    card: PolicyCard, late: bool, parked_world: Prepare, t1: TrialSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Peak, "pictures", lambda self, renderer, region: {})
    with Episode(t1, card=None if late else card, prepare=parked_world, digest=observation_sha256) as episode:
        episode.card = card
        first = episode.reset()
        model = bytes_of(episode.simulation.model)
        recordings = [roll(episode) for _ in range(3)]
        again = episode.reset()
        assert bytes_of(episode.simulation.model) == model
    with Episode(t1, card=card, prepare=parked_world, digest=observation_sha256) as other:
        recordings.append(roll(other))
    assert len({canonical_hash(recording) for recording in recordings}) == 1
    assert observation_sha256(first) == observation_sha256(again)
    assert touched(recordings[0]) == (card is not JOINTS)
    assert recordings[0]["wall/renders"].tolist() == recordings[2]["wall/renders"].tolist()


def test_a_person_who_moves_does_so_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Peak, "pictures", lambda self, renderer, region: {})
    spec, worlds = alive(), Worlds(2)
    with Episode(spec, card=SEEING, worlds=worlds, digest=observation_sha256) as episode:
        first = roll(episode)
        roll(episode, spec.model_copy(update={"task_id": "T1"}))
        again = roll(episode, spec)
    assert canonical_hash(first) == canonical_hash(again)
    assert first["scorer/breath_m"].any()
    assert len(worlds) == 2


def test_every_episode_has_a_world_of_its_own(parked_world: Prepare, t1: TrialSpec) -> None:
    worlds = Worlds(1, prepare=parked_world)
    with Episode(t1, card=BLIND, worlds=worlds) as one, Episode(t1, card=BLIND, worlds=worlds) as two:
        assert one.simulation is not two.simulation
        assert len(worlds) == 0
        one.reset()
        before = two.reset()
        one.step(Action(pose_tcp_in_base=before.pose_tcp_in_base + np.r_[0, 0, 0.05, 0, 0, 0, 0]))
        assert two.simulation.time_s == 0
        kept = two.simulation
    assert len(worlds) == 1, "the one that was given back last"
    with Episode(t1, card=BLIND, worlds=worlds) as three:
        three.reset()
        assert three.simulation in (kept, one.simulation)
        three.close()
        three.close()
    assert len(worlds) == 1
    worlds.clear()
    assert len(worlds) == 0
    with pytest.raises(ConfigError, match=r"Worlds.most: expected an integer of at least 0, got -1"):
        Worlds(-1)
    with pytest.raises(ConfigError, match=r"Worlds.most: expected an integer of at least 0, got 'a'"):
        Worlds("a")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ConfigError, match="give prepare to Worlds"):
        Episode(t1, worlds=worlds, prepare=parked_world)


def test_the_world_that_was_used_least_lately_goes(
    parked_world: Prepare, t1: TrialSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    built: list[int] = []

    def prepare(spec: TrialSpec) -> World:
        built.append(spec.seed)
        return parked_world(spec)

    worlds = Worlds(2, prepare=prepare)
    closed: list[object] = []
    monkeypatch.setattr("carecontact.sim.rendering.SceneRenderer.close", lambda self: closed.append(self))
    with Episode(t1, card=BLIND, worlds=worlds) as episode:
        for seed in (0, 1, 2, 1, 3, 0, 0):
            episode.reset(t1.model_copy(update={"seed": seed}))
    # 0 is let go of when 1 is given back for 3, so that it is built again.
    assert built == [0, 1, 2, 3, 0]
    assert len(closed) == 3
    assert len(worlds) == 2


def test_another_trial_on_the_same_object(
    parked_world: Prepare, t1: TrialSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    protocol = t1.protocol
    short = protocol.model_copy(update={"phases": protocol.phases.model_copy(update={"time_limit_s": 0.1})})
    other = t1.model_copy(update={"protocol": short, "task_id": "T3"})
    with Episode(t1, card=BLIND, prepare=parked_world) as episode:
        assert episode.session.time_limit_s == protocol.phases.time_limit_s
        first = episode.reset(other)
        assert first.instruction == episode.instruction == short.task("T3").prompt
        assert episode.session.time_limit_s == 0.1
        steps = [episode.step(Action()) for _ in range(2)]
        assert steps[-1].reason == "time_limit"
        assert steps[-1].observation is None
        last = episode.look()
        assert last.sim_time_s == 0.1
        assert observation_sha256(last) == observation_sha256(episode.look())
        with pytest.raises(ConfigError, match="no task 'T99'"):
            episode.reset(t1.model_copy(update={"task_id": "T99"}))

        def fails(spec: TrialSpec) -> World:
            raise SceneError("no such person")

        monkeypatch.setattr(episode._worlds, "_prepare", fails)
        with pytest.raises(SceneError):
            episode.reset(t1.model_copy(update={"seed": 5}))
        with pytest.raises(ConfigError, match=r"Episode\.step"):
            episode.step(Action())
        # Not the old world under the new name.
        with pytest.raises(SceneError):
            episode.reset()


WRONG: dict[str, tuple[object, str]] = {
    "seed": ({"seed": -1}, r"TrialSpec.seed: expected an integer of at least 0, got -1"),
    "seed of another type": ({"seed": "a"}, r"TrialSpec.seed: .* got 'a'"),
    "task": ({"task_id": "T99"}, "no task 'T99'"),
    "no trial": ("T1", "Episode: expected a TrialSpec, got 'T1'"),
}
"""What is changed in a trial, or what is given in its place -> the message."""


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_trial_is_refused_and_leaves_the_episode_as_it_was(
    name: str, parked_world: Prepare, t1: TrialSpec
) -> None:
    given, message = WRONG[name]
    wrong = t1.model_copy(update=given) if isinstance(given, dict) else given
    with Episode(t1, card=BLIND, worlds=Worlds(0, prepare=parked_world)) as episode:
        first = observation_sha256(episode.reset())
        episode.step(Action())
        before = episode.simulation.time_s
        with pytest.raises(ConfigError, match=message):
            episode.reset(wrong)  # pyright: ignore[reportArgumentType]
        assert episode.spec == t1
        episode.step(Action())
        assert episode.simulation.time_s == pytest.approx(2 * before)
        assert observation_sha256(episode.reset()) == first
    with pytest.raises(ConfigError, match=message):
        Episode(wrong, card=BLIND, prepare=parked_world)  # pyright: ignore[reportArgumentType]


def test_the_last_look_leaves_no_trace(parked_world: Prepare, t1: TrialSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Peak, "pictures", lambda self, renderer, region: {})
    found: list[str] = []
    for looks in (0, 3):
        with Episode(t1, card=SEEING, prepare=parked_world) as episode:
            observation = episode.reset()
            for _ in range(looks):
                assert observation_sha256(episode.look()) == observation_sha256(observation)
            episode.step(Action())
            assert episode.step(Action(done=True)).observation is None
            for _ in range(looks):
                episode.look()
            found.append(canonical_hash(episode.finish()))
    assert found[0] == found[1]


def test_without_a_recording_the_motion_is_the_same(
    parked_world: Prepare, t1: TrialSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    ends: list[np.ndarray] = []
    for record in (True, False):
        with Episode(t1, card=SEEING, prepare=parked_world, record=record) as episode:
            monkeypatch.setattr(episode, "finish", lambda: None)
            roll(episode)
            ends.append(episode.simulation.integration_state())
            assert (len(episode.log.arrays()["scorer/time_s"]) > 0) == record
    np.testing.assert_array_equal(ends[0], ends[1])
    with Episode(t1, card=BLIND, prepare=parked_world, record=False) as episode:
        episode.reset()
        episode.step(Action(done=True))
        with pytest.raises(ConfigError, match="record=False"):
            episode.finish()


def test_progress_is_what_the_score_would_say(parked_world: Prepare, t1: TrialSpec) -> None:
    for record in (True, False):
        with Episode(t1, card=BLIND, prepare=parked_world, record=record) as episode:
            episode.reset()
            with pytest.raises(ConfigError, match="privileged"):
                episode.progress()
            episode.privileged = True
            look = episode.reset()
            region = episode.simulation.data.site("region_forearm").xpos.copy()
            goal = look.pose_tcp_in_base.copy()
            goal[:3] = in_base(episode.simulation, region + [0, 0, 0.03])
            found = []
            for number in range(80):
                episode.step(Action(pose_tcp_in_base=goal, done=number == 79), observe=False)
                found.append(episode.progress())
            if record:
                recording = episode.finish()
    shares = [progress.share for progress in found]
    assert shares[0] == 0.0
    assert shares == sorted(shares), "a hold only becomes longer"
    assert any(0.1 < share < 0.9 for share in shares)
    distances = [progress.distance_m for progress in found]
    assert distances[0] > 0.2 > 0.03 > distances[-1]
    assert found[0].force_n == 0.0 < found[-1].force_n
    assert found[-1].elsewhere_n == 0.0
    score = score_recording(recording)
    end = found[-1]
    assert (end.success, end.safety_gated, end.safe) == (score.c3_success, score.safety_gated, not score.over_limit)
    assert (end.share == 1.0) == score.c3_success
    assert recording.header.privileged


def test_a_settled_world_begins_again_as_it_was_built(monkeypatch: pytest.MonkeyPatch) -> None:
    """The world of a trial itself, and not one that a test has put together."""
    monkeypatch.setattr(Peak, "pictures", lambda self, renderer, region: {})
    spec = TrialSpec(protocol=load_protocol("bathing-v3"), task_id="T6", seed=0, policy="blind")
    with Episode(spec, card=BLIND) as episode:
        once, again = roll(episode, actions=100), roll(episode, actions=100)
    simulation, settled, sha256 = settled_world(spec.protocol, task_id="T6", seed=0)
    with Episode(spec, card=BLIND, prepare=lambda _: (simulation, settled, sha256)) as episode:
        assert isinstance(episode.simulation, Simulation)
        built = roll(episode, actions=100)
    assert canonical_hash(once) == canonical_hash(again) == canonical_hash(built)
    assert touched(once)
