from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import astuple, fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carecontact.audit.salt import OF_THE_WORLD, drawn_again
from carecontact.episode import randomization as episode_randomization
from carecontact.episode.episode import Episode
from carecontact.episode.log import PersonLog
from carecontact.episode.randomization import (
    World,
    calibration,
    sensor_noise,
    settled_world,
    streams,
)
from carecontact.human.soft_region import draw_tissue
from carecontact.interface.action import Action
from carecontact.interface.geometry import pose_matrix
from carecontact.interface.policy import CAMERAS, PolicyCard
from carecontact.interface.robot import PANDA
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden
from carecontact.protocol.person import Alive, Breathing
from carecontact.protocol.protocol import Protocol, TrialSpec
from carecontact.protocol.sections import ArmErrors
from carecontact.recording import Recording
from carecontact.scoring.validity import check_finite_streams
from carecontact.sensing.calibration import BELIEVED, TRUE
from carecontact.tissue.plugin import Law
from carecontact.world import draws
from carecontact.world.draws import STREAMS, arm_bias_of, posture_of

SHIPPED = load_protocol("bathing-v3")
PROTOCOL = SHIPPED.model_copy(update={"randomization": SHIPPED.randomization.model_copy(update={"drawn_as": ""})})
"""Seeds draw from its own id."""
SEEDS = PROTOCOL.randomization.seeds

GOLDEN_DEG = {0: 53.645615330454, 1: 51.275253879803, 7: 48.712697454078, 19: 49.943226319492}
"""Seeds of published results: an angle that changes here changes every trial of the protocol."""


def comfort_arm_deg(protocol: Protocol, seed: int, *, salt: str = "") -> float:
    """Of the seed's first draw of a person."""
    return posture_of(protocol, seed, salt, 0).comfort_arm_deg


@pytest.mark.parametrize(("seed", "angle"), GOLDEN_DEG.items())
def test_angles_of_the_protocol(seed: int, angle: float) -> None:
    assert comfort_arm_deg(SHIPPED, seed) == pytest.approx(angle, abs=1e-9)


@given(st.integers(0, 2**32))
def test_angle_is_in_range_and_repeats(seed: int) -> None:
    low, high = PROTOCOL.randomization.comfort_arm_deg
    angle = comfort_arm_deg(PROTOCOL, seed)
    assert low <= angle <= high
    assert comfort_arm_deg(PROTOCOL, seed) == angle


def test_angle_depends_on_the_protocols_id_and_nothing_else_in_it() -> None:
    person = PROTOCOL.person.model_copy(update={"body": "x"})
    changes = {"tasks": PROTOCOL.tasks[:1], "description": "other", "person": person}
    other_physics = PROTOCOL.model_copy(update=changes)
    renamed = PROTOCOL.model_copy(update={"id": "other-v1"})
    angles = [comfort_arm_deg(PROTOCOL, s) for s in SEEDS]
    assert [comfort_arm_deg(other_physics, s) for s in SEEDS] == angles
    assert all(comfort_arm_deg(renamed, s) != a for s, a in zip(SEEDS, angles, strict=True))


@pytest.mark.parametrize("salt", ["", "5a" * 32])
def test_a_renamed_protocol_keeps_its_persons_where_it_says_so(salt: str) -> None:
    kept = PROTOCOL.randomization.model_copy(update={"drawn_as": PROTOCOL.id})
    renamed = PROTOCOL.model_copy(update={"id": "other-v1", "randomization": kept})
    for seed in SEEDS[:3]:
        assert comfort_arm_deg(renamed, seed, salt=salt) == comfort_arm_deg(PROTOCOL, seed, salt=salt)


def test_angles_of_the_protocols_seeds_spread_over_the_range() -> None:
    low, high = PROTOCOL.randomization.comfort_arm_deg
    angles = np.array([comfort_arm_deg(PROTOCOL, s) for s in SEEDS])
    assert len(np.unique(angles)) == len(SEEDS)
    thirds = np.histogram(angles, bins=3, range=(low, high))[0]
    assert thirds.min() >= 2


