"""A compiled world in motion: settles the person, moves the robot's target, and reads every sensor at every step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.errors import SceneError, SettleError
from carecontact.human.hulls import PLATES
from carecontact.human.joints import Hinge
from carecontact.human.pose import lying_pose_deg, rest_deg
from carecontact.human.skeleton import body_name, cubic_nm_rad3, end_stop_nm, past_range
from carecontact.interface.regions import REGIONS
from carecontact.protocol.protocol import Protocol
from carecontact.recording.schema import SEGMENTS
from carecontact.sim.controllers import CartesianControl, JointControl
from carecontact.sim.state import Proprioception
from carecontact.tissue.life import Life
from carecontact.tissue.plugin import Readings, Rings
from carecontact.world.scene import HAND_SENSOR, TIP_SENSOR, Scene, plate_sensor

F64 = npt.NDArray[np.float64]


class SensorHistory:
    """Reads the sensors' values of a control period from ``MjData.history`` in one gather.

    MuJoCo 4.0 lays a sensor's ring buffer out as: time of the last reading, index of the newest slot, ``n`` times,
    ``n`` values of the sensor's dimension.
    """

    HEADER = 2

    def __init__(self, model: mujoco.MjModel) -> None:
        counts = set(model.sensor_history[:, 0].tolist())
        if len(counts) != 1 or counts == {0}:
            raise SceneError(f"every scorer sensor must keep the same history, got sample counts {sorted(counts)}")
        self.samples = int(counts.pop())
        address, dim = model.sensor_historyadr, model.sensor_dim
        start = address + self.HEADER + self.samples
        # (samples, nsensordata): slot s of sensor i, component c lies at start_i + s * dim_i + c.
        columns = [start[i] + np.arange(dim[i]) for i in range(model.nsensor)]
        self._index = np.concatenate(columns)[None] + np.arange(self.samples)[:, None] * np.repeat(dim, dim)[None]
        self._cursor = int(address[0]) + 1
        self._times = int(address[0]) + self.HEADER
        self.columns = {model.sensor(i).name: model.sensor_adr[i] + np.arange(dim[i]) for i in range(model.nsensor)}
        """Sensor -> the columns of its components in a row of ``last``."""

    def last(self, data: mujoco.MjData, count: int) -> tuple[F64, F64]:
        """Times (count,) and values (count, nsensordata) of the last ``count`` steps, oldest first.

        A sample is taken with the forces of its step and stamped with the time at the step's start.
        """
        if not 0 < count <= self.samples:
            raise SceneError(f"count {count}: expected 1 to {self.samples}, the samples that the history keeps")
        history = data.history
        order = (int(history[self._cursor]) - np.arange(count - 1, -1, -1)) % self.samples
        return history.take(self._times + order), history.take(self._index.take(order, 0))


SOLVER_WARNINGS = [
    getattr(mujoco.mjtWarning, f"mjWARN_{name}")
    for name in ("BADQPOS", "BADQVEL", "BADQACC", "CONTACTFULL", "CNSTRFULL", "INERTIA")
]
STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
ROUNDING = 1e-9
"""Share of a force that is a difference of two sums of the same numbers."""
UNSOLVED_M = 1e-5
"""The tissue counts as unsolved where a vertex still moved farther than this in the solver's last sweep, where more
points touched than the region's state has rows for, and where the tissue's law or a result is not a finite number."""


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
    """One entry for each physics step; the fields are those of the recording schema."""

    time_s: F64
    force: F64
    """(n, S, 3) on the human from the robot, world"""
    normal: F64
    """(n, S)"""
    centroid: F64
    """(n, S, 3)"""
    beside_force: F64 | None
    """(n, 2, S, 3) the part of ``force`` by the robot's hand, and by its links; None where only its tip touched"""
    beside_normal: F64 | None
    """(n, 2, S) the same of ``normal``"""
    human_joint: F64
    """(n, J)"""
    human_reaction: F64
    """(n, J) [N m]"""
    tcp_pose: F64
    """(n, 7)"""
    tcp_speed: F64
    tcp_rotation_speed: F64
    wrist: F64
    """(n, 3)"""
    region_pose: F64
    """(n, R, 7)"""


def lengths(vectors: F64) -> F64:
    """(..., n) -> (...): the bits of ``np.linalg.norm``, without its detours."""
    return np.sqrt(np.add.reduce(vectors * vectors, axis=-1))


