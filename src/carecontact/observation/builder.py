"""The one place where an observation is made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from carecontact.contract.geometry import quat_from_matrix
from carecontact.contract.observation import CameraView, Observation
from carecontact.contract.policy import PolicyCard
from carecontact.contract.protocol import Protocol, Variation
from carecontact.errors import ObservationError
from carecontact.observation.keypoints import KeypointEstimator
from carecontact.observation.pointcloud import coloured_cloud, organised_points, surface_under
from carecontact.observation.segmentation import PersonSegmenter, segment
from carecontact.observation.sensor_noise import SensorNoise

if TYPE_CHECKING:
    import mujoco

    from carecontact.sim.rendering import SceneRenderer

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
U8 = npt.NDArray[np.uint8]

IMAGES_FOR = {
    "rgb": ("rgb",),
    "depth": ("depth",),
    "points": ("rgb", "depth"),
    "masks": ("rgb", "depth", "robot_depth", "cell_depth"),
    "landmarks": ("rgb", "depth"),
}
"""Modality -> the images from which it is made; no other image is rendered."""

ALLOWED = frozenset(
    (
        "instruction",
        "sim_time_s",
        "joint_position",
        "joint_velocity",
        "gripper_position",
        "pose_tcp_in_base",
        "cameras",
    )
)
"""A literal list and not the fields of the dataclass, so that a new field needs a second, deliberate edit."""
ALLOWED_IN_VIEW = frozenset(
    (
        "intrinsics",
        "pose_camera_in_base",
        "rgb",
        "depth",
        "points",
        "point_colors",
        "masks",
        "landmarks",
        "landmarks_in_base",
    )
)


@dataclass(frozen=True, kw_only=True)
class RawView:
    """The images of one camera; every derived modality is a function of them alone."""

    intrinsics: F64
    pose_camera_in_base: F64
    """(4, 4) as the cell believes it to be (``observation.calibration``)."""
    rgb: U8 | None = None
    depth: F32 | None = None
    robot_depth: F32 | None = None
    """Depth of the robot's own model at the encoder angles, from the believed pose."""
    cell_depth: F32 | None = None
    """Depth of the empty cell, which is known from calibration, from the believed pose."""


@dataclass(frozen=True, kw_only=True)
class RawReadings:
    """Everything from which one observation is made, except the instruction and the time."""

    joint_position: F64
    joint_velocity: F64
    pose_tcp_in_base: F64
    """(4, 4), which the robot's controller knows from its encoders."""
    views: dict[str, RawView]


def assemble(values: Mapping[str, Any], views: Mapping[str, Mapping[str, Any]]) -> Observation:
    """Make an observation of the allowed fields: the only caller of Observation's constructor in a trial.

    Raises ObservationError naming any key that a policy may not see.
    """
    for place, keys, allowed in [
        ("observation", set(values) | {"cameras"}, ALLOWED),
        *((f"camera {name}", set(view), ALLOWED_IN_VIEW) for name, view in views.items()),
    ]:
        forbidden = sorted(keys - allowed)
        if forbidden:
            raise ObservationError(f"{place}: {', '.join(forbidden)} must not reach a policy; valid: {sorted(allowed)}")
    return Observation(**values, cameras={name: CameraView(**view) for name, view in views.items()})


def derive_view(
    raw: RawView,
    *,
    modalities: tuple[str, ...],
    keypoints: KeypointEstimator,
    segmenter: PersonSegmenter | None = None,
) -> dict[str, Any]:
    """Make every named modality from one camera's images; a pure function if the models are. Without a ``segmenter``
    the estimator's own person mask is used.

    Raises ObservationError if an image that a modality needs is missing.
    """
    missing = sorted({i for m in modalities for i in IMAGES_FOR[m] if getattr(raw, i) is None})
    if missing:
        raise ObservationError(
            f"raw view: expected the images that {', '.join(modalities)} are made of, got no {' and no '.join(missing)}"
        )
    view: dict[str, Any] = {"intrinsics": raw.intrinsics, "pose_camera_in_base": raw.pose_camera_in_base}
    points = found = person = masks = None
    if raw.depth is not None and {"points", "masks"} & set(modalities):
        points = organised_points(raw.depth, raw.intrinsics, raw.pose_camera_in_base)
    if raw.rgb is not None and ("landmarks" in modalities or ("masks" in modalities and segmenter is None)):
        found = keypoints.estimate(raw.rgb)
        person = found.person
    if raw.rgb is not None and "masks" in modalities and segmenter is not None:
        person = segmenter.person(raw.rgb)
    if "rgb" in modalities:
        view["rgb"] = raw.rgb
    if "depth" in modalities:
        view["depth"] = raw.depth
    if "points" in modalities and points is not None and raw.rgb is not None:
        view["points"], view["point_colors"] = coloured_cloud(points, raw.rgb)
    if "masks" in modalities and person is not None and points is not None:
        assert raw.depth is not None
        assert raw.robot_depth is not None
        assert raw.cell_depth is not None
        masks = view["masks"] = segment(
            person=person,
            depth=raw.depth,
            robot_depth=raw.robot_depth,
            cell_depth=raw.cell_depth,
            points=points,
        )
    if "landmarks" in modalities and found and raw.depth is not None:
        view["landmarks"] = found.landmarks
        view["landmarks_in_base"] = surface_under(
            found.landmarks,
            raw.depth,
            raw.intrinsics,
            raw.pose_camera_in_base,
            where=None if masks is None else masks["human"],
        )
    return view


