"""Actions in joint space: what a recording may hold of them, and what the scorer reads from it."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.errors import RecordingError
from carecontact.recording import Recording
from carecontact.scoring import score_recording
from carecontact.scoring.attribution.commanded import target_poses
from tests.scoring.metrics.test_force_predicted import STIFFNESS, SWING, r2, recording


def in_joints() -> Recording:
    made = recording(SWING, STIFFNESS * SWING)
    count = len(made["actions/time_s"])
    made.arrays["actions/pose_tcp_in_base"] = np.full((count, 7), np.nan)
    made.arrays["actions/stiffness"] = np.full((count, 2), np.nan)
    made.arrays["actions/joint"] = np.zeros((count, 7))
    return made


def test_joint_actions_are_scored_from_the_pose_of_their_targets() -> None:
    made = in_joints()
    assert score_recording(made).trial_id == made.header.spec.trial_id
    assert r2(made) == pytest.approx(1.0)
    np.testing.assert_allclose(target_poses(made)[0], made["scorer/target_in_base"][0], atol=1e-6)


def test_half_a_joint_action_is_refused() -> None:
    made = in_joints()
    made["actions/joint"][0] = [1, np.nan, 0, 0, 0, 0, 0]
    with pytest.raises(RecordingError, match=r"actions/joint holds nan at \(0, 1\)"):
        score_recording(made)