def test_angle_scales_with_the_range() -> None:
    """The draw is a share of the range, so a narrower range keeps the order of the seeds."""
    narrow = PROTOCOL.model_copy(
        update={"randomization": PROTOCOL.randomization.model_copy(update={"comfort_arm_deg": (50.0, 51.0)})}
    )
    low, high = PROTOCOL.randomization.comfort_arm_deg
    for seed in SEEDS[:5]:
        share = (comfort_arm_deg(PROTOCOL, seed) - low) / (high - low)
        assert comfort_arm_deg(narrow, seed) - 50.0 == pytest.approx(share, abs=1e-9)


def test_streams_are_the_documented_children_of_the_seed() -> None:
    """Built by hand from id and seed: the k-th stream is the k-th child, whatever else is drawn or added."""
    digest = hashlib.sha256(PROTOCOL.id.encode()).digest()
    words = [int.from_bytes(digest[k : k + 4], "little") for k in range(0, 32, 4)]
    made = streams(PROTOCOL, 3, "")
    names = "comfort_arm appearance sensor_noise policy light place breathing repositioning withdrawal calibration"
    assert (
        tuple(made)
        == STREAMS
        == (*names.split(), *"tissue body pose park camera bed_height arm foam distractors".split())
    )
    for k, name in enumerate(STREAMS):
        child = np.random.SeedSequence([*words, 3], spawn_key=(k,))
        np.testing.assert_array_equal(made[name].random(4), np.random.default_rng(child).random(4))


def test_a_salt_changes_every_stream_and_ties_none_to_another() -> None:
    """By hand: each stream is seeded by a hash of its own, and the protocol's own seeds stay as they are."""
    made, other = streams(PROTOCOL, 3, "5a" * 32), streams(PROTOCOL, 3, "5b" * 32)
    assert tuple(made) == STREAMS
    for name, unsalted in streams(PROTOCOL, 3, "").items():
        digest = hashlib.sha256(f"{'5a' * 32} {PROTOCOL.id} 3 {name}".encode()).digest()
        drawn = made[name].random(4)
        np.testing.assert_array_equal(drawn, np.random.default_rng(np.frombuffer(digest, "<u4").tolist()).random(4))
        assert not np.isin(drawn, [unsalted.random(4), other[name].random(4)]).any()


def test_every_draw_of_a_salted_trial_uses_its_salt(monkeypatch: pytest.MonkeyPatch) -> None:
    varied = {"appearance": "varied-v1", "light": "varied-v1", "depth_noise": "structured-light-v1"}
    varied |= {"encoder_noise_rad": 0.003, "place_along_m": 0.01, "calibration_m": 0.003}
    person = PROTOCOL.person.model_copy(update={"alive": Alive(breathing=Breathing())})
    variation = PROTOCOL.variation.model_copy(update=varied)
    protocol = PROTOCOL.model_copy(update={"person": person, "variation": variation})
    used: list[str] = []
    for module in (episode_randomization, draws):
        monkeypatch.setattr(module, "streams", lambda *given: used.append(given[2]) or streams(*given))
    spec = TrialSpec(protocol=protocol, task_id="T1", seed=0, policy="zero-action", salt="5a" * 32)
    with Episode(spec, card=PolicyCard(name="blind", control_hz=20.0)) as episode:
        episode.reset()
    assert used == ["5a" * 32] * 6


