"""Value maps on a grid of voxels, and the values that are fixed for all of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

# "Release" is huangwl18/VoxPoser at commit e3a4c9e: files of its folder src with line numbers, and "yaml" for
# configs/rlbench_config.yaml. "Ours" means that the value is not published, or that it differs from the published one;
# docs/evidence/methods.md gives the reasons.

CONTROL_HZ = 20.0
"""Ours."""

MAP_SIZE = 100
"""Voxels along each axis of the workspace (release: yaml 29); 10, 12 and 7.5 mm in bathing-v3."""
AFFORDANCE_WEIGHT, AVOIDANCE_WEIGHT = 2.0, 1.0
"""Release: yaml 7, 10; planners.py 42."""
AVOIDANCE_SIGMA_VOXELS = 10.0
"""Standard deviation of the Gaussian that spreads what is to be avoided (release: yaml 9; planners.py 39)."""
TARGET_FREE_VOXELS = 15
"""Closer to a target than this, the scene is not an obstacle, so that a target on a surface can be reached (release:
interfaces.py 385)."""
START_FREE_VOXELS = 10
"""Nor is it an obstacle in the cube of twice this width round the tool (release: interfaces.py 393-396)."""
NEIGHBOUR_VOXELS = 2
"""A step goes to one of the 124 voxels that are at most this far along each axis (release: planners.py 106, 114)."""
MAX_STEPS = 300
"""Release: yaml 8."""
STOP_THRESHOLD = 0.001
"""The walk ends where every neighbour costs more by at least this share of the largest cost (release: yaml 4;
planners.py 98)."""
VISITED_PENALTY = 1.0
"""Added to a voxel each time the path leaves it, the largest cost being 1 (release: planners.py 60-62)."""
SMOOTHING_WINDOW, SMOOTHING_ORDER = 20, 3
"""Window [points] and order of the Savitzky-Golay filter over the path (release: yaml 5-6; planners.py 128-130)."""
MAX_CURVATURE = 3.0
"""[1/voxel] The smoothed path is cut where it bends more sharply (release: yaml 13; planners.py 134)."""
CURVATURE_FROM = 5
"""The bend of the path's first points is not limited (release: planners.py 133-136)."""
KEPT_BEFORE_BEND = 0.9
"""Share of the points before the sharp bend that is kept (release: planners.py 137)."""
WAYPOINT_SPACING_VOXELS = 1.0
"""Points of the smoothed path that are closer than this are thinned out (release: yaml 12; planners.py 142-148). Steps
of the walk are about twice as long, so that each usually becomes a waypoint."""
REACHED_VOXELS = 2.0
"""A motion is over when the tool is this close to the target after a whole path (release: interfaces.py 177)."""
NEAR_END_M = 0.01
"""A tool that is this close to the last waypoint goes straight to it (release: interfaces.py 150, 205)."""
MAX_PLANS = 10
"""Ours: plans for one motion; then the program goes on, whether the target is reached or not. The release plans once
(yaml 31)."""

HORIZON_S = 1.5
"""Ours: how much of a plan is executed before the next look, from which the maps are composed again. The release
executes a plan to its end (yaml 30-31); the paper describes replanning at every step. One look costs 0.3 s of
computing, and the person moves slowly."""
SETTLE_S = 0.4
"""Ours: how long the end of a path is held, so that the tool arrives before its place is judged; one time constant of
the impedance. The release commands the last waypoint three more times, each until the arm is there (interfaces.py 376,
205)."""
FULL_SPEED_M_S = 0.25
"""Ours: the speed at velocity 1, which is the session's limit. The release hands the map's values to a controller that
ignores them (controllers.py 80-85; envs/rlbench_env.py 266)."""
MIN_VELOCITY = 0.1
"""Lowest velocity that counts: a tool at velocity 0 would never arrive. All values from here on are ours."""
ROTATION_SPEED_RAD_S = 0.8
"""Below the session's limit of 1.0 rad/s."""
HOME_LIMIT_S = 20.0
"""The way back is one stretch: nothing on it is composed."""