class Simulation:
    """One world. After ``start``, times are seconds since t = 0."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.model, self.protocol, self.robot = scene, scene.model, scene.protocol, scene.robot
        self.data = mujoco.MjData(self.model)
        self.history = SensorHistory(self.model)
        self.encoders = Proprioception(self.model, self.robot)
        self.joint_names = [hinge.name for hinge in scene.hinges]
        joints = [self.model.joint(f"human_{name}") for name in self.joint_names]
        self._human_qpos = np.array([j.qposadr[0] for j in joints])
        self.joint_range = np.radians([hinge.range_deg for hinge in scene.hinges])
        self._human_bodies = [b for b in range(self.model.nbody) if self.model.body(b).name.startswith("human_")]
        self._base = self.model.body(self.robot.base_body)
        self.tissue = {name: Readings(self.model, name) for name in scene.regions}
        """What each soft region feels."""
        self._rings = Rings(list(self.tissue.values()))
        self.life = Life(self.model) if Life.exists(self.model) else None
        """What the person does by itself; None where it never does anything."""
        self._read = _SampleReader(self.history, scene.hinges, self.protocol)
        law = scene.control.joint
        self.control = (
            CartesianControl(self.model, self.data, self.protocol)
            if law is None
            else JointControl(self.model, self.data, self.protocol, law)
        )
        """What commands the robot, once in every target period."""
        self.force_bias_n = np.zeros(3)
        """(3,) force at the tool, in base, that the arm exerts beside what is commanded; from the next refresh on."""
        self._flange, self._tcp = self.model.body(self.robot.flange_body).id, self.model.site(self.robot.tcp_site).id
        self.normal_sum_truncated = False
        """Whether a segment had more contacts at once than its normal sensor has slots."""
        self._unsolved = False
        self._steps = 0
        self._until_target = 0

    @property
    def time_s(self) -> float:
        # Counted, not read: MjData.time adds up rounding errors that a policy would see.
        return self._steps * self.model.opt.timestep

    @property
    def pose_base_in_world(self) -> F64:
        """(7,)"""
        return np.r_[self.data.xpos[self._base.id], self.data.xquat[self._base.id]]

    def settle(self, comfort_arm_deg: float) -> Settled:
        """Lay the person down, park the robot and wait until nothing moves.

        Joints without a neutral angle of their own rest at the angles in which the person is laid; the settled pose is
        a few degrees from them.
        Raises SettleError if the person still moves after ``phases.settle_max_s``.
        """
        phases, model, data = self.protocol.phases, self.model, self.data
        mujoco.mj_resetData(model, data)
        data.qpos[self._human_qpos] = self._rest_joints_at(comfort_arm_deg)
        self.park()
        period = round(self.protocol.physics.target_period_s / model.opt.timestep)
        calm_s = 0.0
        while True:
            mujoco.mj_step(model, data, period)
            speed = self.human_speed()
            calm_s = calm_s + period * model.opt.timestep if speed < phases.settle_speed_m_s else 0.0
            if data.time >= phases.settle_min_s and calm_s >= phases.settle_hold_s:
                break
            if warnings := self.solver_warnings():
                raise SettleError(f"MuJoCo warned while the person settled: {', '.join(warnings)}")
            if data.time >= phases.settle_max_s or not np.isfinite(speed):
                raise SettleError(
                    f"person still moves at {speed * 1000:.1f} mm/s after {data.time:.1f} s "
                    f"(limit {phases.settle_speed_m_s * 1000:.0f} mm/s)"
                )
        return Settled(
            duration_s=float(data.time),
            comfort_arm_deg=self.comfort_arm_deg(),
            joint_position=data.qpos[self._human_qpos].copy(),
            wrist_in_world=self._place_of("right_hand").copy(),
        )

    def _rest_joints_at(self, comfort_arm_deg: float) -> F64:
        """Set the passive joints' rest angles, which live in the model; returns the lying pose (J,) [rad]."""
        pose = lying_pose_deg(self.scene.body, comfort_arm_deg, self.scene.turn)
        angles = np.radians([pose.get(hinge.name, hinge.bind_deg) for hinge in self.scene.hinges])
        self.model.qpos_spring[self._human_qpos] = np.radians(rest_deg(self.scene.hinges, pose))
        return angles

    def park(self) -> None:
        """Put the robot at its parked joints and the target on its TCP."""
        self.encoders.set_joint_position(self.data, self.protocol.scene.parked_joint_rad)
        mujoco.mj_forward(self.model, self.data)
        self.control.park()

    def human_speed(self) -> float:
        """Largest speed of any body segment's centre of mass [m/s]."""
        velocity, worst = np.zeros(6), 0.0
        for body in self._human_bodies:
            mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_BODY, body, velocity, 0)
            worst = max(worst, float(np.linalg.norm(velocity[3:])))
        return worst

    def comfort_arm_deg(self) -> float:
        """Humerus long axis against the trunk's long axis in the trunk's frontal plane [deg]."""
        # The thorax's axes are those of the mesh frame: x to the left, z up the trunk.
        humerus = self._place_of("right_forearm") - self._place_of("right_upper_arm")
        x, _, z = humerus @ self.data.body(body_name("thorax")).xmat.reshape(3, 3)
        return float(np.degrees(np.arctan2(-x, -z)))

    def wrist_radius_m(self) -> float:
        """Horizontal distance of the right wrist from the shoulder [m]."""
        return float(np.hypot(*(self._place_of("right_hand") - self._place_of("right_upper_arm"))[:2]))

    def _place_of(self, segment: str) -> F64:
        return self.data.body(body_name(segment)).xpos

    def start(self) -> None:
        """Begin the trial: t = 0."""
        self._steps = 0
        self._until_target = 0

    @property
    def impedance(self) -> CartesianControl:
        """The Cartesian impedance. Raises SceneError in a world whose robot is under another control."""
        if not isinstance(self.control, CartesianControl):
            raise SceneError(f"{type(self.control).__name__}: this world's robot takes commands of its joints only")
        return self.control

    def set_goal(self, pose_in_base: F64 | None, period_s: float) -> None:
        """Move the Cartesian impedance's target to a pose (7,) in base; None goes on toward the last one."""
        self.impedance.target.set_goal(pose_in_base, period_s)

    def set_stiffness(self, translational: float, rotational: float) -> None:
        """Of the Cartesian impedance: [N/m] and [N m/rad]."""
        self.impedance.set_gains(np.repeat([translational, rotational], 3))

    def set_joint_target(self, joint_position: F64) -> None:
        """(joints,) [rad] for a robot under joint control; it holds from the next physics step on."""
        if not isinstance(self.control, JointControl):
            raise SceneError(f"{type(self.control).__name__}: this world's robot takes poses of its tool only")
        self.control.set_target(joint_position)
        self._until_target = 0

    def advance(self, steps: int) -> list[Samples]:
        """Run ``steps`` physics steps, with one C call between two moves of the target, which has its own period."""
        period = round(self.protocol.physics.target_period_s / self.model.opt.timestep)
        out: list[Samples] = []
        while steps > 0:
            if self._until_target == 0:
                self.control.refresh()
                if self.protocol.arm_errors is not None:
                    self._apply_bias()
                self._until_target = period
            count = min(steps, self._until_target)
            mujoco.mj_step(self.model, self.data, count)
            out.append(self._samples(count))
            self._steps += count
            steps -= count
            self._until_target -= count
        return out

    def _apply_bias(self) -> None:
        """MuJoCo applies a force at the centre of mass of a body; its moment moves it to the tool centre point."""
        data = self.data
        force = data.xmat[self._base.id].reshape(3, 3) @ self.force_bias_n
        lever = data.site_xpos[self._tcp] - data.xipos[self._flange]
        data.xfrc_applied[self._flange] = np.r_[force, np.cross(lever, force)]

    def refresh(self) -> None:
        """Bring poses, cameras and skin up to the current joint angles: a step leaves them where it began.

        Changes nothing that the next step uses.
        """
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)

    def indentation(self) -> F64:
        """(R,) largest inward displacement of each region's shell now [m]; 0 on a rigid one."""
        found = (self.tissue.get(region) for region in self.protocol.regions)
        return np.array([0.0 if t is None else max(0.0, float(t.displacement(self.data)[:, 0].max())) for t in found])

    def restore(self, state: F64, *, comfort_arm_deg: float) -> None:
        """Continue from a vector of ``integration_state`` at a new t = 0; the impedance target stays where it was.

        ``comfort_arm_deg`` is the angle at which the person was laid: the joints' rest angles are not in the state, and
        neither is the person's own motion. Raises SceneError for a state of another size, and for the state of a person
        who is awake where the person of this world never woke.
        """
        size = mujoco.mj_stateSize(self.model, STATE)
        if np.shape(state) != (size,):
            raise SceneError(f"the state of this world has {size} numbers; the given one has shape {np.shape(state)}")
        self._rest_joints_at(comfort_arm_deg)
        mujoco.mj_setState(self.model, self.data, state, STATE)
        if self.life is not None:
            self.life.check_known(self.data)
        mujoco.mj_forward(self.model, self.data)
        self.control.resume()
        self.start()

    def put_back(self, state: F64) -> None:
        """Begin again at t = 0 from what ``integration_state`` gave there, as if nothing had happened since.

        What a trial changes in the model has to be as it was then (``episode.worlds.KeptWorld``).
        """
        model, data = self.model, self.data
        mujoco.mj_resetData(model, data)
        mujoco.mj_setState(model, data, state, STATE)
        mujoco.mj_forward(model, data)
        # Again, because the solver has moved the point from which it starts.
        mujoco.mj_setState(model, data, state, STATE)
        self.control.forget()
        self.normal_sum_truncated = self._unsolved = False
        self.start()

    def take_over(self, other: Simulation) -> None:
        """Continue, under this world's control, from where another simulation of the same world is."""
        self.data.time, self.force_bias_n = other.data.time, other.force_bias_n
        for name in ("qpos", "qvel", "qacc_warmstart", "plugin_state", "mocap_pos", "mocap_quat"):
            getattr(self.data, name)[:] = getattr(other.data, name)
        self.control.resume()
        self.control.refresh()
        mujoco.mj_forward(self.model, self.data)
        self.start()

    def solver_warnings(self) -> list[str]:
        count = self.data.warning.number
        found = [w.name.removeprefix("mjWARN_") for w in SOLVER_WARNINGS if count[w] > 0] if count.any() else []
        return found + ["TISSUE"] * self._unsolved

    def integration_state(self) -> F64:
        """The state from which the run can be continued bit for bit, given the model with its gains and rest angles."""
        out = np.zeros(mujoco.mj_stateSize(self.model, STATE))
        mujoco.mj_getState(self.model, self.data, out, STATE)
        return out

    def _samples(self, count: int) -> Samples:
        _, values = self.history.last(self.data, count)
        felt = self._rings.last(self.data, count)
        # Not `>`: what is not a number is unsolved too.
        self._unsolved |= bool((~(felt["left_m"] <= UNSOLVED_M)).any())
        time_s = (self._steps + np.arange(count)) * self.model.opt.timestep
        samples, overfull = self._read.samples(time_s, values, felt)
        self.normal_sum_truncated |= overfull
        return samples


