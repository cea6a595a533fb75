"""What checkpoints of LIBERO and of Bridge are shown, and what their answers mean: the profiles whose policies answer
differences of the tool's pose, on the wires of openpi and of vla-eval."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from carecontact.interface.deltas import DELTA_SPACE, DELTAS, DeltaConvention
from carecontact.interface.geometry import (
    euler_xyz_from_matrix,
    matrix_from_quat,
    quat_from_matrix,
    vector_from_matrix,
)
from carecontact.interface.observation import U8, Observation
from carecontact.interface.policy import PolicyCard

F64 = npt.NDArray[np.float64]

IMAGE, WRIST_IMAGE, STATE = "observation/image", "observation/wrist_image", "observation/state"
"""Keys of a request to a server of openpi, as its src/openpi/policies/libero_policy.py (15a9616a) has them; openpi's
pages offer this file as the template for other data sets."""
STATE_WIDTH = 8
ORIENTATIONS: Mapping[str, Callable[[U8], U8]] = {
    "upright": lambda image: image,
    "mirrored": lambda image: image[:, ::-1],
    "upside-down": lambda image: image[::-1],
    "turned": lambda image: image[::-1, ::-1],
}
"""How a picture (H, W, 3) is turned before it is sent: as the camera sees it, left and right exchanged, top and bottom
exchanged, or both, which is a turn by 180 degrees."""
LIBERO_BASE_M = np.array([-0.66, 0.0, 0.912])
"""Place of the robot's base in LIBERO's world, in the scenes with a table or a kitchen table (1 m long):
libero/envs/robots/mounted_panda.py and libero/envs/problems of Lifelong-Robot-Learning/LIBERO 4f0dd188, on robosuite's
mount. Its axes are those of the world. The scenes on a floor have another one."""
GRIP_SITE_M = 0.0205
"""How far robosuite's grip site, whose place LIBERO's state gives, lies behind our tool centre point along the tool. In
LIBERO's first posture its place is (-0.20846, 0, 1.17328) m in the world; the test computes it with our arm."""
FINGER_M = 0.04
"""Way of each finger from closed to open, as robosuite's gripper has it (022f723f); the second finger's is negative."""
TOOL_DOWN = np.diag([1.0, -1.0, -1.0])
"""Orientation of our tool when it points straight down and its x axis lies along that of the base."""
DEFAULT_ROTATION = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""The same orientation of Bridge's robots, whose x axis points out of the tool (rail-berkeley/bridge_data_robot
07d656fa; also openvla/openvla c8f03f48, experiments/robot/bridge/widowx_env.py). Bridge's angles count from it."""


def libero_state(observation: Observation, *, shortest: bool = False) -> F64:
    """Return LIBERO's state (8,): place of the grip site in its world [m], rotation vector [rad], both fingers [m]
    (openpi 15a9616a, examples/libero/main.py).

    robosuite's rotation vectors are not cut to half a turn: for a tool that points down, the first component stays
    positive. ``shortest`` cuts them, as vla-eval does unless a server asks for ``quat_no_antipodal``.
    """
    turn = matrix_from_quat(observation.pose_tcp_in_base[3:])
    vector = vector_from_matrix(turn)
    if vector[0] < 0 and not shortest:
        vector *= 1 - 2 * np.pi / np.linalg.norm(vector)
    place = observation.pose_tcp_in_base[:3] - GRIP_SITE_M * turn[:, 2] + LIBERO_BASE_M
    finger = FINGER_M * float(observation.gripper_position[0])
    return np.array([*place, *vector, finger, -finger], "<f8")


def bridge_state(observation: Observation) -> F64:
    """Return Bridge's state (8,): position in base [m], angles about x, y, z from a tool that points down [rad], a
    zero, and the gripper, 1 open (openvla c8f03f48, experiments/robot/bridge/widowx_env.py, ``convert_obs``)."""
    turn = matrix_from_quat(observation.pose_tcp_in_base[3:])
    angles = euler_xyz_from_matrix(turn @ TOOL_DOWN.T)
    return np.array([*observation.pose_tcp_in_base[:3], *angles, 0.0, float(observation.gripper_position[0])], "<f8")


