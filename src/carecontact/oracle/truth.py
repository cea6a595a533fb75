"""What the oracle knows of the simulation: true skin, pose, contact, and where its hand has room."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.errors import ContractError
from carecontact.human.hulls import PLATES
from carecontact.human.skeleton import body_name
from carecontact.interface.body_view import RegionGeometry
from carecontact.interface.geometry import matrix_from_quat, quat_from_matrix
from carecontact.interface.regions import REGIONS, LimbSight
from carecontact.policies.foam import MOST_LEAN_RAD
from carecontact.policies.motion import CONTROL_HZ, UP, slerp, tool_quat
from carecontact.sim.simulation import Simulation
from carecontact.sim.state import skin_in_world
from carecontact.world.scene import plate_sensor

F64 = npt.NDArray[np.float64]

BOARD = "bed_armboard"
PROFILE = np.linspace(0.1, 0.9, 17)
"""Shares of the region's length at which the top surface is read, as ``sight.region`` does."""
COLUMN_M = 0.010
"""Half width [m] of the patch whose highest vertex counts as the top of the skin. The shell's vertices there are at
most 10 mm apart."""
HARD_M = 0.005
"""Distance [m] that is kept from the end of the shell, beyond which a tool meets bone."""


class Truth:
    """The truth about one region in a running simulation, which no other policy may know.

    All poses and places are in the robot's base [m].
    """

    def __init__(self, simulation: Simulation, region: str) -> None:
        """Raises ContractError for a region without a soft shell or whose joints are unknown."""
        if region not in simulation.tissue or REGIONS[region].sight is None:
            raise ContractError(f"the oracle knows soft regions that lie between joints; {region} is none")
        self.simulation, self.region = simulation, region
        self._tissue = simulation.tissue[region]
        segment, columns = REGIONS[region].segment, simulation.history.columns
        plates = [f"net_{plate_sensor(plate.name)}" for plate in PLATES if plate.segment == segment]
        self._nets = [columns[name] for name in (f"net_{segment}", *plates)]

    def frame(self) -> F64:
        """(4, 4) pose of the region's frame, which moves with the bone and with breathing."""
        site = self.simulation.data.site(f"region_{self.region}")
        return self.simulation.encoders.in_base(self.simulation.data, site.xpos, site.xmat)

    def contact(self) -> F64 | None:
        """(3,) centroid of the contact with the soft shell; None without contact."""
        felt = self._tissue.last(self.simulation.data, 1)[0]
        return self._in_base(felt["centroid_m"][None])[0] if felt["normal_n"] > 0 else None

    def wrist(self) -> F64:
        """(3,) place of the right wrist."""
        return self._in_base(self.simulation.data.body(body_name("right_hand")).xpos[None])[0]

    def force(self) -> F64:
        """(3,) the robot's force [N] on the region's segment, soft shell, rigid core and plates together: the mean of
        the last control period."""
        if self.simulation.time_s == 0.0:
            return np.zeros(3)
        period = self.simulation.history.samples
        values = self.simulation.history.last(self.simulation.data, period)[1]
        rigid = sum(values[:, net][:, :3] for net in self._nets)
        soft = self._tissue.last(self.simulation.data, period)["force_n"]
        to_base = self.simulation.encoders.in_base(self.simulation.data, np.zeros(3), np.eye(3))
        return to_base[:3, :3] @ (rigid + soft).mean(0)

    def force_n(self) -> float:
        """Magnitude of ``force`` [N]."""
        return float(np.linalg.norm(self.force()))

    def surface(self) -> F64:
        """(N, 3) vertices of the region's shell at rest, where the person lies now."""
        data = self.simulation.data
        turn = data.xmat[self._tissue.bone].reshape(3, 3)
        return self._in_base(self._tissue.places @ turn.T + data.xpos[self._tissue.bone])

    def skin(self) -> F64:
        """(V, 3) vertices of the whole visible skin."""
        return self._in_base(skin_in_world(self.simulation.model, self.simulation.data))

    def geometry(self) -> RegionGeometry:
        """The region where it really is, in the form in which ``sight.region_from_observation`` finds it."""
        start, end = self._line()
        points = self.surface()
        length = float(np.linalg.norm((end - start)[:2]))
        direction = np.append((end - start)[:2] / length, 0.0)
        lateral = np.array([-direction[1], direction[0], 0.0])
        across = (points - start) @ lateral
        along = (points - start) @ direction
        strip = across[np.abs(along - 0.5 * length) < 0.2 * length]
        limb = isinstance(REGIONS[self.region].sight, LimbSight)
        shift = float(strip.min() + strip.max()) / 2 if limb else 0.0
        heights = np.array([_top(points, along - share * length, across - shift) for share in PROFILE])
        known = np.isfinite(heights)
        distance = (PROFILE - 0.5) * length
        slope, _ = np.polyfit(distance[known], heights[known], 1)
        middle = float(np.interp(0.0, distance[known], heights[known]))
        axis = direction + np.array([0.0, 0.0, slope])
        axis /= np.linalg.norm(axis)
        board = self.simulation.data.geom(BOARD).xpos + [0.0, 0.0, self.simulation.model.geom(BOARD).size[2]]
        rise = heights[known] - (middle + slope * distance[known])
        return RegionGeometry(
            region=self.region,
            centre_m=np.append((start + 0.5 * length * direction + shift * lateral)[:2], middle),
            axis=axis,
            normal=np.cross(axis, lateral),
            lateral=lateral,
            radius_m=float(np.ptp(strip)) / 2,
            half_length_m=0.5 * length,
            profile_m=np.column_stack([distance[known] / (axis @ direction), rise]),
            support_height_m=float(self._in_base(board[None])[0, 2]) if limb else None,
        )

    def spot(self) -> Foamed | None:
        """The foam on the region, where it is now; None without foam."""
        patch = self.simulation.scene.foam
        if patch is None:
            return None
        frame = self.frame()
        axes = frame[:3, :3] @ patch.axes
        return Foamed(
            middle=frame[:3, :3] @ patch.middle + frame[:3, 3], axes=axes, half_m=patch.half_m, points=self.surface()
        )

    def _line(self) -> tuple[F64, F64]:
        """Return the places (3,) on the skin above the ends of the region's axis, the end nearer to the trunk (abdomen:
        to the feet) first. The axis is the scorer's, as far as the region is soft.
        """
        frame, (length, _, outward) = self.frame(), self.simulation.scene.frames[self.region].size_m
        soft = (self.surface() - frame[:3, 3]) @ frame[:3, 0]
        low, high = max(-length / 2, soft.min() + HARD_M), min(length / 2, soft.max() - HARD_M)
        ends = np.array([[low, 0.0, outward], [high, 0.0, outward]]) @ frame[:3, :3].T + frame[:3, 3]
        return ends[0], ends[1]

    def _in_base(self, points: F64) -> F64:
        to_base = self.simulation.encoders.in_base(self.simulation.data, np.zeros(3), np.eye(3))
        return points @ to_base[:3, :3].T + to_base[:3, 3]


