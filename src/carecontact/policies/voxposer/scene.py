"""The scene as programs see it, and the functions that they may call."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import cast

import numpy as np
import numpy.typing as npt
from pydantic_monty import ClassInstance

from carecontact.interface.body_view import (
    LANDMARK,
    MIN_VISIBILITY,
    PerceptionFailure,
    person_points,
    region_from_observation,
)
from carecontact.interface.geometry import matrix_from_quat, pixels
from carecontact.interface.observation import Observation
from carecontact.interface.regions import REGIONS, STANDARD_REGIONS
from carecontact.policies.foam import find_foam
from carecontact.policies.motion import CAP_RADIUS_M, tool_quat
from carecontact.policies.voxposer import maps as fixed
from carecontact.policies.voxposer.maps import KINDS, VALUE_RANGE, Grid, MapKind, ValueMap, Voxel

F64 = npt.NDArray[np.float64]


def described(value: object) -> str:
    """Return what a value is in a program's own terms: the description of one of our objects, else the type's name."""
    return str(getattr(value, "description", type(value).__name__))


def shown(value: object) -> str:
    """Return a plain value as a program would write it, and one of our objects as ``described`` does."""
    return described(value) if hasattr(value, "description") else f"{value!r:.80}"


def number(value: object, what: str) -> float:
    """Return a number. Raises TypeError for another type, and ValueError unless it is finite and below 1e6."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{what}: expected a number, got {described(value)}")
    if not abs(value) < 1e6:
        raise ValueError(f"{what}: expected a finite number below 1e6, got {value!r:.40}")
    return float(value)


def numbers(value: object, count: int, what: str) -> F64:
    """Return ``count`` numbers as an array. Raises TypeError or ValueError as ``number`` does."""
    if not isinstance(value, list | tuple) or len(cast("Sequence[object]", value)) != count:
        raise TypeError(f"{what}: expected {count} numbers, got {shown(cast('object', value))}")
    return np.array([number(v, what) for v in cast("Sequence[object]", value)])


def text_of(query: object) -> str:
    """Return a text. Raises ValueError unless it has 1 to MAX_QUERY characters that are not all blank."""
    if not isinstance(query, str) or not query.strip() or len(query) > fixed.MAX_QUERY:
        got = repr(query[:80]) if isinstance(query, str) else f"{query!r:.80}"
        raise ValueError(f"expected a text of 1 to {fixed.MAX_QUERY} characters, got {got}")
    return query


def touches(skin: F64, tool: F64) -> bool:
    """Return whether the round cap of a tool at (3,) is within CONTACT_M of the seen skin (N, 3), all in base [m]."""
    centre = tool + [0.0, 0.0, CAP_RADIUS_M]
    return bool(np.linalg.norm(skin - centre, axis=1).min(initial=np.inf) <= CAP_RADIUS_M + fixed.CONTACT_M)


def gap(skin: F64, tool: F64, direction: F64) -> float:
    """Return how far [m] the cap can still go along a level direction (3,) before it meets the seen skin (N, 3).

    It is 0 if the cap is there already, or if nothing is seen on its way.
    """
    offset = skin - tool
    ahead = offset @ direction
    beside = np.linalg.norm((offset - ahead[:, None] * direction)[:, :2], axis=1) <= CAP_RADIUS_M
    ahead = ahead[beside & (offset[:, 2] >= 0) & (ahead > 0)]
    return max(float(ahead.min()) - CAP_RADIUS_M, 0.0) if len(ahead) else 0.0


def skin_height(skin: F64, place: F64) -> float:
    """Return the height in base [m] of the seen skin (N, 3) above a place (3,).

    Where no skin was seen, it is such that a tool which slides PRESS_M below it stays at the height of the place.
    """
    near = skin[np.hypot(*(skin[:, :2] - place[:2]).T) < fixed.SKIN_RADIUS_M, 2]
    return float(np.percentile(near, 90)) if len(near) else float(place[2]) + fixed.PRESS_M


Bool = npt.NDArray[np.bool_]

GRIPPER = "gripper"
PARTS = {
    f"{side} {name.replace('_', ' ')}" if REGIONS[name].sided else name.replace("_", " "): (name, side)
    for name in STANDARD_REGIONS
    for side in (("right", "left") if REGIONS[name].sided else ("right",))
}
"""Name in a program -> region and side. The standard regions alone: the names are part of the prompt, by which recorded
completions are found."""
JOINTS = tuple(f"{side} {joint}" for side in ("right", "left") for joint in ("wrist", "elbow", "shoulder", "hip"))
FOAM = {f"foam on the {part}": part for part in PARTS}
"""Name of foam -> the part on which it is looked for."""
NAMES = (GRIPPER, *PARTS, *JOINTS, *FOAM)
"""Every name that ``Scene.find`` takes."""


@dataclass(frozen=True, kw_only=True)
class Part:
    """Something that a program can request by name, in base."""

    name: str
    position_m: F64
    """(3,) mean of the visible points [m], as the published method summarises its detections; on a round part it lies a
    little below the top."""
    points_m: F64
    """(N, 3) visible points [m]."""
    normal: F64
    """(3,) unit vector out of the surface."""


