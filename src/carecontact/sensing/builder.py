"""Makes an observation of camera images, depth and encoders, with the sensors' noise: the only place where one is
made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from carecontact.errors import ObservationError
from carecontact.interface.geometry import back_project, back_projected, quat_from_matrix
from carecontact.interface.observation import F32, F64, U8, Bool, CameraView, Observation
from carecontact.interface.policy import CAMERAS, PolicyCard
from carecontact.protocol.protocol import Protocol
from carecontact.protocol.sections import Variation
from carecontact.sensing.keypoints import KeypointEstimator, KeyPoints
from carecontact.sensing.segmentation import PersonSegmenter, segment

if TYPE_CHECKING:
    import mujoco

    from carecontact.sim.rendering import SceneRenderer


WINDOWS_PX = (2, 6)
"""Half widths of the windows whose median depth stands for a landmark: one pixel is 3-4 mm overhead, edges are noisy;
the wider one serves a landmark that falls just beside its limb."""
AXIAL_M, AXIAL_PER_M, AXIAL_FROM_M = 0.0012, 0.0019, 0.4
"""sigma = 1.2 mm + 1.9 mm/m^2 (z - 0.4 m)^2: Nguyen, Izadi and Lovell 2012, for surfaces seen at up to 60 deg."""
LATERAL_PX = 0.8
"""Nguyen, Izadi and Lovell 2012: a pixel's depth is that of a place this far off (sigma), which frays edges."""
DISPARITY_STEP_PER_M = 2.85e-3
"""Depth comes in steps of this times z^2: Khoshelham and Elberink 2012."""
GRAZING_DEG = 80.0
"""No depth where the surface turns away further from the line of sight, and so none at steps in depth; assumed."""
SPEED_PER_ANGLE = 2 * np.pi * 10.0
"""[1/s] Standard deviation of the noise on a joint's speed over that on its angle. The Panda's measured speed is the
derivative of its measured position (a maintainer in frankarobotics/franka_ros, issue 289). Behind a low pass of first
order whose cutoff lies far below the rate of the encoders, white noise on the angles gives the speed noise of that size
times the cutoff [rad/s]. The cutoff of 10 Hz is assumed."""
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
        "instruction sim_time_s joint_position joint_velocity gripper_position pose_tcp_in_base velocity_tcp_in_base "
        "cameras"
    ).split()
)
"""A literal list and not the fields of the dataclass, so that a new field needs a second, deliberate edit."""
ALLOWED_IN_VIEW = frozenset(
    "intrinsics pose_camera_in_base rgb depth points point_colors masks landmarks landmarks_in_base".split()
)


def organised_points(depth: F32, intrinsics: F64, pose_camera_in_base: F64) -> F64:
    """(H, W) depth -> (H, W, 3) points in base [m]."""
    v, u = np.ogrid[: depth.shape[0], : depth.shape[1]]
    return back_projected(u, v, depth.astype(np.float64), intrinsics, pose_camera_in_base)


def coloured_cloud(points: F64, rgb: U8) -> tuple[F32, U8]:
    """(H, W, 3) points and colours -> (N, 3), (N, 3): the pixels with a depth, row by row."""
    valid = np.isfinite(points).all(-1).ravel()
    # Six times as fast as an index of booleans.
    return np.compress(valid, points.reshape(-1, 3).astype(np.float32), 0), np.compress(valid, rgb.reshape(-1, 3), 0)


def surface_under(landmarks: F32, depth: F32, intrinsics: F64, pose_camera_in_base: F64, *, where: Bool | None) -> F32:
    """(33, 3) landmarks -> (33, 3) surface points in base [m], NaN outside the image or without a depth.

    ``where`` (H, W) limits the depths that count, e.g. to the person's pixels.
    """
    height, width = depth.shape
    usable = np.isfinite(depth) if where is None else np.isfinite(depth) & where
    surface = np.full((len(landmarks), 3), np.nan, np.float32)
    for index, (u, v, _) in enumerate(landmarks):
        if not (np.isfinite(u) and np.isfinite(v) and -0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5):
            continue
        column, row = round(float(u)), round(float(v))
        for half in WINDOWS_PX:
            window = np.s_[max(row - half, 0) : row + half + 1, max(column - half, 0) : column + half + 1]
            depths = depth[window][usable[window]]
            if depths.size:
                surface[index] = back_project([u, v], float(np.median(depths)), intrinsics, pose_camera_in_base)
                break
    return surface