def test_salted_noise_does_not_reveal_the_seed() -> None:
    """The attack: try candidate seeds against one reading of the encoders of the robot that stands parked."""
    noisy = PROTOCOL.model_copy(
        update={"variation": PROTOCOL.variation.model_copy(update={"encoder_noise_rad": 0.003})}
    )
    parked, seed, candidates = np.array(PROTOCOL.scene.parked_joint_rad), 217, range(300)
    sag = 1e-4 * np.random.default_rng(0).standard_normal(7)

    def misses(salt: str) -> list[float]:
        """[rad] of every candidate, as somebody who does not know the salt computes them."""
        seen = sensor_noise(noisy, seed, noise_salt=salt).joint_position(parked + sag, sim_time_s=0.0)
        return [np.abs(sensor_noise(noisy, s).joint_position(parked, sim_time_s=0.0) - seen).max() for s in candidates]

    assert int(np.argmin(misses(""))) == seed, "the attack works where there is no salt"
    assert min(misses("0123abcd")) > 1e-3

    same = [sensor_noise(noisy, seed, noise_salt="0123abcd").joint_position(parked, sim_time_s=0.1) for _ in range(2)]
    np.testing.assert_array_equal(*same)
    other = sensor_noise(noisy, seed + 1, noise_salt="0123abcd").joint_position(parked, sim_time_s=0.1)
    assert np.abs(other - same[0]).max() > 1e-3


def test_streams_are_independent() -> None:
    draws = {name: generator.random(2000) for name, generator in streams(PROTOCOL, 0, "").items()}
    drained = streams(PROTOCOL, 0, "")
    drained["comfort_arm"].random(1000)
    for name in STREAMS[1:]:
        np.testing.assert_array_equal(drained[name].random(2000), draws[name])
    correlation = np.corrcoef(list(draws.values())) - np.eye(len(STREAMS))
    assert np.abs(correlation).max() < 0.1


def test_policy_stream_of_one_seed_says_nothing_about_the_next() -> None:
    table = np.array([[streams(PROTOCOL, s, "")[n].random() for n in STREAMS] for s in range(300)])
    assert len(np.unique(table)) == table.size
    assert np.abs(np.corrcoef(table.T) - np.eye(len(STREAMS))).max() < 0.2


# A trial whose seed draws how stiff the person's tissue is, and what its recording says of it.

DRAWN = overridden(load_protocol("bathing-v3"), {"variation.tissue": "published-v1"})
COLUMNS = [field.name for field in fields(Law)]


def laws(protocol: Protocol, seed: int) -> np.ndarray:
    simulation, settled, _ = settled_world(protocol, task_id="T1", seed=seed)
    return PersonLog(simulation, "forearm").constants(settled)["scorer/region_law"]


def test_a_seed_draws_its_tissue_again_and_another_seed_another() -> None:
    first, again, other = laws(DRAWN, 0), laws(DRAWN, 0), laws(DRAWN, 1)
    np.testing.assert_array_equal(first, again)
    assert (first[:, 0] != other[:, 0]).all()
    rows = draw_tissue(streams(DRAWN, 0, "")["tissue"], DRAWN.person.tissue)
    np.testing.assert_array_equal(first, [astuple(Law.of(rows[name])) for name in DRAWN.regions])
    same = [COLUMNS.index(name) for name in ("friction", "thickness_m", "contact_n_m3", "membrane_n_m")]
    np.testing.assert_array_equal(first[:, same], other[:, same])


def test_the_person_lies_as_without_the_draw_and_only_then_the_law_is_recorded() -> None:
    plain, drawn = (settled_world(rules, task_id="T1", seed=0) for rules in (load_protocol("bathing-v3"), DRAWN))
    np.testing.assert_array_equal(plain[0].integration_state(), drawn[0].integration_state())
    assert plain[2] == drawn[2], "the compiled model is the same: the draw belongs to the seed"
    assert "scorer/region_law" not in PersonLog(plain[0], "forearm").constants(plain[1])


def test_a_recording_holds_the_law_of_a_body_of_another_build() -> None:
    rules = overridden(load_protocol("bathing-v3"), {"person.body": "woman-adult-heavy"})
    spec = TrialSpec(protocol=rules, task_id="T1", seed=0, policy="blind")
    card = PolicyCard(name="blind", modalities=(), cameras=(), control_hz=10)
    with Episode(spec, card=card) as episode:
        episode.reset()
        episode.step(Action(done=True))
        recording = episode.finish()
    law = recording["scorer/region_law"]
    declared = np.array([astuple(Law.of(rules.person.tissue[name])) for name in rules.regions])
    thickness, stiffness = COLUMNS.index("thickness_m"), COLUMNS.index("a_n_m3")
    assert (law[:, thickness] > declared[:, thickness]).all()
    assert (law[:, stiffness] < declared[:, stiffness]).all()