class Scene:
    """The latest observation, and for each part the last place at which it was not hidden."""

    def __init__(self, camera: str, grid: Grid) -> None:
        """``camera``: name of the camera that is used; ``grid``: the voxels of ``occupied``."""
        self._camera, self.grid = camera, grid
        self._kept: dict[str, Part] = {}
        self._fresh: set[str] = set()

    def look(self, observation: Observation) -> None:
        self._observation, self.view = observation, observation.cameras[self._camera]
        self._fresh = set()

    @property
    def pose_tcp(self) -> F64:
        """(7,) pose of the tool in base: position [m], quat_wxyz."""
        return self._observation.pose_tcp_in_base

    def find(self, name: str) -> Part:
        """Return a part as the latest observation shows it, or as it was last seen if it is hidden or not found now.

        Raises KeyError for a name that is not in NAMES, and PerceptionFailure if the part has never been seen.
        """
        if name == GRIPPER:
            tcp = self.pose_tcp[:3]
            return Part(name=name, position_m=tcp, points_m=tcp[None], normal=np.array([0.0, 0.0, 1.0]))
        kept = self._kept.get(name)
        if kept is None:
            self._kept[name] = self._seen(name)
        elif name not in self._fresh and not self._hidden(kept):
            with suppress(PerceptionFailure):
                self._kept[name] = self._seen(name)
        self._fresh.add(name)
        return self._kept[name]

    def occupied(self) -> Bool:
        """Return the (MAP_SIZE,) * 3 voxels that hold a visible surface other than the robot's."""
        view = self.view
        assert view.points is not None
        assert view.depth is not None
        assert view.masks is not None
        points = view.points[~view.masks["robot"][np.isfinite(view.depth)]].astype(np.float64)
        out = np.zeros(self.grid.shape, bool)
        out[tuple(self.grid.voxels(points[self.grid.contains(points)]).T)] = True
        return out

    def _seen(self, name: str) -> Part:
        if name in JOINTS:
            return self._joint(name)
        region, side = PARTS[FOAM.get(name, name)]
        found = region_from_observation(self._observation, region, side=side, camera=self._camera)
        if name in FOAM:
            foam = find_foam(self.view, found)
            return Part(name=name, position_m=foam.centre_m, points_m=foam.skin_m, normal=found.normal)
        offset = person_points(self.view) - found.centre_m
        inside = np.abs(offset @ found.axis) <= found.half_length_m
        inside &= np.abs(offset @ found.lateral) <= found.radius_m
        # Leave out what lies behind the limb in the picture: a limb is no higher than it is wide.
        inside &= np.abs(offset @ found.normal) <= found.radius_m
        points = offset[inside] + found.centre_m
        if len(points) == 0:
            raise PerceptionFailure(f"no surface of the {name} is visible")
        return Part(name=name, position_m=points.mean(axis=0), points_m=points, normal=found.normal)

    def _joint(self, name: str) -> Part:
        view = self.view
        assert view.landmarks is not None
        assert view.landmarks_in_base is not None
        index = LANDMARK[name]
        visibility, place = float(view.landmarks[index, 2]), view.landmarks_in_base[index].astype(np.float64)
        if not visibility >= MIN_VISIBILITY or not np.isfinite(place).all():
            raise PerceptionFailure(f"{name} is hidden, has no depth, or no person was found")
        person = person_points(view)
        near = person[np.linalg.norm(person - place, axis=1) < fixed.JOINT_RADIUS_M]
        points = near if len(near) else place[None]
        return Part(name=name, position_m=place, points_m=points, normal=np.array([0.0, 0.0, 1.0]))

    def _hidden(self, part: Part) -> bool:
        view = self.view
        assert view.masks is not None
        robot = view.masks["robot"]
        seen = np.rint(pixels(part.points_m, view.intrinsics, view.pose_camera_in_base)).astype(int)
        inside = ((seen >= 0) & (seen < [robot.shape[1], robot.shape[0]])).all(axis=1)
        covered = robot[seen[inside, 1], seen[inside, 0]]
        return len(covered) == 0 or float(covered.mean()) > fixed.OCCLUDED_SHARE


AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


@dataclass(frozen=True, kw_only=True)
class PartHandle:
    """A part as a program sees it, in whole voxels."""

    name: str
    position: Voxel
    low: Voxel
    """Lowest corner of the box round the part's visible points."""
    high: Voxel
    """Highest corner of that box."""
    normal: tuple[float, float, float]
    """Unit vector out of the part's surface, in base."""

    @property
    def aabb(self) -> tuple[Voxel, Voxel]:
        """(low, high), under the release's name (interfaces.py 70)."""
        return self.low, self.high

    @property
    def description(self) -> str:
        return self.name


def offered(part: PartHandle) -> ClassInstance:
    """Return a part as a program gets it: a handle, never an array or another object of Python's."""
    return ClassInstance(part, eager_attrs=("name", "position", "low", "high", "aabb", "normal"))