def simpler_state(observation: Observation) -> F64:
    """Return the state (8,) that vla-eval's benchmark SimplerEnv sends (e1ee9adf, benchmarks/simpler/benchmark.py):
    position in base [m], quaternion w x y z of a tool whose x axis points out, and the gripper, 1 open."""
    turn = matrix_from_quat(observation.pose_tcp_in_base[3:]) @ TOOL_DOWN.T @ DEFAULT_ROTATION
    quat = quat_from_matrix(turn)
    return np.array([*observation.pose_tcp_in_base[:3], *quat, float(observation.gripper_position[0])], "<f8")


@dataclass(frozen=True, kw_only=True)
class Setup:
    """How one benchmark shows the robot and its scene to a policy, and how it executes the answers."""

    deltas: str
    """Name in DELTAS."""
    control_hz: float
    horizon: int
    """Number of actions of a chunk that are executed before the next query, by default."""
    orientation: str
    """Name in ORIENTATIONS."""
    aspect: tuple[int, int]
    """Width to height of a picture, to which ours are cut about their centre."""
    lanczos: bool
    """Whether pictures are resized with a Lanczos filter, otherwise with a bilinear one."""
    state: Callable[[Observation], F64]
    """The state for openpi."""
    vla_images: Mapping[str, str]
    """Our camera -> name of its picture on vla-eval's wire, in vla-eval's order."""
    vla_hw: tuple[int, int]
    """Height and width of a picture there [px]."""
    vla_state: Callable[[Observation], F64]
    rotations: tuple[str, ...]
    """Formats of a DimSpec of vla-eval for the rotation that do not contradict this setup."""
    grippers: tuple[str, ...]
    """The same for the gripper."""

    @property
    def convention(self) -> DeltaConvention:
        return DELTAS[self.deltas]

    @property
    def wrist(self) -> bool:
        return "wrist" in self.vla_images


SETUPS: Mapping[str, Setup] = {
    # openpi 15a9616a, examples/libero/main.py: 224 px, five steps, both pictures turned by 180 degrees. robosuite hands
    # them out with the lowest row first (IMAGE_CONVENTION "opengl" in robosuite/macros.py, 1f7ae68c), so that the turn
    # leaves them upright and mirrored (ARISE-Initiative/robosuite issue 56, openvla/openvla issue 295). 20 Hz:
    # LIBERO 4f0dd188, libero/libero/envs/env_wrapper.py. vla-eval e1ee9adf, benchmarks/libero: 256 px, same turn.
    "libero": Setup(
        deltas="osc",
        control_hz=20.0,
        horizon=5,
        orientation="mirrored",
        aspect=(1, 1),
        lanczos=False,
        state=libero_state,
        vla_images={"exterior": "agentview", "wrist": "wrist"},
        vla_hw=(256, 256),
        vla_state=libero_state,
        rotations=("axis_angle",),
        grippers=("binary_close_positive", "raw"),
    ),
    # openvla c8f03f48, experiments/robot/bridge: one upright picture of 640 by 480, stretched to a square with a
    # Lanczos filter, 5 Hz. Four actions of a chunk: allenzren/open-pi-zero 5e04ecae, config/train/bridge.yaml.
    # vla-eval's benchmarks/simpler/benchmark.py says that a positive number closes the gripper, and opens it above 0.5.
    "bridge": Setup(
        deltas="bridge",
        control_hz=5.0,
        horizon=4,
        orientation="upright",
        aspect=(4, 3),
        lanczos=True,
        state=bridge_state,
        vla_images={"exterior": "primary"},
        vla_hw=(480, 640),
        vla_state=simpler_state,
        rotations=("euler_xyz", "axis_angle"),
        grippers=("continuous_01", "binary_close_positive", "raw"),
    ),
}
"""Name of a profile -> its setup."""


def delta_card(name: str, setup: Setup, cameras: tuple[str, ...], arguments: Mapping[str, str]) -> PolicyCard:
    """Make the card of a server that sends none and answers deltas."""
    return PolicyCard(
        name=name,
        action_space=DELTA_SPACE,
        delta=setup.deltas,
        modalities=("rgb",),
        cameras=cameras,
        control_hz=setup.control_hz,
        # Bridge's robots move a target onto the border of their workspace, and robosuite's controllers have no border.
        out_of_bounds="clip",
        arguments=arguments,
    )