@dataclass(frozen=True, kw_only=True)
class Foamed:
    """Foam on the skin, in the robot's base [m]."""

    middle: F64
    """(3,)"""
    axes: F64
    """(3, 3) columns: along the region on the skin, across it, outward"""
    half_m: tuple[float, float]
    points: F64
    """(N, 3) vertices of the region's shell at rest"""

    def out(self, share: float = 1.0) -> F64:
        """(3,) unit vector against which the tool presses: leant by this share from straight up to the skin's normal,
        and by at most MOST_LEAN_RAD."""
        level = self.axes[:, 2] * [1, 1, 0]
        size = float(np.linalg.norm(level))
        lean = share * min(float(np.arctan2(size, self.axes[2, 2])), MOST_LEAN_RAD)
        return np.cos(lean) * UP + np.sin(lean) * level / max(size, 1e-9)

    def surface(self, place: F64) -> F64:
        """(3,) the skin over a place (2,), along and across the foam."""
        off = (self.points - self.middle) @ self.axes
        near = np.linalg.norm(off[:, :2] - place, axis=1) < COLUMN_M
        height = float(off[near, 2].mean()) if near.any() else 0.0
        return self.middle + self.axes @ np.append(place, height)

    def ways(self) -> Iterator[F64]:
        """Yield orientations (4,) of the tool: along the skin's normal first and upright last, and each time with the
        wide side of a mitt across the foam first."""
        for share in FOAM_LEANS:
            for yaw in np.radians(FOAM_YAWS_DEG):
                yield tool_quat(-self.out(share), np.cos(yaw) * self.axes[:, 0] + np.sin(yaw) * self.axes[:, 1])


FOAM_LEANS = (1.0, 0.6, 0.3, 0.0)
FOAM_YAWS_DEG = (0, 180, 30, -30, 150, -150, 60, -60, 120, -120, 90, -90)


def _top(points: F64, along: F64, across: F64) -> float:
    near = (np.abs(along) < COLUMN_M) & (np.abs(across) < COLUMN_M)
    return float(points[near, 2].max()) if near.any() else float("nan")


def displaced(points: F64, before: F64, now: F64) -> F64:
    """Return (n, 3) points after their frame moved from the pose ``before`` (4, 4) to ``now``."""
    moved = now @ np.linalg.inv(before)
    return points @ moved[:3, :3].T + moved[:3, 3]


RAMP_S = 2.0
"""Time [s] after the start in which the robot takes on the movement that it follows, because it begins at rest."""
SMOOTHING = 0.6
"""Share of the newest velocity of the skin in the exponential running mean of this velocity."""
MOST_LEAD_M = 0.06
"""Largest lead [m] of a target. A person who changes posture moves the wrist at 0.2 m/s at most, where the tool lags by
that much."""