CARD = PolicyCard(name="looking", modalities=("depth", "points"), cameras=("overhead", "wrist"), control_hz=20.0)


def test_a_policy_gets_the_believed_pose_and_the_recording_keeps_both(
    t1: TrialSpec, parked_world: Callable[[TrialSpec], World]
) -> None:
    varied = t1.protocol.variation.model_copy(update={"calibration_m": 0.003, "calibration_deg": 0.2})
    spec = t1.model_copy(update={"protocol": t1.protocol.model_copy(update={"variation": varied})})
    with (
        Episode(spec, card=CARD, prepare=parked_world) as episode,
        Episode(t1, card=CARD, prepare=parked_world) as exact,
    ):
        shown, true = episode.reset().cameras, exact.reset().cameras
        episode.step(Action(done=True))
        exact.step(Action(done=True))
        recording, other = episode.finish(), exact.finish()
    error = calibration(spec.protocol, spec.seed)["overhead"]
    np.testing.assert_allclose(
        shown["overhead"].pose_camera_in_base, true["overhead"].pose_camera_in_base @ error, atol=1e-12
    )
    # The encoders know where the hand is.
    np.testing.assert_array_equal(shown["wrist"].pose_camera_in_base, true["wrist"].pose_camera_in_base)
    # The camera itself stays where it is, and so does its picture; the points made of it move.
    assert shown["overhead"].depth is not None
    assert true["overhead"].depth is not None
    np.testing.assert_array_equal(shown["overhead"].depth, true["overhead"].depth)
    assert shown["overhead"].points is not None
    assert true["overhead"].points is not None
    moved = np.median(np.linalg.norm(shown["overhead"].points - true["overhead"].points, axis=1))
    assert 0.001 < moved < 0.03

    check_finite_streams(recording)
    assert not {BELIEVED, TRUE} & set(other.arrays)
    for path, cameras in ((BELIEVED, shown), (TRUE, true)):
        assert recording[path].shape == (1, len(CAMERAS), 7)
        for row, name in zip(recording[path][0], CAMERAS, strict=True):
            if path == TRUE and name not in cameras:
                assert np.linalg.norm(row[3:]) == pytest.approx(1.0)
            elif name in cameras:
                pose = pose_matrix(row[:3], row[3:])
                np.testing.assert_allclose(pose, cameras[name].pose_camera_in_base, atol=1e-12)
            else:
                assert np.isnan(row).all()


def test_a_policy_learns_the_size_of_the_arms_errors_and_the_recording_alone_what_was_drawn() -> None:
    spec = TrialSpec(
        protocol=SHIPPED.model_copy(update={"arm_errors": ArmErrors()}), task_id="T1", seed=3, policy="synthetic"
    )
    with Episode(spec, card=PolicyCard(name="synthetic", cameras=())) as episode:
        session = episode.session
        episode.reset()
        episode.step(Action(done=True))
        recording = episode.finish()
    assert (session.force_bias_n, session.joint_friction_nm) == (1.0, PANDA.friction_nm)
    assert recording.header.drawn["force_bias_n"] == arm_bias_of(spec.protocol, 3, "").tolist()
    assert list(drawn_again(recording, ""))[1] == (OF_THE_WORLD, True)
    other = recording.header.drawn | {"force_bias_n": [0.0, 0.0, 0.0]}
    changed = Recording(header=recording.header.model_copy(update={"drawn": other}), arrays=recording.arrays)
    assert list(drawn_again(changed, ""))[1] == (OF_THE_WORLD, False)
