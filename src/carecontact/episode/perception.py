"""What was right and wrong in what a policy was shown, and the picture of the moment of peak force."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.errors import ConfigError, ContractError
from carecontact.human.skeleton import body_name
from carecontact.interface.body_view import region_from_observation
from carecontact.interface.observation import CameraView, Observation
from carecontact.interface.policy import CAMERAS
from carecontact.interface.regions import REGIONS, LimbSight, TrunkSight
from carecontact.recording.notes import JOINTS, PERCEPTION
from carecontact.recording.schema import OPTIONAL_ARRAYS
from carecontact.sim.close_up import render_close_up, skin_shift
from carecontact.sim.rendering import SceneRenderer, TrueView
from carecontact.sim.simulation import Simulation
from carecontact.sim.state import Proprioception, skin_in_world, top_of_skin

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

Faces = npt.NDArray[np.integer]

SEGMENT_AT = {"shoulder": "upper_arm", "elbow": "forearm", "wrist": "hand"}
SEGMENT_AT |= {"hip": "thigh", "knee": "shank", "ankle": "foot"}
"""Joint -> the segment whose body has its origin there."""
OWN_LIMB_M = 0.16
"""A surface up to this distance [m] in front of a joint's centre belongs to the joint's own limb: the hip joint of the
heaviest bodies lies 0.14 m deep."""


class PerceptionLog:
    """Measures perception against the simulator's truth, hidden from the policy: rows for ``recording.notes``."""

    def __init__(self, model: mujoco.MjModel, renderer: SceneRenderer) -> None:
        self._model, self._renderer, self._robot = model, renderer, Proprioception(model, renderer.protocol.scene.robot)
        self._rows: list[dict[str, Any]] = []
        self._seen = 0

    def add(self, data: mujoco.MjData, observation: Observation) -> None:
        """Add an observation. ``data``: the state that it shows; it is not changed."""
        index, self._seen = self._seen, self._seen + 1
        looked = {n: v for n, v in observation.cameras.items() if v.landmarks is not None or v.masks is not None}
        if not looked:
            return
        joints = self.joints_in_base(data)
        skin = self.skin_in_base(data) if any(_finds_targets(view) for view in looked.values()) else None
        for name, view in looked.items():
            truth = self._renderer.truth(data, name)
            # With noise on the encoders, the camera pose that the policy knows is not the true one.
            pose = self._renderer.pose_camera_in_base(data, name)
            visible, error = landmark_error_px(view, joints, pose, truth)
            row: dict[str, Any] = {"observation_index": index, "camera_index": CAMERAS.index(name)}
            row |= {"joint_visible": visible, "landmark_error_px": error}
            row["human_iou"] = np.nan if view.masks is None else iou(view.masks["human"], truth.human)
            row["target_error_m"] = self._target_errors(joints, skin, observation, name)
            self._rows.append(row)

    def arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Return the arrays by their path; none if no row was added."""
        if not self._rows:
            return {}
        columns = {path: [row[path.partition("/")[2]] for row in self._rows] for path in PERCEPTION}
        return {path: np.array(column, OPTIONAL_ARRAYS[path][0]) for path, column in columns.items()}

    def joints_in_base(self, data: mujoco.MjData) -> dict[str, F64]:
        """Return the true centre (3,) [m] of each of JOINTS in the robot's base."""
        segments = {name: f"{side}_{SEGMENT_AT[joint]}" for name in JOINTS for side, joint in [name.split()]}
        centres = {name: data.body(body_name(segment)).xpos for name, segment in segments.items()}
        return {name: self._robot.in_base(data, centre, np.eye(3))[:3, 3] for name, centre in centres.items()}

    def _target_errors(self, joints: dict[str, F64], skin: F64 | None, observation: Observation, camera: str) -> F32:
        regions = self._renderer.protocol.regions
        errors = np.full((len(regions), 3), np.nan, np.float32)
        if skin is None or not _finds_targets(observation.cameras[camera]):
            return errors
        for row, region in enumerate(regions):
            try:
                found = region_from_observation(observation, region, side=REGIONS[region].side, camera=camera)
            except ContractError:
                continue
            least = middle_share(self._model, region)
            centre, along = true_target(region, joints, skin, self._model.skin_face, least_share=least)
            across = np.array([-along[1], along[0], 0.0])
            errors[row] = (found.centre_m - centre) @ np.stack([along, across, [0, 0, 1]], 1)
        return errors

    def skin_in_base(self, data: mujoco.MjData) -> F64:
        """Return the true vertices (V, 3) [m] of the skin in the robot's base; their faces are the model's."""
        placed = skin_in_world(self._model, data)
        to_base = self._robot.in_base(data, np.zeros(3), np.eye(3))
        return placed @ to_base[:3, :3].T + to_base[:3, 3]


def _finds_targets(view: CameraView) -> bool:
    """Whether a view has what the state machine needs to look for regions."""
    return all(image is not None for image in (view.depth, view.points, view.masks, view.landmarks))


def landmark_error_px(
    view: CameraView, joints_in_base: dict[str, F64], pose_camera_in_base: F64, truth: TrueView
) -> tuple[Bool, F32]:
    """Return (12,) whether the camera truly sees each joint's limb, and errors (12,) of landmarks [px]; NaN unseen."""
    height, width = truth.human.shape
    visible, error = np.zeros(len(JOINTS), bool), np.full(len(JOINTS), np.nan, np.float32)
    for row, (name, index) in enumerate(JOINTS.items()):
        in_camera = pose_camera_in_base[:3, :3].T @ (joints_in_base[name] - pose_camera_in_base[:3, 3])
        if in_camera[2] <= 0:
            continue
        u, v = (view.intrinsics @ in_camera)[:2] / in_camera[2]
        if not (-0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5):
            continue
        at = round(float(v)), round(float(u))
        visible[row] = truth.human[at] and in_camera[2] - truth.depth[at] < OWN_LIMB_M
        if visible[row] and view.landmarks is not None:
            error[row] = np.hypot(*(view.landmarks[index, :2] - (u, v)))
    return visible, error