class _SampleReader:
    """Turns rows of sensor values into samples."""

    SLOT = 4
    """Numbers in a contact slot of the normal sensors: found, then force in the contact frame, normal first."""

    def __init__(self, history: SensorHistory, hinges: tuple[Hinge, ...], protocol: Protocol) -> None:
        def span(*names: str) -> npt.NDArray[np.int64]:
            return np.array([history.columns[name] for name in names])

        gathered: list[npt.NDArray[np.int64]] = []

        def stream(columns: npt.NDArray[np.int64]) -> Callable[[F64], F64]:
            """Have columns (...) gathered in every period; return what takes them, (n, ...), from what was gathered."""
            first, shape = sum(map(np.size, gathered)), columns.shape
            gathered.append(columns)
            return lambda row: row[:, first : first + columns.size].reshape(-1, *shape)

        self._soft = np.array([SEGMENTS.index(REGIONS[r].segment) for r in protocol.soft_regions])
        # Net force and its centroid (S, 6) of the rigid surfaces.
        self._net = stream(span(*(f"net_{s}" for s in SEGMENTS)))
        normal = span(*(f"normal_{s}" for s in SEGMENTS))
        self._found, self._normal = stream(normal[:, 0]), normal[:, 1 :: self.SLOT]
        # (S, plates) 1 where a plate belongs to the surface of a segment, else 0.
        self._plates_of = np.array([[float(plate.segment == s) for plate in PLATES] for s in SEGMENTS])
        plates = [plate_sensor(plate.name) for plate in PLATES]
        self._plate_net = span(*(f"net_{plate}" for plate in plates))
        normal = span(*(f"normal_{plate}" for plate in plates))
        self._plate_found, self._plate_normal = stream(normal[:, 0]), normal[:, 1 :: self.SLOT]
        self._parts = span(TIP_SENSOR, HAND_SENSOR)[:, 1 :: self.SLOT]
        self._angles = stream(span(*(f"q_{hinge.name}" for hinge in hinges))[:, 0])
        self._range = np.radians([hinge.range_deg for hinge in hinges]).T
        self._stop = np.array([cubic_nm_rad3(hinge.name) for hinge in hinges])
        self._tcp_pose = stream(np.concatenate([span("tcp_position")[0], span("tcp_quat")[0]]))
        self._tcp_rates = stream(span("tcp_velocity", "tcp_rotation"))
        self._wrist = stream(span("wrist_position")[0])
        position, quat = (span(*(f"region_{r}_{part}" for r in protocol.regions)) for part in ("position", "quat"))
        self._regions = stream(np.concatenate([position, quat], 1))
        self._gathered = np.concatenate([columns.ravel() for columns in gathered])

    def samples(self, time_s: F64, values: F64, felt: npt.NDArray[np.void]) -> tuple[Samples, bool]:
        """Return the samples, and whether a sum of normal forces misses contacts that found no slot.

        ``felt``: (n, R) rows of ``tissue.plugin.ROW``, of the protocol's soft regions.
        """
        row = values.take(self._gathered, 1)
        rigid, found, on_plate = self._net(row), self._found(row), self._plate_found(row)
        overfull = found.max() > self._normal.shape[1] or on_plate.max() > self._plate_normal.shape[1]
        # The net force acts on the second body of the pair, the human.
        force = rigid[..., :3].copy()
        force[:, self._soft] += felt["force_n"]
        weight = lengths(rigid[..., :3])[..., None]
        of_shell = lengths(felt["force_n"])[..., None]
        centroid = weight * rigid[..., 3:]
        centroid[:, self._soft] += of_shell * felt["centroid_m"]
        weight[:, self._soft] += of_shell
        # In the order of the slots, because the sum's last bit depends on it.
        hard = np.abs(values[:, self._normal]).sum(2) if rigid.any() else np.zeros(weight.shape[:2])
        normal, net = hard.copy(), rigid[..., :3]
        normal[:, self._soft] += felt["normal_n"]
        if on_plate.any():
            of_plate = values[:, self._plate_net]
            share = lengths(of_plate[..., :3])[..., None]
            on_plates = self._plates_of @ of_plate[..., :3]
            force += on_plates
            net = net + on_plates
            centroid += self._plates_of @ (share * of_plate[..., 3:])
            weight += self._plates_of @ share
            plates = np.abs(values[:, self._plate_normal]).sum(2) @ self._plates_of.T
            normal += plates
            hard += plates
        np.divide(centroid, weight, out=centroid, where=weight > 0)
        angle, rates = self._angles(row), lengths(self._tcp_rates(row))
        beside_force, beside_normal = self._beside(values, felt, net, hard)
        samples = Samples(
            time_s=time_s,
            force=force,
            normal=normal,
            centroid=centroid,
            beside_force=beside_force,
            beside_normal=beside_normal,
            human_joint=angle,
            human_reaction=end_stop_nm(past_range(angle, *self._range), self._stop),
            tcp_pose=self._tcp_pose(row),
            tcp_speed=rates[:, 0],
            tcp_rotation_speed=rates[:, 1],
            wrist=self._wrist(row),
            region_pose=self._regions(row),
        )
        return samples, bool(overfull)

    def _beside(
        self, values: F64, felt: npt.NDArray[np.void], net: F64, hard: F64
    ) -> tuple[F64, F64] | tuple[None, None]:
        """Return what the robot's hand and its links did of the force (n, 2, S, 3) and of the normal force (n, 2, S);
        None where only its tip touched.

        Args:
            net: (n, S, 3) force on rigid surfaces, plates included.
            hard: (n, S) the same of the normal force. Where several parts press on rigid surfaces at once, each surface
                is taken to bear them in the same shares.
        """
        on_skin = felt["beside_normal_n"]
        if not (on_skin.any() or hard.any()):
            return None, None
        tip, hand = np.abs(values[:, self._parts]).sum(2).T
        whole = hard.sum(1)
        parts = np.stack([hand - tip, whole - hand], 1)
        # Sums of the same forces in another order.
        parts[parts <= ROUNDING * whole[:, None]] = 0.0
        if not (on_skin.any() or parts.any()):
            return None, None
        share = np.divide(parts, whole[:, None], out=np.zeros_like(parts), where=whole[:, None] > 0)
        force, normal = share[:, :, None, None] * net[:, None], share[:, :, None] * hard[:, None]
        force[:, :, self._soft] += felt["beside_force_n"].swapaxes(1, 2)
        normal[:, :, self._soft] += on_skin.swapaxes(1, 2)
        return force, normal