def derive(
    raw: RawReadings,
    *,
    instruction: str,
    sim_time_s: float,
    modalities: tuple[str, ...],
    keypoints: KeypointEstimator,
    segmenter: PersonSegmenter | None = None,
) -> Observation:
    """Make the observation from raw readings, without a simulator. Raises ObservationError as its parts do."""
    pose = raw.pose_tcp_in_base
    values = {
        "instruction": instruction,
        "sim_time_s": sim_time_s,
        "joint_position": raw.joint_position,
        "joint_velocity": raw.joint_velocity,
        # The gripper is permanently closed and has no actuator to read.
        "gripper_position": np.zeros(1),
        "pose_tcp_in_base": np.concatenate([pose[:3, 3], quat_from_matrix(pose[:3, :3])]),
    }
    views = {
        camera: derive_view(
            view,
            modalities=modalities,
            keypoints=keypoints,
            segmenter=segmenter,
        )
        for camera, view in raw.views.items()
    }
    return assemble(values, views)


class ObservationBuilder:
    """Builds the observation of one policy: renders what its card names, derives the rest, and reads the encoders."""

    def __init__(
        self,
        renderer: SceneRenderer,
        card: PolicyCard,
        protocol: Protocol,
        keypoints: KeypointEstimator,
        *,
        noise: SensorNoise | None = None,
        segmenter: PersonSegmenter | None = None,
    ) -> None:
        self._renderer, self._card, self._keypoints, self._segmenter = renderer, card, keypoints, segmenter
        # Without a key no noise can be repeated; a protocol with noise needs the trial's own.
        self._noise = noise or SensorNoise(Variation(), key=(), dt_s=protocol.physics.dt_s)
        self._images = {image for modality in card.modalities for image in IMAGES_FOR[modality]}
        self.raw: RawReadings | None = None
        """What the last observation was made of; for the audit, never for a policy."""

    def build(self, data: mujoco.MjData, *, instruction: str, sim_time_s: float) -> Observation:
        """``data`` is only read. Images show the last computed kinematics."""
        robot = self._renderer.proprioception
        angles = self._noise.joint_position(robot.joint_position(data), sim_time_s=sim_time_s)
        # Whatever is computed from the encoders is computed from their noisy readings.
        known = self._renderer.at_encoders(angles) if self._noise.on_encoders else data
        self.raw = RawReadings(
            joint_position=angles,
            joint_velocity=robot.joint_velocity(data),
            pose_tcp_in_base=robot.pose_tcp_in_base(known),
            views={c: self.raw_view(data, c, angles=angles, sim_time_s=sim_time_s) for c in self._card.cameras},
        )
        return derive(
            self.raw,
            instruction=instruction,
            sim_time_s=sim_time_s,
            modalities=self._card.modalities,
            keypoints=self._keypoints,
            segmenter=self._segmenter,
        )

    def raw_view(self, data: mujoco.MjData, camera: str, *, angles: F64, sim_time_s: float) -> RawView:
        """``angles``: (joints,) [rad] as the encoders give them."""
        renderer, images = self._renderer, self._images
        intrinsics, depth = renderer.intrinsics(camera), None
        # Where calibration and encoders have the camera, and not where it is.
        pose = renderer.pose_camera_in_base(renderer.at_encoders(angles), camera)
        if "depth" in images:
            depth = renderer.depth(data, camera)
            depth = self._noise.depth(depth, intrinsics, camera=camera, sim_time_s=sim_time_s)
        return RawView(
            intrinsics=intrinsics,
            pose_camera_in_base=pose,
            rgb=renderer.rgb(data, camera) if "rgb" in images else None,
            depth=depth,
            robot_depth=renderer.robot_depth(angles, camera) if "robot_depth" in images else None,
            cell_depth=renderer.cell_depth(angles, camera) if "cell_depth" in images else None,
        )