def iou(found: Bool, true: Bool) -> float:
    """Return the intersection over union of two masks; 1 if both are empty."""
    union = int((found | true).sum())
    return int((found & true).sum()) / union if union else 1.0


def middle_share(model: mujoco.MjModel, region: str) -> float:
    """Return the share of a limb's line at which the middle of its region lies; 0 for a region on no limb."""
    row = REGIONS[region]
    if not isinstance(row.sight, LimbSight):
        return 0.0
    along = model.body(body_name(f"{row.side}_{SEGMENT_AT[row.sight.joints[1]]}")).pos
    return float(model.site(f"region_{region}").pos @ along / (along @ along))


def true_target(
    region: str, joints: dict[str, F64], skin: F64, faces: Faces, *, least_share: float = 0.0
) -> tuple[F64, F64]:
    """Return the place (3,) [m] of the skin above the region's middle and the horizontal direction (3,) of its limb.

    The middle is defined by joint centres, here the true ones, as the shipped policies define it: perception is
    measured, and not anatomy. On a body whose chest crowds the arm, it is no nearer to the trunk than ``least_share``
    of the limb (``middle_share``). Raises ConfigError for a region whose row does not say between which joints it lies.
    """
    row = REGIONS[region]
    match row.sight:
        case TrunkSight(joints=(lower, upper), middle=share):
            start, end = ((joints[f"left {j}"] + joints[f"right {j}"]) / 2 for j in (lower, upper))
        case LimbSight(joints=(first, second), free_from=free_from):
            start, end = joints[f"{row.side} {first}"], joints[f"{row.side} {second}"]
            share = max((1 + free_from) / 2, least_share)
        case None:
            raise ConfigError(f"region {region} has no joints between which it lies")
    middle = start + share * (end - start)
    along = np.array([*(end - start)[:2], 0.0])
    height = top_of_skin(skin, faces.reshape(-1, 3), middle[:2])
    return np.array([*middle[:2], height]), along / np.linalg.norm(along)


MARGIN_M = (0.08, 0.06, 0.06)
"""How far [m] beyond a region the skin is kept: along it, across it and outward."""


class Peak:
    """The state of a trial with the largest force on the target; until the target is touched, on any segment."""

    def __init__(self, simulation: Simulation, *, target: int) -> None:
        """``target``: column of the target's segment in the forces."""
        self._simulation, self._target = simulation, target
        self._force_n, self._on_target, self._time_s = 0.0, False, 0.0
        self._state: F64 | None = None

    def look(self, force_n: F64) -> None:
        """Consider the period that has just ended. ``force_n``: (n, S) magnitudes [N] of its forces."""
        best = force_n.max(0)
        on_target = bool(best[self._target] > 0)
        segment = self._target if on_target else int(best.argmax())
        better = best[segment] > self._force_n if on_target == self._on_target else on_target
        if best[segment] > 0 and better:
            self._force_n, self._on_target = float(best[segment]), on_target
            self._time_s, self._state = self._simulation.time_s, self._simulation.integration_state()

    def pictures(self, renderer: SceneRenderer, *, region: str) -> Mapping[str, npt.NDArray[Any]]:
        """Return ``report/*`` of the peak, or of the end of a trial without contact."""
        model = self._simulation.model
        data = mujoco.MjData(model)
        state = self._simulation.integration_state() if self._state is None else self._state
        mujoco.mj_setState(model, data, state, int(mujoco.mjtState.mjSTATE_INTEGRATION))
        mujoco.mj_forward(model, data)
        shift = skin_shift(self._simulation.scene, data)
        close = render_close_up(renderer, self._simulation.scene, data, region=region, shift=shift)
        return {
            "report/snapshot_rgb": renderer.rgb(data, "exterior"),
            "report/peak_rgb": close.image,
            "report/peak_pose_camera_in_world": close.pose_camera_in_world.astype("<f8"),
            "report/peak_focal_px": np.array([close.focal_px], "<f8"),
            "report/peak_time_s": np.array([self._time_s], "<f8"),
            **self._skin(data, region, shift),
        }

    def _skin(self, data: mujoco.MjData, region: str, shift: F64) -> Mapping[str, npt.NDArray[Any]]:
        """Return the skin around the region, indented by ``shift`` (V, 3) [m] as it was at that moment."""
        scene, model = self._simulation.scene, self._simulation.model
        frame = scene.frames[region]
        bind = np.asarray(model.skin_vert, np.float64).reshape(-1, 3)
        length, half_width, outward = frame.size_m.tolist()
        reach = np.array([length / 2, half_width, outward]) + MARGIN_M
        near = np.all(np.abs((bind - frame.origin) @ frame.axes) < reach, axis=1)
        faces = np.asarray(model.skin_face).reshape(-1, 3)
        faces = faces[np.all(near[faces], axis=1)]
        kept = np.unique(faces)
        placed = (skin_in_world(model, data) + shift)[kept]
        return {
            "report/skin_in_world": placed.astype("<f4"),
            "report/skin_faces": np.searchsorted(kept, faces).astype("<i4"),
        }
