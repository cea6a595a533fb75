"""Servers with the conventions of LIBERO and of Bridge, written from the public code, with nothing of carecontact.

Each drives the tool from the state that it is sent to a goal of its own: like a checkpoint of its data set it knows
no other frame, unit or sign than those of that data set.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from websockets.sync.server import ServerConnection

from tests.serving.fakes import Openpi, VlaEval

Spoil = Callable[[np.ndarray], np.ndarray]


def robosuite_quat2mat(axis_angle: np.ndarray) -> Rotation:
    """The orientation of an axis-angle vector that may be longer than half a turn (robosuite's quat2axisangle)."""
    angle = float(np.linalg.norm(axis_angle))
    if angle == 0:
        return Rotation.identity()
    axis = axis_angle / angle
    return Rotation.from_quat([*(np.sin(angle / 2) * axis), np.cos(angle / 2)])


@dataclass
class Driving:
    """What the servers below have in common."""

    goal: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """(3,) place in the frame of the server's data set [m]."""
    turn: Rotation = field(default_factory=Rotation.identity)
    """Orientation there."""
    gain: float = 0.5
    spoil: Spoil | None = None
    """Rows (N, 7) -> the rows of a server with a mistake."""

    def row(self, state: np.ndarray) -> np.ndarray:
        raise NotImplementedError

    def rows(self, state: np.ndarray, steps: int) -> np.ndarray:
        rows = np.tile(self.row(np.asarray(state, np.float64)), (steps, 1))
        return rows if self.spoil is None else self.spoil(rows)


@dataclass
class Libero(Driving):
    """robosuite's OSC_POSE, as LIBERO drives it: input -1 to 1 is scaled to 5 cm and 0.5 rad about the world's axes.
    A positive gripper command closes. The state is place, axis-angle and both fingers, in the world."""

    def row(self, state: np.ndarray) -> np.ndarray:
        assert state.shape == (8,)
        shift = self.gain * (self.goal - state[:3]) / 0.05
        turn = (self.turn * robosuite_quat2mat(state[3:6]).inv()).as_rotvec() / 0.5
        shift /= max(1.0, np.abs(shift).max())
        turn /= max(1.0, np.abs(turn).max())
        fingers = state[6] - state[7]
        return np.array([*shift, *(self.gain * turn), 1.0 if fingers < 0.04 else -1.0])


@dataclass
class Bridge(Driving):
    """Bridge's WidowX: metres and Euler angles about the base's axes, added to the last target; 1 opens the gripper.
    The state is place, Euler angles from a gripper that points down, a padding, and the gripper."""

    def row(self, state: np.ndarray) -> np.ndarray:
        assert state.shape == (8,)
        assert state[6] == 0.0
        shift = np.clip(0.3 * self.gain * (self.goal - state[:3]), -0.04, 0.04)
        now = Rotation.from_euler("xyz", state[3:6])
        turn = np.clip(0.3 * self.gain * (self.turn * now.inv()).as_euler("xyz"), -0.2, 0.2)
        return np.array([*shift, *turn, float(state[7] > 0.5)])


@dataclass
class OnOpenpi(Openpi):
    """The keys of openpi's libero_policy.py; Bridge has no wrist camera."""

    driver: Driving = field(default_factory=Libero)

    def chunk(self, observation: dict[str, Any]) -> np.ndarray:
        images = {"observation/image"} | ({"observation/wrist_image"} if isinstance(self.driver, Libero) else set())
        assert set(observation) == {*images, "observation/state", "prompt"}
        assert all(observation[key].shape == (224, 224, 3) for key in images)
        self.answered.append(self.driver.rows(observation["observation/state"], self.steps).astype(np.float32))
        return self.answered[-1]


LIBERO_SPEC = {
    "position": {"name": "position", "dims": 3, "format": "delta_xyz", "range": [-1, 1]},
    "rotation": {"name": "rotation", "dims": 3, "format": "axis_angle", "range": [-3.15, 3.15]},
    "gripper": {"name": "gripper", "dims": 1, "format": "binary_close_positive", "range": [-1, 1]},
}
"""POSITION_DELTA, ROTATION_AA and GRIPPER_CLOSE_POS of vla-eval 0.8's specs.py, as its openvla.py and oft.py say."""


@dataclass
class OnVlaEval(VlaEval):
    """A model server of vla-eval: LIBERO's state as on openpi, and SimplerEnv's with a quaternion."""

    driver: Driving = field(default_factory=Libero)
    payload: dict[str, Any] = field(
        default_factory=lambda: {
            "observation_params": {
                "send_wrist_image": True, "send_state": True, "env_seed": 0, "quat_no_antipodal": True,
            },
            "action_spec": LIBERO_SPEC,
        }
    )  # fmt: skip

    def tell(self, connection: ServerConnection, kind: str, payload: dict[str, Any], seq: int) -> None:
        if kind == "action":
            observed = self.heard[-1]["payload"]
            state = observed["states"]
            if isinstance(self.driver, Bridge):
                assert {name: image.shape for name, image in observed["images"].items()} == {"primary": (480, 640, 3)}
                down = np.array([[0, 0, 1.0], [0, 1.0, 0], [-1.0, 0, 0]])
                angles = (Rotation.from_quat(state[[4, 5, 6, 3]]) * Rotation.from_matrix(down).inv()).as_euler("xyz")
                state = np.array([*state[:3], *angles, 0.0, state[7]])
            else:
                shapes = {name: image.shape for name, image in observed["images"].items()}
                assert shapes == {"agentview": (256, 256, 3), "wrist": (256, 256, 3)}
            row = self.driver.rows(state, 1)[0].astype(np.float32)
            self.answered[-1] = row[None]
            payload = {"actions": row}
        super().tell(connection, kind, payload, seq)
