"""What a policy may see: an allow-list, so that a new field is a decision and not an accident."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, fields

import numpy as np
import pytest

from carecontact.contract.observation import MODALITIES, CameraView, Observation

VISIBLE = {
    "instruction", "sim_time_s", "joint_position", "joint_velocity", "gripper_position", "pose_tcp_in_base", "cameras",
}  # fmt: skip
VISIBLE_IN_A_CAMERA = {
    "intrinsics", "pose_camera_in_base", "rgb", "depth", "points", "point_colors", "masks", "landmarks",
    "landmarks_in_base",
}  # fmt: skip


def view(**kwargs: np.ndarray) -> CameraView:
    return CameraView(intrinsics=np.eye(3), pose_camera_in_base=np.eye(4), **kwargs)


def observation() -> Observation:
    return Observation(
        instruction="touch", sim_time_s=0.0, joint_position=np.zeros(7), joint_velocity=np.zeros(7),
        gripper_position=np.zeros(1), pose_tcp_in_base=np.array([0, 0, 0, 1.0, 0, 0, 0]),
    )  # fmt: skip


def test_nothing_but_the_allowed_fields() -> None:
    assert {f.name for f in fields(Observation)} == VISIBLE
    assert {f.name for f in fields(CameraView)} == VISIBLE_IN_A_CAMERA


def test_every_modality_is_a_field_that_is_absent_unless_given() -> None:
    assert set(MODALITIES) <= VISIBLE_IN_A_CAMERA
    assert [getattr(view(), m) for m in MODALITIES] == [None] * len(MODALITIES)


def test_observations_are_frozen_and_share_no_dictionary() -> None:
    first, second = observation(), observation()
    with pytest.raises(FrozenInstanceError):
        first.instruction = "push"  # pyright: ignore[reportAttributeAccessIssue]
    first.cameras["overhead"] = view()
    assert second.cameras == {}
