"""A compiled scene that runs: settle the person, move the impedance target, step, keep every sensor sample."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.errors import SettleError
from carecontact.recording.schema import REGION_SEGMENT, REGIONS, SEGMENTS
from carecontact.sim.history import SensorHistory
from carecontact.sim.impedance import (
    TargetInterpolator,
    nullspace_torque,
    set_stiffness,
    target_in_base,
    tcp_pose_in_base,
    write_target,
)
from carecontact.sim.proprioception import Proprioception
from carecontact.world.human.pose import lying_pose_deg
from carecontact.world.human.skeleton import body_name
from carecontact.world.scene import Scene
from carecontact.world.sensors import CONTACT_SLOTS

F64 = npt.NDArray[np.float64]
SOLVER_WARNINGS = (
    mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC,
    mujoco.mjtWarning.mjWARN_CONTACTFULL, mujoco.mjtWarning.mjWARN_CNSTRFULL, mujoco.mjtWarning.mjWARN_INERTIA,
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Settled:
    duration_s: float
    comfort_arm_deg: float
    """Measured."""
    joint_position: F64
    """(J,) scored joints [rad]"""
    wrist_in_world: F64
    """(3,)"""


@dataclass(frozen=True, kw_only=True)
class Samples:
    """One entry a physics step; fields as in the recording schema."""

    time_s: F64
    force: F64
    """(n, S, 3) on the human from the robot, world"""
    normal: F64
    """(n, S)"""
    centroid: F64
    """(n, S, 3)"""
    human_joint: F64
    """(n, J)"""
    tcp_pose: F64
    """(n, 7)"""
    tcp_speed: F64
    tcp_rotation_speed: F64
    wrist: F64
    """(n, 3)"""
    region_pose: F64
    """(n, R, 7)"""


class Simulation:
    """One world. Times are seconds since t = 0 once ``start`` was called."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.model, self.protocol = scene, scene.model, scene.protocol
        self.data = mujoco.MjData(self.model)
        self.history = SensorHistory(self.model)
        self.robot = Proprioception(self.model)
        self.joint_names = [hinge.name for hinge in scene.hinges]
        joints = [self.model.joint(f"human_{name}") for name in self.joint_names]
        self._human_qpos = np.array([j.qposadr[0] for j in joints])
        self.joint_range = np.array([j.range for j in joints])
        self._human_bodies = [b for b in range(self.model.nbody) if self.model.body(b).name.startswith("human_")]
        self._robot_dof = np.array([self.model.joint(f"robot_joint{i}").dofadr[0] for i in range(1, 8)])
        self._base = self.model.body("robot_base")
        self._anchor_qpos = {
            name: np.array([self.model.joint(f"{name}_v{k}_n").qposadr[0] for k in region.vertex_index])
            for name, region in scene.regions.items()
        }
        self._read = _Columns(self.history, self.joint_names)
        self.interpolator = TargetInterpolator(self.protocol.physics)
        self.posture = np.array(self.protocol.scene.parked_joint_rad)
        self._zero_s = 0.0
        self._until_target = 0

    @property
    def time_s(self) -> float:
        return self.data.time - self._zero_s

    @property
    def joint_columns(self) -> npt.NDArray[np.int64]:
        """(J,) columns of the scored joints in a row of sensor values."""
        return self._read.joints

    @property
    def pose_base_in_world(self) -> F64:
        """(7,)"""
        return np.r_[self.data.xpos[self._base.id], self.data.xquat[self._base.id]]

    # -- settling ---------------------------------------------------------------------------------------------------

    def settle(self, comfort_arm_deg: float) -> Settled:
        """Lay the person down, park the robot and wait until nothing moves.

        The passive joints rest at the angles in which the person is laid; the settled pose is a few degrees from them.
        Raises SettleError if the person still moves after ``phases.settle_max_s``.
        """
        phases, model, data = self.protocol.phases, self.model, self.data
        self._lay_down(comfort_arm_deg)
        self.park()
        period = round(self.protocol.physics.target_period_s / model.opt.timestep)
        calm_s = 0.0
        while True:
            mujoco.mj_step(model, data, period)
            speed = self.human_speed()
            calm_s = calm_s + period * model.opt.timestep if speed < phases.settle_speed_m_s else 0.0
            if data.time >= phases.settle_min_s and calm_s >= phases.settle_hold_s:
                break
            if data.time >= phases.settle_max_s or not np.isfinite(speed):
                raise SettleError(
                    f"person still moves at {speed * 1000:.1f} mm/s after {data.time:.1f} s "
                    f"(limit {phases.settle_speed_m_s * 1000:.0f} mm/s)"
                )
        return Settled(
            duration_s=float(data.time), comfort_arm_deg=self.comfort_arm_deg(),
            joint_position=data.qpos[self._human_qpos].copy(),
            wrist_in_world=data.xpos[model.body(body_name("right_hand")).id].copy(),
        )  # fmt: skip

    def _lay_down(self, comfort_arm_deg: float) -> None:
        mujoco.mj_resetData(self.model, self.data)
        pose = lying_pose_deg(comfort_arm_deg)
        for hinge, address in zip(self.scene.hinges, self._human_qpos, strict=True):
            angle = np.radians(pose.get(hinge.name, hinge.bind_deg))
            self.data.qpos[address] = angle
            self.model.qpos_spring[address] = angle

    def park(self) -> None:
        """Put the robot at its parked joints and the target on its TCP."""
        self.robot.set_joint_position(self.data, self.protocol.scene.parked_joint_rad)
        mujoco.mj_forward(self.model, self.data)
        pose = tcp_pose_in_base(self.model, self.data)
        self.interpolator.reset(pose)
        write_target(self.model, self.data, pose)

    def human_speed(self) -> float:
        """Largest speed of any body segment's centre of mass [m/s]."""
        velocity, worst = np.zeros(6), 0.0
        for body in self._human_bodies:
            mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_BODY, body, velocity, 0)
            worst = max(worst, float(np.linalg.norm(velocity[3:])))
        return worst

    def comfort_arm_deg(self) -> float:
        """Humerus long axis against the trunk's long axis in the frontal plane [deg]."""
        at = {
            n: self.data.xpos[self.model.body(body_name(n)).id]
            for n in ("right_upper_arm", "right_forearm", "pelvis", "neck")
        }
        humerus, trunk = at["right_forearm"] - at["right_upper_arm"], at["pelvis"] - at["neck"]
        return float(np.degrees(np.arctan2(abs(humerus[1]), humerus[0] * np.sign(trunk[0]))))

    # -- running ----------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """T = 0."""
        self._zero_s = float(self.data.time)
        self._until_target = 0

    def set_goal(self, pose_in_base: F64 | None, period_s: float) -> None:
        self.interpolator.set_goal(pose_in_base, period_s)

    def set_stiffness(self, translational: float, rotational: float) -> None:
        set_stiffness(self.model, translational, rotational, self.protocol)

    def advance(self, steps: int) -> list[Samples]:
        """Run ``steps`` physics steps; the target moves on its own period. One C call between two target moves."""
        period = round(self.protocol.physics.target_period_s / self.model.opt.timestep)
        out: list[Samples] = []
        while steps > 0:
            if self._until_target == 0:
                write_target(self.model, self.data, self.interpolator.advance())
                self.data.qfrc_applied[self._robot_dof] = nullspace_torque(self.model, self.data, self.posture)
                self._until_target = period
            count = min(steps, self._until_target)
            mujoco.mj_step(self.model, self.data, count)
            out.append(self._samples(count))
            steps -= count
            self._until_target -= count
        return out

    def indentation(self) -> F64:
        """(R,) largest inward anchor displacement now [m]."""
        return np.array([max(0.0, float(self.data.qpos[self._anchor_qpos[r]].max())) for r in REGIONS])

    def restore(self, state: F64) -> None:
        """Continue from a vector of ``integration_state`` at a new t = 0; the impedance target stays where it was."""
        mujoco.mj_setState(self.model, self.data, state, int(mujoco.mjtState.mjSTATE_INTEGRATION))
        mujoco.mj_forward(self.model, self.data)
        self.interpolator.reset(target_in_base(self.model, self.data))
        self.start()

    def solver_warnings(self) -> list[str]:
        return [w.name.removeprefix("mjWARN_") for w in SOLVER_WARNINGS if self.data.warning[w].number > 0]

    def integration_state(self) -> F64:
        """The whole state from which the run can be continued bit for bit."""
        spec = int(mujoco.mjtState.mjSTATE_INTEGRATION)
        out = np.zeros(mujoco.mj_stateSize(self.model, spec))
        mujoco.mj_getState(self.model, self.data, out, spec)
        return out

    def _samples(self, count: int) -> Samples:
        times, values = self.history.last(self.data, count)
        return self._read.samples(times - self._zero_s, values)


