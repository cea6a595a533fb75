from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from carecontact.contract.action import Action
from carecontact.contract.geometry import pose_matrix
from carecontact.contract.policy import CAMERAS, PolicyCard
from carecontact.contract.trial import TrialSpec
from carecontact.episode.camera_poses import BELIEVED, TRUE
from carecontact.episode.episode import Episode
from carecontact.episode.prepare import World
from carecontact.episode.randomization import calibration
from carecontact.scoring.validity.values import check_finite_streams

CARD = PolicyCard(name="looking", modalities=("depth", "points"), cameras=("overhead", "wrist"), control_hz=20.0)


def test_a_policy_is_told_the_believed_pose_and_the_recording_keeps_both(
    t1: TrialSpec, parked_world: Callable[[TrialSpec], World]
) -> None:
    varied = t1.protocol.variation.model_copy(update={"calibration_m": 0.003, "calibration_deg": 0.2})
    spec = t1.model_copy(update={"protocol": t1.protocol.model_copy(update={"variation": varied})})
    with (
        Episode(spec, card=CARD, prepare=parked_world) as episode,
        Episode(t1, card=CARD, prepare=parked_world) as exact,
    ):
        told, true = episode.reset().cameras, exact.reset().cameras
        episode.step(Action(done=True))
        exact.step(Action(done=True))
        recording, other = episode.finish(), exact.finish()
    error = calibration(spec.protocol, spec.seed)["overhead"]
    np.testing.assert_allclose(
        told["overhead"].pose_camera_in_base, true["overhead"].pose_camera_in_base @ error, atol=1e-12
    )
    # The encoders know where the hand is.
    np.testing.assert_array_equal(told["wrist"].pose_camera_in_base, true["wrist"].pose_camera_in_base)
    # The camera itself stays where it is, and so does its picture; the points made of it move.
    assert told["overhead"].depth is not None
    assert true["overhead"].depth is not None
    np.testing.assert_array_equal(told["overhead"].depth, true["overhead"].depth)
    assert told["overhead"].points is not None
    assert true["overhead"].points is not None
    moved = np.median(np.linalg.norm(told["overhead"].points - true["overhead"].points, axis=1))
    assert 0.001 < moved < 0.03

    check_finite_streams(recording)
    assert not {BELIEVED, TRUE} & set(other.arrays)
    for path, cameras in ((BELIEVED, told), (TRUE, true)):
        assert recording[path].shape == (1, len(CAMERAS), 7)
        for row, name in zip(recording[path][0], CAMERAS, strict=True):
            if path == TRUE and name not in cameras:
                assert np.linalg.norm(row[3:]) == pytest.approx(1.0)
            elif name in cameras:
                pose = pose_matrix(row[:3], row[3:])
                np.testing.assert_allclose(pose, cameras[name].pose_camera_in_base, atol=1e-12)
            else:
                assert np.isnan(row).all()
