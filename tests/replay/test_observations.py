"""A recorded trial seen again: equal to what the policy was sent, and rows for a dataset."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from carecontact.episode.episode import Episode
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TRAINING_SALT, TrialSpec
from carecontact.recording import Recording
from carecontact.recording.pictures import Pictures
from carecontact.replay.dataset import Rendering, Resensed
from carecontact.replay.replay import recorded_actions

CARD = PolicyCard(name="p", modalities=("rgb", "depth"), cameras=("overhead", "wrist"), control_hz=10)


STEPS = 6


@pytest.fixture(scope="module", params=["L0", pytest.param("L2", marks=pytest.mark.slow)])
def trained(request: pytest.FixtureRequest) -> tuple[Recording, list[np.ndarray], list[np.ndarray]]:
    """A trial of a person to train on, on L2 with noisy sensors, and the readings that its policy received."""
    protocol = load_protocol("bathing-wide-v2", level=request.param)
    spec = TrialSpec(protocol=protocol, task_id="T1", seed=0, policy="p", salt=TRAINING_SALT)
    with Episode(spec, card=CARD) as episode:
        seen = episode.reset()
        poses, joints = [seen.pose_tcp_in_base], [seen.joint_position]
        for k in range(STEPS):
            pose = poses[0] + [0.004 * k, 0, -0.004 * k, 0, 0, 0, 0]
            step = episode.step(Action(pose_tcp_in_base=pose, done=k == STEPS - 1))
            if step.observation is not None:
                poses.append(step.observation.pose_tcp_in_base)
                joints.append(step.observation.joint_position)
        return episode.finish(), poses, joints


def test_pictures_and_readings_are_those_of_the_trial(
    trained: tuple[Recording, list[np.ndarray], list[np.ndarray]],
) -> None:
    recording, poses, joints = trained
    resensed, kept = Resensed(recording, CARD), Pictures(recording)
    again = list(resensed.observations(10))
    assert (resensed.quality.kind, len(again)) == ("exact", STEPS)
    for k, seen in enumerate(again):
        np.testing.assert_array_equal(seen.pose_tcp_in_base, poses[k])
        np.testing.assert_array_equal(seen.joint_position, joints[k])
        for camera in CARD.cameras:
            np.testing.assert_array_equal(seen.cameras[camera].rgb, kept[k, camera, "rgb"])
            np.testing.assert_array_equal(seen.cameras[camera].depth, kept[k, camera, "depth"])


def test_rows_have_pictures_points_and_actions(
    trained: tuple[Recording, list[np.ndarray], list[np.ndarray]], tmp_path: Path
) -> None:
    recording, poses, _ = trained
    rendering = Rendering(sizes={"overhead": 64, "wrist": 32}, hz=10, film=True, points=50)
    episode, quality = rendering.episode(recording, success=True, folder=tmp_path)
    assert (quality.kind, len(episode), episode.fps) == ("exact", STEPS, 10)
    rows = {name: stream.values for name, stream in episode.streams.items()}
    given = np.array([action.pose_tcp_in_base for action in recorded_actions(recording)])
    np.testing.assert_allclose(rows["action"][:, :3], given[:, :3], atol=1e-6)
    np.testing.assert_array_equal(rows["action"][:, 7], [0] * (STEPS - 1) + [1])
    np.testing.assert_allclose(rows["observation.state"][:, :3], np.array(poses)[:, :3], atol=1e-6)
    assert rows["next.success"].ravel().tolist() == rows["next.done"].ravel().tolist() == [False] * (STEPS - 1) + [True]
    cloud = rows["observation.points"]
    assert cloud.shape == (STEPS, 50, 6)
    assert (cloud[..., 3:] >= 0).all()
    assert (cloud[..., 3:] <= 1).all()
    low, high = (
        getattr(recording.header.spec.protocol.impedance.action_bounds, f"workspace_{side}_m")
        for side in ("low", "high")
    )
    assert ((cloud[..., :3] >= np.array(low) - 1e-6) & (cloud[..., :3] <= np.array(high) + 1e-6)).all()
    clip = episode.clips["overhead"]
    assert clip.shape == (64, 64, 3)
    assert clip.histogram.sum() == 3 * STEPS * 64 * 64
    assert clip.path.stat().st_size > 0
