"""How the oracle holds its hand: turned and leant so that hand and wrist keep clear of the rest of the person."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.contract.geometry import matrix_from_quat, quat_from_matrix
from carecontact.oracle.truth import copy_of_robot
from carecontact.policies.motion import UP, slerp, tool_quat
from carecontact.sim.simulation import Simulation
from carecontact.world.human.skeleton import body_name

F64 = npt.NDArray[np.float64]

TILTS_RAD = (0.0, 0.2, 0.4)
YAWS_DEG = (0, 45, -45, 90, 135)
CLEAR_M = 0.03
"""Enough room [m]: twice the 15 mm by which the deepest breath moves the chest."""
PRESSED_M = 0.010
"""Depth [m] below the skin at which the tool is tried: about where a press of 3 N holds it."""
POSE_ERROR_M = 3e-3
JOINT_MARGIN_RAD = 0.05
STEPS = (14, 5)
"""Number of points at which a posture is computed: on the way to the first place, and between two places."""
ITERATIONS = 3
POSTURE_GAIN = 0.1
"""Share by which each iteration returns to the parked posture in the null space, as the robot's impedance does."""


@dataclass(frozen=True, kw_only=True)
class Held:
    """One way of holding the hand, and how it fares at the places where it is to touch."""

    quat_wxyz: F64
    reached: bool
    """Whether the joints can stay within their ranges along the whole way."""
    clear_m: float
    """Least distance of hand and wrist from the rest of the person, at most CLEAR_M."""

    @property
    def rank(self) -> tuple[bool, float]:
        return self.reached, self.clear_m


def hold(simulation: Simulation, region: str, places: F64) -> Held:
    """Return how to hold the hand for touching (n, 3) ``places`` of the skin [m], given in the robot's base.

    Ways of holding are tried from the least turned and leant one on. The first that reaches all places and keeps
    CLEAR_M from the rest of the person is returned; if none keeps so far away, the one that keeps farthest.
    """
    arm = _Arm(simulation, region)
    found: list[Held] = []
    for quat in _ways(simulation, places[0]):
        found.append(arm.tried(quat, places - PRESSED_M * UP))
        if found[-1].rank == (True, CLEAR_M):
            break
    return max(found, key=lambda held: held.rank)


def _ways(simulation: Simulation, place: F64) -> Iterator[F64]:
    """Yield orientations (4,) of the tool that point down or lean away from the trunk, the shoulder or the bed."""
    data, encoders = simulation.data, simulation.encoders

    def from_body(name: str) -> F64:
        return place - encoders.in_base(data, data.body(body_name(name)).xpos, np.eye(3))[:3, 3]

    sideways = encoders.in_base(data, [0, 1, 0], np.eye(3))[:3, 3] - encoders.in_base(data, [0, 0, 0], np.eye(3))[:3, 3]
    aways = [way * [1, 1, 0] for way in (from_body("thorax"), from_body("right_upper_arm"), sideways)]
    radial = np.arctan2(place[1], place[0])
    ways = [(tilt, k, yaw) for tilt in TILTS_RAD for k in range(len(aways)) for yaw in YAWS_DEG if tilt or k == 0]
    for tilt, k, yaw in sorted(ways, key=lambda way: way[0] / TILTS_RAD[1] + abs(way[2]) / 90):
        away = aways[k] / max(float(np.linalg.norm(aways[k])), 1e-9)
        turned = radial + np.radians(yaw)
        yield tool_quat(-np.cos(tilt) * UP - np.sin(tilt) * away, np.array([np.cos(turned), np.sin(turned), 0.0]))


class _Arm:
    """Tries postures of the robot beside the person, in a copy of the simulation's state."""

    def __init__(self, simulation: Simulation, region: str) -> None:
        model = self._model = simulation.model
        self._encoders, self._data = simulation.encoders, copy_of_robot(simulation)
        self._tcp = model.site(simulation.robot.tcp_site).id
        joints = [model.joint(name) for name in simulation.robot.joints]
        self._dofs = [joint.dofadr[0] for joint in joints]
        self._range = np.array([joint.range for joint in joints])
        self._parked = np.array(simulation.protocol.scene.parked_joint_rad)
        names = [model.geom(g).name for g in range(model.ngeom)]
        self._hand = [g for g, name in enumerate(names) if name.startswith(simulation.robot.wrist_geoms)]
        self._person = [
            g for g, name in enumerate(names)
            if name.startswith("human_hull_") or (name.startswith("human_core_") and f"_{region}_" not in name)
        ]  # fmt: skip

    def tried(self, quat: F64, places: F64) -> Held:
        """``places``: (n, 3) of the tool centre point in base."""
        self._encoders.set_joint_position(self._data, self._parked)
        mujoco.mj_kinematics(self._model, self._data)
        reached, clear = True, CLEAR_M
        for number, place in enumerate(places):
            pose = self._encoders.pose_tcp_in_base(self._data)
            first, last = pose[:3, 3].copy(), quat_from_matrix(pose[:3, :3])
            steps = STEPS[min(number, 1)]
            for k in range(1, steps + 1):
                self._follow(first + k / steps * (place - first), matrix_from_quat(slerp(last, quat, k / steps)))
            reached &= self._error(place, matrix_from_quat(quat)) < POSE_ERROR_M and self._margin() > JOINT_MARGIN_RAD
            clear = min(clear, self._clearance(clear))
        return Held(quat_wxyz=quat, reached=bool(reached), clear_m=clear)

    def _follow(self, position: F64, rotation: F64) -> None:
        """Move the joints toward a pose of the tool, as ``sim.impedance`` would with its posture."""
        model, data = self._model, self._data
        jacobian = np.zeros((6, model.nv))
        for _ in range(ITERATIONS):
            mujoco.mj_comPos(model, data)
            mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], self._tcp)
            own = jacobian[:, self._dofs]
            base = self._encoders.in_base(data, np.zeros(3), np.eye(3))[:3, :3]
            own = np.vstack([base @ own[:3], base @ own[3:]])
            angles = self._encoders.joint_position(data)
            back = POSTURE_GAIN * (self._parked - angles)
            inverse = own.T @ np.linalg.inv(own @ own.T + 1e-6 * np.eye(6))
            angles = angles + inverse @ (self._difference(position, rotation) - own @ back) + back
            self._encoders.set_joint_position(data, np.clip(angles, *self._range.T))
            mujoco.mj_kinematics(model, data)

    def _difference(self, position: F64, rotation: F64) -> F64:
        """(6,) from the tool's pose to the wanted one: position [m], small rotation [rad]."""
        pose = self._encoders.pose_tcp_in_base(self._data)
        turn = 0.5 * np.cross(pose[:3, :3], rotation, axis=0).sum(1)
        return np.concatenate([position - pose[:3, 3], turn])

    def _error(self, position: F64, rotation: F64) -> float:
        return float(np.linalg.norm(self._difference(position, rotation)))

    def _margin(self) -> float:
        angles = self._encoders.joint_position(self._data)
        return float(np.minimum(angles - self._range[:, 0], self._range[:, 1] - angles).min())

    def _clearance(self, enough: float) -> float:
        model, data, between = self._model, self._data, np.zeros(6)
        for mine in self._hand:
            far = np.linalg.norm(data.geom_xpos[self._person] - data.geom_xpos[mine], axis=1)
            near = far < model.geom_rbound[self._person] + model.geom_rbound[mine] + enough
            for other in np.array(self._person)[near]:
                enough = min(enough, mujoco.mj_geomDistance(model, data, mine, int(other), enough, between))
        return enough
