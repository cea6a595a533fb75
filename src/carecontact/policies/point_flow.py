"""A policy that was learned from demonstrations: coloured points go in, and the next second of targets comes out.

examples/learn/point_flow.py trains its networks, in PyTorch; here they run in numpy, so that the policy needs no extra.
It has no key points, no masks and no detector of foam. What it sees are coloured points of the first picture, in which
the arm is out of the way, and of the last one. All places are relative to the last target of the tool. The network of
flow matching (Lipman et al. 2023, "Flow matching for generative modeling") starts from zero in place of noise: the same
look gives the same targets, near the middle of what the demonstrator would do. The targets of the first half second are
executed.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from carecontact.errors import ConfigError
from carecontact.interface.action import Action
from carecontact.interface.geometry import matrix_from_quat, matrix_from_vector, quat_from_matrix, vector_from_matrix
from carecontact.interface.observation import CameraView, Observation
from carecontact.interface.policy import PolicyCard

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]

HZ = 20
"""Targets in a second, as the oracle gives them."""
CHUNK, EXECUTED = 20, 10
"""Targets that the network gives, and those that are executed before the next look."""
POINTS = 512
"""Points of each of the two pictures."""
NUMBERS, VECTORS = 4, 5
"""Numbers and vectors of a state, see ``state``."""
OUTPUTS = 6 * CHUNK + 1
"""Places and turns of the targets, and the part of a chunk that is left of the motion."""
SMALL_M, SMALL_RAD = 0.005, 0.02
"""Differences about as large as these count in full, and larger ones by their logarithm (``arcsinh``): at the skin,
5 mm are 2 N, and on the way there they are nothing."""
SCALES = np.array([4, 4, 4, 1, 1, 1, 1], "f4")
"""Factors of a point's numbers, with which places near the hand are about as large as colours."""
BLOCKS, EULER = 3, 10
"""Residual blocks of the velocity's network, and steps from zero to the targets."""
LOOK = PolicyCard(
    name="learned",
    modalities=("rgb", "depth", "points"),
    cameras=("overhead",),
    camera_hz={"overhead": HZ / EXECUTED},
    control_hz=HZ,
    out_of_bounds="clip",
)
SHIPPED = Path(__file__).parents[1] / "assets/learned/point_flow.npz"


def cloud(view: CameraView) -> F32:
    """Return POINTS points (POINTS, 6) of a view, places in base [m] and colours: those that the arm might reach, and
    rather colourful ones than white linen."""
    assert view.points is not None
    assert view.point_colors is not None
    near = np.flatnonzero((np.abs(view.points[:, 2]) < 0.5) & (np.linalg.norm(view.points, axis=1) < 1.0))
    near = np.resize(near, max(len(near), POINTS)) if len(near) else np.zeros(POINTS, int)
    colours = view.point_colors[near] / 255.0
    wanted = 0.01 + (np.ptp(colours, axis=1) / np.maximum(colours.max(1), 0.2)) ** 4
    drawn = np.argpartition(np.random.default_rng(0).exponential(size=len(near)) / wanted, POINTS - 1)[:POINTS]
    return np.hstack([view.points[near[drawn]], colours[drawn]]).astype("f4")


def turn(start: F64, end: F64) -> F64:
    """Return the rotation vector (3,) along the axes of the base from one pose (7,) to another."""
    return vector_from_matrix(matrix_from_quat(end[3:]) @ matrix_from_quat(start[3:]).T)


def travelled(targets: npt.ArrayLike, before: F64) -> F64:
    """(N,) way [m] of the targets up to each: how far a motion has come, whatever time it took."""
    return np.cumsum(np.linalg.norm(np.diff(np.vstack([before, *np.asarray(targets)])[:, :3], axis=0), axis=1))


def state(tool: F64, target: F64, time_s: float, way_m: float, scrubs: bool) -> tuple[F32, F32]:
    """Return NUMBERS numbers and VECTORS vectors (VECTORS, 3) of a state: time and way of the targets since the
    beginning, and the task; place and rotation of the last target, and how far the tool lags behind it."""
    numbers = [time_s / 10, min(time_s, 3.0), way_m, float(scrubs)]
    rotation = matrix_from_quat(target[3:])
    vectors = [target[:3], 10 * (target[:3] - tool[:3]), turn(tool, target), rotation[:, 0], rotation[:, 1]]
    return np.array(numbers, "f4"), np.array(vectors, "f4")


def targets(start: F64, differences: F64, axes: F64) -> list[F64]:
    """Return poses (7,) of EXECUTED targets from the last one and a network's differences (OUTPUTS,), whose places are
    along the rows of ``axes`` (3, 3)."""
    places, turns = np.sinh(differences[:-1]).reshape(2, CHUNK, 3)[:, :EXECUTED]
    places, rotation = SMALL_M * places @ axes, matrix_from_quat(start[3:])
    return [
        np.append(start[:3] + place, quat_from_matrix(matrix_from_vector(SMALL_RAD * vector) @ rotation))
        for place, vector in zip(places, turns, strict=True)
    ]


