"""A person of cylinders on a flat bed, seen by an ideal overhead camera; everything in the robot's base frame."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from carecontact.interface.observation import MASK_NAMES, CameraView, Observation

WIDTH, HEIGHT = 480, 360
INTRINSICS = np.array([[330.0, 0, (WIDTH - 1) / 2], [0, 330.0, (HEIGHT - 1) / 2], [0, 0, 1]])
CAMERA = np.array([[0, -1, 0, 0.35], [-1, 0, 0, -0.35], [0, 0, -1, 2.0], [0, 0, 0, 1]], float)
LIMB_RADIUS, TRUNK_RADIUS = 0.035, 0.12
UPPER_ARM_LENGTH, FOREARM_LENGTH = 0.28, 0.26


@dataclass(frozen=True, kw_only=True)
class Person:
    """Joint centres (3,) in base; the trunk lies along x, the right arm is abducted by ``abduction_deg``."""

    abduction_deg: float = 53.0
    wrist_rise_m: float = 0.0
    shoulder: np.ndarray = field(default_factory=lambda: np.array([0.62, -0.40, LIMB_RADIUS]))

    @property
    def arm_direction(self) -> np.ndarray:
        angle = np.radians(self.abduction_deg)
        return np.array([-np.cos(angle), np.sin(angle), 0.0])

    @property
    def elbow(self) -> np.ndarray:
        return self.shoulder + UPPER_ARM_LENGTH * self.arm_direction

    @property
    def wrist(self) -> np.ndarray:
        return self.elbow + FOREARM_LENGTH * self.arm_direction + [0, 0, self.wrist_rise_m]

    @property
    def hips(self) -> np.ndarray:
        return self.shoulder + [-0.47, -0.20, 0.0]

    @property
    def neck(self) -> np.ndarray:
        return self.shoulder + [0.0, -0.20, 0.0]

    def cylinders(self) -> list[tuple[np.ndarray, np.ndarray, float]]:
        low = np.array([0, 0, 0.10 - LIMB_RADIUS])
        return [
            (self.shoulder, self.elbow, LIMB_RADIUS),
            (self.elbow, self.wrist, LIMB_RADIUS),
            (self.hips - [0.2, 0, 0] + low, self.neck + low, TRUNK_RADIUS),
        ]

    def clearance(self, points: np.ndarray) -> np.ndarray:
        """(N,) distance of points (N, 3) from the person's surface [m]."""
        found = []
        for a, b, radius in self.cylinders():
            share = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
            found.append(np.linalg.norm(points - a - share[:, None] * (b - a), axis=1) - radius)
        return np.min(found, axis=0)

    def landmarks(self) -> np.ndarray:
        """(33, 3) by projection of the joint centres, all visible."""
        out = np.tile([0.0, 0.0, 0.9], (33, 1))
        side = np.array([0, 0.1, 0])
        for index, place in {
            11: self.neck - 2 * side,
            12: self.shoulder,
            14: self.elbow,
            16: self.wrist,
            23: self.hips - side,
            24: self.hips + side,
        }.items():
            in_camera = CAMERA[:3, :3].T @ (place - CAMERA[:3, 3])
            out[index, :2] = (INTRINSICS @ in_camera)[:2] / in_camera[2]
        return out.astype(np.float32)


def observe(person: Person | None) -> Observation:
    """What an ideal camera and estimator would make of the person; None: an empty bed."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    rays = np.stack([(u - INTRINSICS[0, 2]) / 330.0, (v - INTRINSICS[1, 2]) / 330.0, np.ones_like(u)], -1)
    rays = rays @ CAMERA[:3, :3].T
    depth, human = np.full((HEIGHT, WIDTH), 2.0), np.zeros((HEIGHT, WIDTH), bool)
    for a, b, radius in person.cylinders() if person else []:
        hit = _cylinder_depth(rays, a, b, radius)
        human |= hit < depth
        depth = np.minimum(depth, hit)
    points = CAMERA[:3, 3] + depth[..., None] * rays
    masks = {name: np.zeros((HEIGHT, WIDTH), bool) for name in MASK_NAMES}
    masks["human"], masks["bed"] = human & (points[..., 2] > 0.008), ~(human & (points[..., 2] > 0.008))
    landmarks = person.landmarks() if person else np.full((33, 3), np.nan, np.float32)
    surface = np.full((33, 3), np.nan, np.float32)
    if person:
        inside = (landmarks[:, 0] > 0) & (landmarks[:, 1] > 0)
        columns, rows = np.round(landmarks[inside, :2]).astype(int).T
        surface[inside] = points[rows, columns]
    view = CameraView(
        intrinsics=INTRINSICS,
        pose_camera_in_base=CAMERA,
        rgb=np.zeros((HEIGHT, WIDTH, 3), np.uint8),
        depth=depth.astype(np.float32),
        points=points.reshape(-1, 3).astype(np.float32),
        point_colors=np.zeros((HEIGHT * WIDTH, 3), np.uint8),
        masks=masks,
        landmarks=landmarks,
        landmarks_in_base=surface,
    )
    return Observation(
        instruction="",
        sim_time_s=0.0,
        joint_position=np.zeros(7),
        joint_velocity=np.zeros(7),
        gripper_position=np.zeros(1),
        pose_tcp_in_base=np.array([0.30, 0.0, 0.50, 0.0, 1.0, 0.0, 0.0]),
        cameras={"overhead": view},
    )


def _cylinder_depth(rays: np.ndarray, a: np.ndarray, b: np.ndarray, radius: float) -> np.ndarray:
    axis = (b - a) / np.linalg.norm(b - a)
    d = rays - (rays @ axis)[..., None] * axis
    o = CAMERA[:3, 3] - a
    o = o - (o @ axis) * axis
    qa, qb, qc = (d * d).sum(-1), 2 * d @ o, o @ o - radius**2
    root = qb**2 - 4 * qa * qc
    depth = np.where(root > 0, (-qb - np.sqrt(np.maximum(root, 0))) / (2 * qa), np.inf)
    along = (CAMERA[:3, 3] + np.where(np.isfinite(depth), depth, 0)[..., None] * rays - a) @ axis
    return np.where((along >= 0) & (along <= np.linalg.norm(b - a)), depth, np.inf)


def change_view(observation: Observation, **changes: object) -> Observation:
    view = replace(observation.cameras["overhead"], **changes)  # pyright: ignore[reportArgumentType]
    return replace(observation, cameras={"overhead": view})
