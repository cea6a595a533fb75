"""Makes the requests of the openpi family from an observation, key by key."""

from __future__ import annotations

import uuid

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from carecontact.contract.embodiment import PANDA
from carecontact.contract.observation import Observation
from carecontact.errors import ObservationError
from carecontact.hosting.dialects.images import U8, cropped_16_9, padded, stretched
from carecontact.hosting.dialects.profiles import (
    CARTESIAN,
    ENDPOINT,
    GRIPPER,
    JOINTS,
    PROMPT,
    SESSION,
    WRIST,
    Profile,
)

HAND_TURN_RAD = -np.pi / 4
"""Angle of the hand about the flange's axis, as the franka description package mounts it."""


def new_session_id() -> str:
    """Return a random session id: a version-4 UUID of the operating system's generator, which depends on no seed."""
    return str(uuid.uuid4())


def infer_request(observation: Observation, profile: Profile, *, session_id: str) -> dict[str, object]:
    """Make the request for one observation. ``session_id``: sent only if the profile asks for it.

    Raises ObservationError if a picture that the profile's card requests is missing.
    """
    images: dict[str, object] = {
        key: _image(observation, camera, profile) for camera, key in profile.exterior_keys.items()
    }
    if profile.wrist:
        images[WRIST] = _image(observation, "wrist", profile)
    joints = np.asarray(observation.joint_position, "<f8")
    gripper = _theirs(np.asarray(observation.gripper_position, "<f8"), profile)
    if not profile.endpoint:
        return {**images, JOINTS: joints, GRIPPER: gripper, PROMPT: observation.instruction}
    request: dict[str, object] = {
        JOINTS: joints, CARTESIAN: cartesian_position(observation.pose_tcp_in_base), GRIPPER: gripper,
        PROMPT: observation.instruction, **images,
    }  # fmt: skip
    if profile.session:
        request[SESSION] = session_id
    return {**request, ENDPOINT: "infer"}


def reset_request(session_id: str) -> dict[str, object]:
    return {SESSION: session_id, ENDPOINT: "reset"}


def cartesian_position(pose_tcp_in_base: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Turn the pose (7,) of our tool into DROID's pose (6,) of the flange (panda_link8): position [m] and Euler angles
    [rad] about the fixed axes x, y, z.
    """
    hand = Rotation.from_quat(pose_tcp_in_base[3:], scalar_first=True)
    position = pose_tcp_in_base[:3] - PANDA.tcp_z_m * hand.as_matrix()[:, 2]
    flange = hand * Rotation.from_euler("z", -HAND_TURN_RAD)
    return np.array([*position, *flange.as_euler("xyz")], "<f8")


def _theirs(opening: npt.NDArray[np.float64], profile: Profile) -> npt.NDArray[np.float64]:
    """Convert our gripper opening, where 0 is closed, to the server's convention."""
    return profile.closed_gripper + (1.0 - 2.0 * profile.closed_gripper) * opening


def _image(observation: Observation, camera: str, profile: Profile) -> U8:
    view = observation.cameras.get(camera)
    if view is None or view.rgb is None:
        raise ObservationError(f"observation.cameras.{camera}.rgb: expected a picture, got none")
    image = cropped_16_9(view.rgb)
    if profile.resize == "stretch":
        return stretched(image, profile.image_hw)
    assert profile.image_hw is not None
    return padded(image, profile.image_hw)