class MapFunctions:
    """The functions of programs that compose maps and find parts; they change nothing but the maps that they make.

    All raise TypeError or ValueError for an argument that they do not take.
    """

    def __init__(self, scene: Scene, grid: Grid) -> None:
        self._scene, self._grid = scene, grid

    def table(self) -> dict[str, Callable[..., object]]:
        """Return the functions by the names under which programs call them."""

        def empty_map(kind: MapKind) -> object:
            return ClassInstance(ValueMap(kind=kind))

        own = ("detect", "set_voxel", "set_voxel_by_radius", "cm2index", "index2cm", "vec2quat", "get_ee_pos")
        makers = {f"get_empty_{kind}_map": partial(empty_map, kind) for kind in KINDS}
        return {**makers, **{name: getattr(self, name) for name in own}}

    def detect(self, name: object) -> object:
        """Return the part called ``name``. Raises PerceptionFailure if it cannot be found."""
        if not isinstance(name, str) or name not in NAMES:
            raise ValueError(f"detect: {name!r:.80} is not a known name; valid: {', '.join(NAMES)}")
        part, voxel = self._scene.find(name), self._grid.voxel
        low, high = voxel(part.points_m.min(axis=0)), voxel(part.points_m.max(axis=0))
        x, y, z = part.normal.tolist()
        return offered(PartHandle(name=name, position=voxel(part.position_m), low=low, high=high, normal=(x, y, z)))

    def get_ee_pos(self) -> Voxel:
        return self._grid.voxel(self._scene.pose_tcp[:3])

    def set_voxel(self, voxel_map: object, voxel_xyz: object, value: object = 1) -> object:
        """Write one voxel and return the same map."""
        return self.set_voxel_by_radius(voxel_map, voxel_xyz, 0, value)

    def set_voxel_by_radius(
        self, voxel_map: object, voxel_xyz: object, radius_cm: object = 0, value: object = 1
    ) -> object:
        """Write a box of half width ``radius_cm`` and return the same map.

        Names and defaults are the release's (interfaces.py 251).
        """
        if not isinstance(voxel_map, ValueMap):
            raise TypeError(f"expected a map from get_empty_..._map first, got {described(voxel_map)}")
        centre = numbers(voxel_xyz, 3, "voxel_xyz")
        radius = number(radius_cm, "radius_cm")
        if not 0 <= radius <= fixed.RADIUS_LIMIT_CM:
            raise ValueError(f"radius_cm {radius:g} is outside 0 to {fixed.RADIUS_LIMIT_CM:g}")
        x, y, z = (round(min(max(c, 0.0), fixed.MAP_SIZE - 1.0)) for c in centre)
        voxel_map.add((x, y, z), _value(voxel_map.kind, value), radius_cm=radius)
        return ClassInstance(voxel_map)

    def cm2index(self, cm: object, direction: object) -> object:
        """Return a length in whole voxels along an axis, or as (x, y, z) along a vector; fractions are cut off."""
        length = number(cm, "cm") / 100
        if isinstance(direction, str):
            along = _axis(direction)
            return int(self._grid.whole_voxels(length) @ along)
        vector = _unit(numbers(direction, 3, "direction"))
        return tuple(self._grid.whole_voxels(length * vector).tolist())

    def index2cm(self, index: object, direction: object = None) -> float:
        """Return a number of voxels in centimetres along an axis.

        Without a direction, the mean of the three axes counts, as in the release (interfaces.py 231-234).
        """
        resolution = self._grid.resolution_m
        edge = float(resolution.mean()) if direction is None else float(resolution @ _axis(direction))
        return number(index, "index") * edge * 100

    def vec2quat(self, vector: object) -> tuple[float, ...]:
        """Return quat_wxyz of a tool that points along the vector, turned about it as little as possible from now."""
        axis = _unit(numbers(vector, 3, "vector"))
        now = matrix_from_quat(self._scene.pose_tcp[3:])
        side = now[:, 0] if abs(float(now[:, 0] @ axis)) < 0.99 else now[:, 1]
        return tuple(tool_quat(axis, side).tolist())


def _value(kind: MapKind, value: object) -> tuple[float, ...]:
    if kind == "rotation":
        quat = numbers(value, 4, "rotation")
        norm = float(np.linalg.norm(quat))
        if norm < 1e-6:
            raise ValueError("rotation: expected a quaternion of norm 1, got norm 0")
        return tuple((quat / norm).tolist())
    low, high = VALUE_RANGE[kind]
    got = number(value, kind)
    if not low <= got <= high:
        raise ValueError(f"{kind}: {got:g} is outside {low:g} to {high:g}")
    return (got,)


def _axis(direction: object) -> F64:
    if not isinstance(direction, str) or direction not in AXES:
        raise ValueError(f"direction: expected x, y, z or, for cm2index, a vector, got {shown(direction)}")
    return np.array(AXES[direction])


def _unit(vector: F64) -> F64:
    length = float(np.linalg.norm(vector))
    if length < 1e-9:
        raise ValueError("direction: expected a vector of a length above 0, got length 0")
    return vector / length