class PointFlow:
    """A point-cloud policy that was trained on touches and scrubs of the forearm, T1 and T3. Its looks show points and
    colours alone."""

    def __init__(self, *, weights: str | None = None) -> None:
        """
        Args:
            weights: file of examples/learn/point_flow.py; by default the shipped one.

        Raises ConfigError for a file without such weights.
        """
        weights = str(SHIPPED) if weights is None else weights
        try:
            with np.load(weights) as kept:
                self._kept = {name: kept[name] for name in kept.files}
            salts = tuple(self._kept.pop("trained_on").tolist())
            self._kept = {name: value.astype("f4") for name, value in self._kept.items()}
            widest = self._kept["out.1.weight"].shape[0]
        except OSError as error:
            raise ConfigError(f"{weights}: {error.strerror}") from error
        except (ValueError, KeyError, EOFError, BadZipFile) as error:
            raise ConfigError(f"{weights}: no weights of examples/learn/point_flow.py") from error
        if widest != OUTPUTS:
            raise ConfigError(f"{weights}: the network has {widest} outputs; expected {OUTPUTS}")
        self.card = replace(LOOK, trained_on=salts)

    def reset(self, instruction: str) -> None:
        self._known = "forearm" in instruction and "push" not in instruction
        self._scrubs, self._steps, self._way_m = "scrub" in instruction, 0, 0.0
        self._target: F64 | None = None

    def act(self, observation: Observation) -> list[Action]:
        """Return the next half second of targets. An instruction that the policy was not trained on ends the trial."""
        if not self._known:
            return [Action(done=True)]
        tool, last = observation.pose_tcp_in_base, cloud(observation.cameras["overhead"])
        if self._target is None:
            self._target, self._first = tool, last
        start = self._target
        numbers, vectors = state(tool, start, self._steps / HZ, self._way_m, self._scrubs)
        out = self.differences(self._first, last, numbers, vectors)
        wanted, left = targets(start, out.astype(float), np.eye(3)), float(out[-1])
        ends = left * CHUNK <= EXECUTED and self._steps > 5 * HZ
        self._target, self._steps = wanted[-1], self._steps + EXECUTED
        self._way_m += float(travelled(wanted, start)[-1])
        return [Action(pose_tcp_in_base=pose, done=ends and pose is wanted[-1]) for pose in wanted]

    def differences(self, first: F32, last: F32, numbers: F32, vectors: F32) -> F32:
        """Return the network's answer (OUTPUTS,): ``arcsinh`` of places and turns from the last target, in units of
        SMALL_M and SMALL_RAD, and the chunks that are left.

        Args:
            first: cloud (POINTS, 6) of the first look.
            last: cloud of the last one.
            numbers: those of ``state``.
            vectors: those of ``state``.
        """
        linear, silu = self._linear, _silu
        clouds = [np.insert(points, 6, flag, 1) for flag, points in enumerate((first, last))]
        points = np.concatenate(clouds)
        points[:, :3] -= vectors[0]
        points *= SCALES
        hidden = silu(linear("encoder.points.2", silu(linear("encoder.points.0", points))))
        weights = linear("encoder.weight", hidden)
        weights = np.exp(weights - weights.max(0))
        places = (weights / weights.sum(0)).T @ points[:, :3]
        lag = np.arcsinh(vectors[1] / (10 * SMALL_M))
        seen = linear("encoder.feature", hidden).max(0), places.ravel(), numbers, vectors.ravel(), lag
        seen = linear("encoder.joined.2", silu(linear("encoder.joined.0", np.concatenate(seen))))
        at = np.zeros(OUTPUTS, "f4")
        for step in range(EULER):
            angles = np.pi * 2.0 ** np.arange(8) * step / EULER
            x = linear("into", np.concatenate([at, np.sin(angles), np.cos(angles), seen]).astype("f4"))
            for block in range(BLOCKS):
                part = partial("blocks.{}.{}".format, block)
                x = x + linear(part(3), silu(linear(part(1), self._normed(part(0), x))))
            at = at + linear("out.1", self._normed("out.0", x)) / EULER
        return at * self._kept["scale"]

    def _linear(self, name: str, x: F32) -> F32:
        return x @ self._kept[f"{name}.weight"].T + self._kept[f"{name}.bias"]

    def _normed(self, name: str, x: F32) -> F32:
        x = (x - x.mean()) / np.sqrt(x.var() + 1e-5)  # the constant of torch's LayerNorm
        return x * self._kept[f"{name}.weight"] + self._kept[f"{name}.bias"]


def _silu(x: F32) -> F32:
    return np.asarray(x / (1 + np.exp(-x)), np.float32)