class _Columns:
    """Where each stream lies in a row of sensor values."""

    def __init__(self, history: SensorHistory, joint_names: list[str]) -> None:
        at = history.columns
        soft = {segment: region for region, segment in REGION_SEGMENT.items()}
        self._net = [[at(f"net_{s}{x}") for x in (("", "_tissue") if s in soft else ("",))] for s in SEGMENTS]
        self._normal = [
            [
                (at(f"normal_{s}{x}"), CONTACT_SLOTS["soft" if x else "rigid"])
                for x in (("", "_tissue") if s in soft else ("",))
            ]
            for s in SEGMENTS
        ]
        self.joints = np.array([at(f"q_{n}").start for n in joint_names])
        self._at = at

    def samples(self, time_s: F64, values: F64) -> Samples:
        n = len(values)
        force, centroid, normal = (
            np.zeros((n, len(SEGMENTS), 3)),
            np.zeros((n, len(SEGMENTS), 3)),
            np.zeros((n, len(SEGMENTS))),
        )
        for s, (nets, normals) in enumerate(zip(self._net, self._normal, strict=True)):
            weight = np.zeros(n)
            for columns in nets:
                part = values[:, columns]
                # Sensor slot: force then position; the net force acts on the second body of the pair, the human.
                size = np.linalg.norm(part[:, :3], axis=1)
                force[:, s] += part[:, :3]
                centroid[:, s] += size[:, None] * part[:, 3:6]
                weight += size
            touched = weight > 0
            centroid[touched, s] /= weight[touched, None]
            for columns, slots in normals:
                part = values[:, columns].reshape(n, slots, 4)
                normal[:, s] += np.abs(part[:, :, 1]).sum(1)
        regions = np.stack(
            [
                np.concatenate(
                    [values[:, self._at(f"region_{r}_position")], values[:, self._at(f"region_{r}_quat")]], 1
                )
                for r in REGIONS
            ],
            1,
        )
        return Samples(
            time_s=time_s, force=force, normal=normal, centroid=centroid, human_joint=values[:, self.joints],
            tcp_pose=np.concatenate([values[:, self._at("tcp_position")], values[:, self._at("tcp_quat")]], 1),
            tcp_speed=np.linalg.norm(values[:, self._at("tcp_velocity")], axis=1),
            tcp_rotation_speed=np.linalg.norm(values[:, self._at("tcp_rotation")], axis=1),
            wrist=values[:, self._at("wrist_position")], region_pose=regions,
        )  # fmt: skip