class Follower:
    """Follows one region of the person. Call ``follow`` once in every control period."""

    def __init__(self, truth: Truth) -> None:
        impedance = truth.simulation.protocol.impedance
        # A critically damped spring whose target moves evenly lags by damping / stiffness seconds.
        self.lag_s = 2.0 * float(np.sqrt(impedance.effective_mass_kg / impedance.translational_n_m))
        self._truth = truth
        self._first = self._last = truth.frame()
        self._velocity = np.zeros(3)
        self._count = 0
        self.place = np.zeros(3)
        """(3,) where the followed place is now [m]: the last target without its lead."""
        self.speed_m_s = 0.0
        """Speed of the place that was followed, over the last control period."""

    def follow(self, place: F64) -> F64:
        """Return where a target (3,) [m], planned when this object was made, belongs now that the region has moved."""
        now = self._truth.frame()
        moved, before = (displaced(place, self._first, frame) for frame in (now, self._last))
        self._last, self.place = now, moved
        velocity = (moved - before) * CONTROL_HZ
        self.speed_m_s = float(np.linalg.norm(velocity))
        self._velocity += SMOOTHING * (velocity - self._velocity)
        lead = self.lag_s * self._velocity
        lead *= min(1.0, MOST_LEAD_M / max(float(np.linalg.norm(lead)), 1e-9))
        self._count += 1
        return place + min(1.0, self._count / (RAMP_S * CONTROL_HZ)) * (moved + lead - place)


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


def hold(simulation: Simulation, region: str, places: F64, ways: Sequence[F64] = ()) -> Held:
    """Return how to hold the hand for touching (n, 3) ``places`` of the skin [m], given in the robot's base.

    Ways of holding are tried from the least turned and leant one on. The first that reaches all places and keeps
    CLEAR_M from the rest of the person is returned; if none keeps so far away, the one that keeps farthest.

    Args:
        ways: orientations (4,) that are tried in place of those.
    """
    arm = _Arm(simulation, region)
    found: list[Held] = []
    for quat in ways or _ways(simulation, places[0]):
        found.append(arm.tried(quat, places - PRESSED_M * UP))
        if found[-1].rank == (True, CLEAR_M):
            break
    return max(found, key=lambda held: held.rank)


def _ways(simulation: Simulation, place: F64) -> Iterator[F64]:
    """Yield orientations (4,) of the tool that point down or lean away from the trunk, the shoulder or the bed."""
    data = simulation.data

    def in_base(point: npt.ArrayLike) -> F64:
        return simulation.encoders.in_base(data, point, np.eye(3))[:3, 3]

    trunk, shoulder = (in_base(data.body(body_name(segment)).xpos) for segment in ("thorax", "right_upper_arm"))
    sideways = in_base([0, 1, 0]) - in_base([0, 0, 0])
    aways = [way * [1, 1, 0] for way in (place - trunk, place - shoulder, sideways)]
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
        self._encoders, self._data = simulation.encoders, mujoco.MjData(model)
        self._data.qpos[:] = simulation.data.qpos
        mujoco.mj_kinematics(model, self._data)
        self._tcp = model.site(simulation.robot.tcp_site).id
        joints = [model.joint(name) for name in simulation.robot.joints]
        self._dofs = [joint.dofadr[0] for joint in joints]
        self._range = np.array([joint.range for joint in joints])
        self._parked = np.array(simulation.protocol.scene.parked_joint_rad)
        names = [model.geom(g).name for g in range(model.ngeom)]
        self._hand = [g for g, name in enumerate(names) if name.startswith(simulation.robot.wrist_geoms)]
        rest = [name.startswith("human_core_") and f"_{region}_" not in name for name in names]
        self._person = [g for g, name in enumerate(names) if name.startswith("human_hull_") or rest[g]]

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
            error = np.linalg.norm(self._difference(place, matrix_from_quat(quat)))
            angles = self._encoders.joint_position(self._data)
            margin = np.minimum(angles - self._range[:, 0], self._range[:, 1] - angles).min()
            reached &= bool(error < POSE_ERROR_M and margin > JOINT_MARGIN_RAD)
            clear = min(clear, self._clearance(clear))
        return Held(quat_wxyz=quat, reached=reached, clear_m=clear)

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

    def _clearance(self, enough: float) -> float:
        model, data, between = self._model, self._data, np.zeros(6)
        for mine in self._hand:
            far = np.linalg.norm(data.geom_xpos[self._person] - data.geom_xpos[mine], axis=1)
            near = far < model.geom_rbound[self._person] + model.geom_rbound[mine] + enough
            for other in np.array(self._person)[near]:
                enough = min(enough, mujoco.mj_geomDistance(model, data, mine, int(other), enough, between))
        return enough
