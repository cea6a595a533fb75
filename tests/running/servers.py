"""Servers that look at what they are shown, good ones and spoilt ones, on the wires of the fakes of dialects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from websockets.sync.server import ServerConnection

from tests.serving.fakes import Openpi, RoboArena, VlaEval

JOINTS, GRIPPER = "observation/joint_position", "observation/gripper_position"
EXTERIOR, WRIST = "observation/exterior_image_1_left", "observation/wrist_image_left"


def feature(value: Any) -> float:
    """One number of an input, different for nearly all that an input may be."""
    if isinstance(value, str):
        return sum(map(ord, value)) % 97 / 10
    array = np.asarray(value, np.float64)
    return float((array.ravel() * np.linspace(0.5, 1.5, array.size)).mean()) / (25.0 if array.ndim == 3 else 1.0)


@dataclass
class Looks:
    """What the servers below have in common: every input that they read moves every column."""

    blind: tuple[str, ...] = ()
    """Keys that it does not read."""
    noise: float = 0.0
    """Standard deviation of what chance adds to each column, one draw for all steps of an answer."""
    spoil: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    """(chunk, joint angles) -> the chunk of a server with a mistake."""
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(3))

    def velocities(self, shown: dict[str, Any], joints: np.ndarray, *, steps: int) -> np.ndarray:
        """(steps, 8) of normalised velocities within 0.4 of zero, and a gripper that stays closed."""
        phase = sum(feature(value) for key, value in sorted(shown.items()) if key not in self.blind)
        wave = np.sin(phase + np.arange(8)) + 0.1 * np.sin(np.arange(steps * 8)).reshape(steps, 8)
        chunk = 0.2 * wave + self.rng.normal(0, 1, 8) * self.noise
        chunk[:, 7] = 1.0
        return (chunk if self.spoil is None else self.spoil(chunk, joints)).astype(np.float32)


@dataclass
class Seeing(Looks, Openpi):
    targets: bool = False
    """Whether it answers joint angles, as a checkpoint of the profile pi05-droid-jointpos."""

    def chunk(self, observation: dict[str, Any]) -> np.ndarray:
        joints = observation[JOINTS]
        spoil, self.spoil = self.spoil, None
        chunk = self.velocities(observation, joints, steps=self.steps)
        self.spoil = spoil
        if self.targets:
            chunk[:, :7] = joints + 0.2 * chunk[:, :7]
        return (chunk if spoil is None else spoil(chunk, joints)).astype(np.float32)


@dataclass
class SeeingArena(Looks, RoboArena):
    def chunk(self, observation: dict[str, Any]) -> np.ndarray:
        shown = {key: value for key, value in observation.items() if key != "session_id"}
        return self.velocities(shown, observation[JOINTS], steps=self.steps)


@dataclass
class SeeingVla(Looks, VlaEval):
    """One action an observation; what it answers is all of a chunk of five that it made at the episode's start."""

    buffered: bool = False

    def tell(self, connection: ServerConnection, kind: str, payload: dict[str, Any], seq: int) -> None:
        if kind == "action":
            observed = self.heard[-1]["payload"]
            began = max(i for i, one in enumerate(self.heard) if one["type"] == "episode_start")
            if self.buffered:
                observed = self.heard[began + 1]["payload"]
            shown = {**observed["images"], "prompt": observed["task_description"], "states": observed["states"]}
            row = self.velocities(shown, observed["states"][:7], steps=1)[0]
            row[:7] = observed["states"][:7] + 0.2 * row[:7]
            payload = {"actions": row}
        super().tell(connection, kind, payload, seq)