CONTACT_M = 0.005
"""voxposer-phased takes the skin as touched when the tool's cap is this close to where the skin was seen: the error of
a seen surface (docs/evidence/perception.md)."""
PRESS_M = 0.012
"""Depth below the seen skin while the tool slides: the state machine's lightest touch, three times the error of a seen
surface from overhead."""
SLIDE_SPEED_M_S = 0.08
"""The pace of washing by hand."""
DISPLACE_SPEED_M_S = 0.05
LEAD_STEP_M, LEAD_LIMIT_M = 0.015, 0.060
"""How far ahead of the tool its target is set while the limb does not follow: the step at each look and the limit. At
400 N/m the limit gives at most 24 N, which is the state machine's lighter push."""
DISPLACE_HOLD_S = 1.5
MAX_PROGRESS_LOOKS = 12
"""Number of looks after which an objective is given up."""
MAX_DISTANCE_CM = 100.0
SKIN_RADIUS_M = 0.012
"""Radius round a place within which seen points give the height of its skin: the cap's own radius."""

MAX_SUBTASKS = 12
"""More than any care task needs within the time limit."""
MAX_QUERY = 300
"""Characters that a query of one program to another may have: it goes into names, notes and prompts."""
MAX_MAP_ENTRIES = 1000
"""Entries of one map: the error that a program gets beyond this recommends radii."""
RADIUS_LIMIT_CM = 200.0
OCCLUDED_SHARE = 0.05
"""If a larger share of a part's pixels is behind the robot, the part keeps its last unhidden place: key points move by
centimetres when the arm is over a limb (docs/evidence/perception.md)."""
JOINT_RADIUS_M = 0.04
"""Radius of the surface that counts as a joint's: half the visible width of an adult elbow, rounded."""


F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]
Voxel = tuple[int, int, int]


@dataclass(frozen=True, kw_only=True)
class Grid:
    """MAP_SIZE voxels along each axis of a box; voxel 0 is centred on the low corner, the last on the high one."""

    low_m: F64
    """(3,) low corner of the workspace in base."""
    high_m: F64
    """(3,) high corner."""

    @property
    def pitch_m(self) -> F64:
        """(3,) edge lengths of a voxel [m]."""
        return (self.high_m - self.low_m) / (MAP_SIZE - 1)

    @property
    def resolution_m(self) -> F64:
        """(3,) length [m] that counts as one voxel when a program converts centimetres.

        It is the box divided by MAP_SIZE and not by one less, as in the release (interfaces.py 25).
        """
        return (self.high_m - self.low_m) / MAP_SIZE

    def whole_voxels(self, length_m: float | F64) -> I64:
        """Return (3,) voxels of a length, or of (3,) lengths along the axes [m].

        Fractions are cut off towards zero, as in the release (interfaces.py 209-229).
        """
        return np.trunc(length_m / self.resolution_m).astype(np.int64)

    @property
    def shape(self) -> Voxel:
        return MAP_SIZE, MAP_SIZE, MAP_SIZE

    def voxel(self, point_m: F64) -> Voxel:
        """Return the voxel nearest to a point (3,) [m]; points outside go to the border."""
        x, y, z = self.voxels(point_m[None])[0].tolist()
        return x, y, z

    def voxels(self, points_m: F64) -> I64:
        """Return the (N, 3) voxels nearest to points (N, 3) [m]; points outside go to the border."""
        index = np.rint((points_m - self.low_m) / self.pitch_m)
        return np.clip(index, 0, MAP_SIZE - 1).astype(np.int64)

    def contains(self, points_m: F64) -> npt.NDArray[np.bool_]:
        """Return (N,): whether each of the points (N, 3) [m] lies inside the workspace."""
        return np.asarray(((points_m >= self.low_m) & (points_m <= self.high_m)).all(axis=1))

    def points(self, voxels: F64) -> F64:
        """Return (..., 3) points in base [m] of voxels (..., 3), which may have fractions."""
        return self.low_m + voxels * self.pitch_m


F32 = npt.NDArray[np.float32]
MapKind = Literal["affordance", "avoidance", "velocity", "rotation", "gripper"]
KINDS: tuple[MapKind, ...] = ("affordance", "avoidance", "rotation", "velocity", "gripper")
"""The order in which ``execute`` takes them (release: interfaces.py 78-79)."""
VALUE_RANGE = {"affordance": (0.0, 1.0), "avoidance": (-1.0, 1.0), "velocity": (0.0, 2.0), "gripper": (0.0, 1.0)}
"""Lowest and highest value that a program may write; rotations are unit quaternions."""


@dataclass(frozen=True)
class Entry:
    centre: Voxel
    radius_cm: float
    """Half the width of a box, the release's "radius" (interfaces.py 251-266); 0 means the voxel alone."""
    value: tuple[float, ...]
    """One number, or quat_wxyz for rotations."""


