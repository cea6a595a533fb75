"""What a policy receives under each control, beside what it would receive without."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from carecontact.episode.episode import Episode
from carecontact.episode.looks import SALT, control_of
from carecontact.episode.randomization import World
from carecontact.errors import ConfigError
from carecontact.interface.action import Action
from carecontact.interface.observation import Observation
from carecontact.interface.policy import LOOK_CONTROLS, VARIANT, PolicyCard
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TRAINING_SALT, TrialSpec

CARD = PolicyCard(name="p", modalities=("rgb", "depth", "points"), cameras=("overhead", "wrist"), tool_velocity=True)


def two_looks(spec: TrialSpec, control: str, **more: object) -> tuple[list[Observation], Episode]:
    """The first observation and one while the tool moves."""
    with Episode(spec, card=CARD, record=False, **more) as episode:  # type: ignore[arg-type]
        episode.control = control
        first = episode.reset()
        pose = first.pose_tcp_in_base + [0, 0, 0.02, 0, 0, 0, 0]
        second = episode.step(Action(pose_tcp_in_base=pose)).observation
        assert second is not None
        return [first, second], episode


def test_the_frozen_look_keeps_the_first_pictures_and_the_feel(
    t1: TrialSpec, parked_world: Callable[[TrialSpec], World]
) -> None:
    plain, _ = two_looks(t1, "", prepare=parked_world)
    frozen, _ = two_looks(t1, "frozen-look", prepare=parked_world)
    assert not np.array_equal(plain[1].cameras["wrist"].rgb, plain[0].cameras["wrist"].rgb)
    for camera in CARD.cameras:
        np.testing.assert_array_equal(frozen[1].cameras[camera].rgb, plain[0].cameras[camera].rgb)
        np.testing.assert_array_equal(frozen[1].cameras[camera].depth, plain[0].cameras[camera].depth)
    assert frozen[1].new == CARD.cameras
    np.testing.assert_array_equal(frozen[1].pose_tcp_in_base, plain[1].pose_tcp_in_base)


def test_without_touch_the_tool_is_at_its_target_and_the_camera_on_the_hand_with_it(
    t1: TrialSpec, parked_world: Callable[[TrialSpec], World]
) -> None:
    plain, _ = two_looks(t1, "", prepare=parked_world)
    numb, episode = two_looks(t1, "no-touch", prepare=parked_world)
    lag_m = np.linalg.norm(plain[1].pose_tcp_in_base[:3] - episode.simulation.control.target_in_base[:3])
    assert lag_m > 1e-3
    np.testing.assert_array_equal(numb[1].pose_tcp_in_base, episode.simulation.control.target_in_base)
    np.testing.assert_array_equal(numb[1].joint_position, plain[0].joint_position)
    assert not numb[1].joint_velocity.any()
    assert numb[1].velocity_tcp_in_base is not None
    assert not numb[1].velocity_tcp_in_base.any()
    seen, known = numb[1].cameras["wrist"], plain[1].cameras["wrist"]
    np.testing.assert_array_equal(seen.rgb, known.rgb)
    moved = numb[1].pose_tcp_in_base[:3] - plain[1].pose_tcp_in_base[:3]
    np.testing.assert_allclose(seen.pose_camera_in_base[:3, 3] - known.pose_camera_in_base[:3, 3], moved, atol=2e-3)
    assert seen.points is not None
    assert known.points is not None
    assert np.abs(seen.points - known.points).max() > 1e-3
    np.testing.assert_array_equal(numb[1].cameras["overhead"].points, plain[1].cameras["overhead"].points)


@pytest.mark.parametrize("level", ["L0", pytest.param("L1", marks=pytest.mark.slow)])
def test_the_shuffled_look_shows_another_person_of_the_same_task(level: str) -> None:
    spec = TrialSpec(protocol=load_protocol("bathing-wide-v2", level=level), task_id="T1", seed=0, policy="p")
    plain, _ = two_looks(spec, "")
    shuffled, _ = two_looks(spec, "shuffled-look")
    other, _ = two_looks(spec.model_copy(update={"salt": SALT}), "")
    for k in (0, 1):
        for camera in CARD.cameras:
            seen, shown = shuffled[k].cameras[camera], other[0].cameras[camera]
            np.testing.assert_array_equal(seen.rgb, shown.rgb)
            np.testing.assert_array_equal(seen.points, shown.points)
            np.testing.assert_array_equal(seen.pose_camera_in_base, shown.pose_camera_in_base)
            assert not np.array_equal(seen.rgb, plain[k].cameras[camera].rgb)
        np.testing.assert_array_equal(shuffled[k].pose_tcp_in_base, plain[k].pose_tcp_in_base)
    assert SALT != TRAINING_SALT


def test_a_policy_that_commands_joints_has_no_touch_to_take_away(t1: TrialSpec) -> None:
    card = PolicyCard(name="joints", action_space="joint_position", control="droid")
    with Episode(t1, card=card, record=False) as episode, pytest.raises(ConfigError, match=r"no-touch: .* joints"):
        control_of("no-touch", episode, weights=None)


def test_every_control_is_a_variant() -> None:
    assert all(VARIANT.search(f"p+{name}") for name in LOOK_CONTROLS)