def structured_light(depth: F32, intrinsics: F64, rng: np.random.Generator) -> F32:
    """(H, W) true depth [m] -> what a structured-light camera of 640 x 480 px would report; NaN stays NaN."""
    height, width = depth.shape
    axial = rng.standard_normal((height, width))
    shift = np.rint(LATERAL_PX * rng.standard_normal((2, height, width))).astype(int)
    v, u = np.mgrid[:height, :width]
    seen = depth[np.clip(v + shift[0], 0, height - 1), np.clip(u + shift[1], 0, width - 1)].astype(np.float64)
    seen += axial * (AXIAL_M + AXIAL_PER_M * (seen - AXIAL_FROM_M) ** 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        seen = 1.0 / (DISPARITY_STEP_PER_M * np.rint(1.0 / (DISPARITY_STEP_PER_M * seen)))
    seen[~np.isfinite(depth) | (_incidence_deg(depth, intrinsics) > GRAZING_DEG) | ~(seen > 0)] = np.nan
    return seen.astype(np.float32)


def _incidence_deg(depth: F32, intrinsics: F64) -> F64:
    """(H, W) angle between line of sight and surface normal [deg]; 0 beside pixels without depth."""
    z = depth.astype(np.float64)
    per_v, per_u = np.gradient(z)
    v, u = np.mgrid[: z.shape[0], : z.shape[1]]
    right, down = u - intrinsics[0, 2], v - intrinsics[1, 2]
    focal_u, focal_v = intrinsics[0, 0], intrinsics[1, 1]
    # The normal of the surface (x, y, z)(u, v), up to length; its product with the line of sight is z.
    normal = np.sqrt((focal_u * per_u) ** 2 + (focal_v * per_v) ** 2 + (z + right * per_u + down * per_v) ** 2)
    sight = np.sqrt((right / focal_u) ** 2 + (down / focal_v) ** 2 + 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        angle = np.degrees(np.arccos(np.clip(z / (normal * sight), 0, 1)))
    return np.where(np.isfinite(angle), angle, 0.0)


class SensorNoise:
    """The protocol's noise for one trial. Every call for the same step and camera gives the same numbers."""

    def __init__(self, variation: Variation, *, key: Sequence[int], dt_s: float) -> None:
        self._variation, self._key, self._dt_s = variation, [int(k) for k in key], dt_s

    @property
    def on_encoders(self) -> bool:
        return self._variation.encoder_noise_rad > 0

    def depth(self, depth: F32, intrinsics: F64, *, camera: str, sim_time_s: float) -> F32:
        """(H, W) [m]"""
        if self._variation.depth_noise == "none":
            return depth
        return structured_light(depth, intrinsics, self._rng(sim_time_s, 1 + CAMERAS.index(camera)))

    def joint_position(self, joint_position: F64, *, sim_time_s: float) -> F64:
        """(joints,) [rad]"""
        if not self.on_encoders:
            return joint_position
        noise = self._rng(sim_time_s, 0).standard_normal(joint_position.shape)
        return joint_position + self._variation.encoder_noise_rad * noise

    def joint_velocity(self, joint_velocity: F64, *, sim_time_s: float) -> F64:
        """(joints,) [rad/s]"""
        if not self.on_encoders:
            return joint_velocity
        noise = self._rng(sim_time_s, 1 + len(CAMERAS)).standard_normal(joint_velocity.shape)
        return joint_velocity + SPEED_PER_ANGLE * self._variation.encoder_noise_rad * noise

    def _rng(self, sim_time_s: float, sensor: int) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence([*self._key, round(sim_time_s / self._dt_s), sensor]))


@dataclass(frozen=True, kw_only=True)
class RawView:
    """The images of one camera; every derived modality is a function of them alone."""

    intrinsics: F64
    pose_camera_in_base: F64
    """(4, 4) as the cell believes it to be (``sensing.calibration``)."""
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
    velocity_tcp_in_base: F64 | None = None
    """(6,), from the same; None unless the card requests it."""


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
    rgb, depth, camera = cast(U8, raw.rgb), cast(F32, raw.depth), (raw.intrinsics, raw.pose_camera_in_base)
    wants_masks, wants_landmarks = "masks" in modalities, "landmarks" in modalities
    points = organised_points(depth, *camera) if "points" in modalities or wants_masks else np.empty(0)
    found = keypoints.estimate(rgb) if wants_landmarks or (wants_masks and segmenter is None) else None
    view |= {name: getattr(raw, name) for name in ("rgb", "depth") if name in modalities}
    if "points" in modalities:
        view["points"], view["point_colors"] = coloured_cloud(points, rgb)
    if wants_masks:
        view["masks"] = segment(
            person=cast(KeyPoints, found).person if segmenter is None else segmenter.person(rgb),
            depth=depth,
            robot_depth=cast(F32, raw.robot_depth),
            cell_depth=cast(F32, raw.cell_depth),
            points=points,
        )
    if wants_landmarks and found is not None:
        where = view["masks"]["human"] if wants_masks else None
        view["landmarks"] = found.landmarks
        view["landmarks_in_base"] = surface_under(found.landmarks, depth, *camera, where=where)
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
        "velocity_tcp_in_base": raw.velocity_tcp_in_base,
    }
    views = {
        camera: derive_view(view, modalities=modalities, keypoints=keypoints, segmenter=segmenter)
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

    def build(
        self, data: mujoco.MjData, *, instruction: str, sim_time_s: float, cameras: Sequence[str] | None = None
    ) -> Observation:
        """Build one observation. ``data`` is only read. Images show the last computed kinematics.

        ``cameras``: those that take a view; by default all of the card.
        """
        robot, taking = self._renderer.proprioception, self._card.cameras if cameras is None else cameras
        angles = self._noise.joint_position(robot.joint_position(data), sim_time_s=sim_time_s)
        # Whatever is computed from the encoders is computed from their noisy readings.
        known = self._renderer.at_encoders(angles) if self._noise.on_encoders else data
        speeds = self._noise.joint_velocity(robot.joint_velocity(data), sim_time_s=sim_time_s)
        moving = robot.velocity_tcp_in_base(known, speeds) if self._card.tool_velocity else None
        self.raw = RawReadings(
            joint_position=angles,
            joint_velocity=speeds,
            velocity_tcp_in_base=moving,
            pose_tcp_in_base=robot.pose_tcp_in_base(known),
            views={name: self.raw_view(data, name, angles=angles, sim_time_s=sim_time_s) for name in taking},
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