@dataclass(kw_only=True)
class ValueMap:
    """The entries of one map; later entries win over earlier ones."""

    kind: MapKind
    entries: list[Entry] = field(default_factory=list[Entry])

    @property
    def description(self) -> str:
        return f"{self.kind} map"

    def add(self, centre: Voxel, value: tuple[float, ...], *, radius_cm: float = 0.0) -> None:
        """Append an entry. Raises ValueError when the map holds MAX_MAP_ENTRIES already."""
        if len(self.entries) >= MAX_MAP_ENTRIES:
            raise ValueError(f"a map holds at most {MAX_MAP_ENTRIES} entries; use a radius")
        self.entries.append(Entry(centre, radius_cm, value))

    def rows(self) -> list[list[float]]:
        """Return the entries for notes: x, y, z of the voxel, radius [cm], and the value."""
        return [[*entry.centre, entry.radius_cm, *entry.value] for entry in self.entries]

    def dense(self, grid: Grid) -> F32:
        """Return the map as (MAP_SIZE,) * 3, with 0 where nothing was written. Rotation maps have no such array."""
        out = np.zeros(grid.shape, np.float32)
        for entry in self.entries:
            low, high = _box(grid, entry)
            box = tuple(slice(max(a, 0), b + 1) for a, b in zip(low.tolist(), high.tolist(), strict=True))
            out[box] = entry.value[0]
        return out

    def at(self, grid: Grid, point_m: F64) -> tuple[float, ...] | None:
        """Return the value of the voxel nearest to a point (3,) in base [m]; None where nothing was written."""
        voxel = np.array(grid.voxel(point_m))
        for entry in reversed(self.entries):
            low, high = _box(grid, entry)
            if ((voxel >= low) & (voxel <= high)).all():
                return entry.value
        return None


def goals(target: F32) -> I64:
    """Return the (n, 3) voxels of an affordance map to which the tool shall go: those with the value 1."""
    return np.argwhere(target >= 1)


def _box(grid: Grid, entry: Entry) -> tuple[I64, I64]:
    """Return the (3,) lowest and highest voxel of an entry, which may lie outside the map."""
    reach = grid.whole_voxels(entry.radius_cm / 100)
    return np.array(entry.centre) - reach, np.array(entry.centre) + reach


# The package ships no types.
signal: Any = import_module("scipy.signal")


def waypoints(path: I64, target: F32) -> F64:
    """Return (n, 3) waypoints in voxels, with fractions, of a walk (m, 3); the last one is a voxel of the target.

    The walk is smoothed, cut before a sharp bend and thinned out, as in the release's planners.py.

    Args:
        path: (m, 3) voxels of the walk, at least two; the first is the tool's own and is left out.
        target: (MAP_SIZE,) * 3 affordance; voxels with the value 1 are the target.
    """
    window = min(SMOOTHING_WINDOW, len(path))
    order = min(SMOOTHING_ORDER, window - 1)
    smooth = np.asarray(signal.savgol_filter(path.astype(np.float64), window, order, axis=0), np.float64)
    smooth = smooth[: _length_before_bend(smooth)]
    points = np.vstack([_spaced(smooth[1:-1]), smooth[-1:]])
    end = np.clip(np.rint(points[-1]), 0, MAP_SIZE - 1).astype(np.int64)
    if target[tuple(end)] < 1:
        ends = goals(target)
        points = np.vstack([points, ends[int(np.linalg.norm(ends - end, axis=1).argmin())]])
    return np.clip(points, 0, MAP_SIZE - 1)


def _spaced(points: F64) -> F64:
    """Keep every n-th point, so that points are WAYPOINT_SPACING_VOXELS apart on average; never add one."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if steps.sum() <= WAYPOINT_SPACING_VOXELS:
        return points
    stride = round(WAYPOINT_SPACING_VOXELS / float(steps.mean()))
    return points[:: max(stride, 1)]


def _length_before_bend(path: F64) -> int:
    """Return how many points of the path (n, 3) to keep."""
    skipped = CURVATURE_FROM
    if len(path) <= skipped:
        return len(path)
    first = np.gradient(path, axis=0)
    second = np.gradient(first, axis=0)
    speed = np.linalg.norm(first, axis=1)
    # Where the path stands still, the division gives infinity if it is about to turn and NaN if it is not.
    with np.errstate(divide="ignore", invalid="ignore"):
        curvature = np.linalg.norm(np.cross(first, second), axis=1) / speed**3
    sharp = np.flatnonzero(curvature[skipped:] > MAX_CURVATURE)
    return int(KEPT_BEFORE_BEND * (sharp[0] + skipped)) if len(sharp) else len(path)
