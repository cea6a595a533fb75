"""What the oracle knows and no other policy may know: the true skin, limbs and arm board, and the contact force."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.errors import ContractError
from carecontact.regions import REGIONS, LimbSight
from carecontact.sight import RegionGeometry
from carecontact.sim.simulation import Simulation
from carecontact.sim.true_skin import skin_in_world
from carecontact.world.human.skeleton import body_name

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
    """The truth about one region in a running simulation. All poses and places are in the robot's base [m]."""

    def __init__(self, simulation: Simulation, region: str) -> None:
        """Raises ContractError for a region without a soft shell or whose joints are unknown."""
        if region not in simulation.tissue or REGIONS[region].sight is None:
            raise ContractError(f"the oracle knows soft regions that lie between joints; {region} is none")
        self.simulation, self.region = simulation, region
        self._tissue = simulation.tissue[region]
        self._net = simulation.history.columns(f"net_{REGIONS[region].segment}")

    def frame(self) -> F64:
        """(4, 4) pose of the region's frame, which moves with the bone and with breathing."""
        site = self.simulation.data.site(f"region_{self.region}")
        return self.simulation.encoders.in_base(self.simulation.data, site.xpos, site.xmat)

    def wrist(self) -> F64:
        """(3,) place of the right wrist."""
        return self._in_base(self.simulation.data.body(body_name("right_hand")).xpos[None])[0]

    def force(self) -> F64:
        """(3,) the robot's force [N] on the region's segment, soft shell and rigid core together: the mean of the last
        control period."""
        if self.simulation.time_s == 0.0:
            return np.zeros(3)
        period = self.simulation.history.samples
        rigid = self.simulation.history.last(self.simulation.data, period)[1][:, self._net][:, :3]
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

    def support_height(self) -> float:
        """Height [m] of the top of the arm board."""
        board = self.simulation.model.geom(BOARD)
        top = self.simulation.data.geom(BOARD).xpos + [0.0, 0.0, board.size[2]]
        return float(self._in_base(top[None])[0, 2])

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
        rise = heights[known] - (middle + slope * distance[known])
        return RegionGeometry(
            region=self.region, centre_m=np.append((start + 0.5 * length * direction + shift * lateral)[:2], middle),
            axis=axis, normal=np.cross(axis, lateral), lateral=lateral, radius_m=float(np.ptp(strip)) / 2,
            half_length_m=0.5 * length, profile_m=np.column_stack([distance[known] / (axis @ direction), rise]),
            support_height_m=self.support_height() if limb else None,
        )  # fmt: skip

    def _line(self) -> tuple[F64, F64]:
        """Return two places (3,) on the skin above the ends of the region's axis, as the scorer measures this axis, but
        only as far as the region is soft. The end nearer to the trunk (abdomen: to the feet) comes first.
        """
        frame, (length, _, outward) = self.frame(), self.simulation.scene.frames[self.region].size_m
        soft = (self.surface() - frame[:3, 3]) @ frame[:3, 0]
        low, high = max(-length / 2, soft.min() + HARD_M), min(length / 2, soft.max() - HARD_M)
        ends = np.array([[low, 0.0, outward], [high, 0.0, outward]]) @ frame[:3, :3].T + frame[:3, 3]
        return ends[0], ends[1]

    def _in_base(self, points: F64) -> F64:
        to_base = self.simulation.encoders.in_base(self.simulation.data, np.zeros(3), np.eye(3))
        return points @ to_base[:3, :3].T + to_base[:3, 3]


def _top(points: F64, along: F64, across: F64) -> float:
    near = (np.abs(along) < COLUMN_M) & (np.abs(across) < COLUMN_M)
    return float(points[near, 2].max()) if near.any() else float("nan")


def displaced(points: F64, before: F64, now: F64) -> F64:
    """Return where (n, 3) points lie after the frame that they belong to moved from pose ``before`` (4, 4) to
    ``now``.
    """
    moved = now @ np.linalg.inv(before)
    return points @ moved[:3, :3].T + moved[:3, 3]


def copy_of_robot(simulation: Simulation) -> mujoco.MjData:
    """Return a copy of the simulation's state in which postures of the robot can be tried."""
    data = mujoco.MjData(simulation.model)
    data.qpos[:] = simulation.data.qpos
    mujoco.mj_kinematics(simulation.model, data)
    return data
