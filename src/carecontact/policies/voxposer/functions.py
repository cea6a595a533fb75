"""What a program may call, and what it gets: handles to maps and parts, never an array, never anything of Python's."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
import numpy.typing as npt
from pydantic_monty import ClassInstance

from carecontact.contract.geometry import matrix_from_quat
from carecontact.policies.motion import tool_quat
from carecontact.policies.voxposer import fixed_values as fixed
from carecontact.policies.voxposer.grid import Grid, Voxel
from carecontact.policies.voxposer.maps import KINDS, VALUE_RANGE, MapKind, ValueMap
from carecontact.policies.voxposer.scene import NAMES, Part, Scene

F64 = npt.NDArray[np.float64]
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


@dataclass(frozen=True, kw_only=True)
class PartHandle:
    """A part as a program sees it: whole voxels."""

    name: str
    position: Voxel
    low: Voxel
    """Corner of the box round its visible points"""
    high: Voxel
    normal: tuple[float, float, float]

    @property
    def aabb(self) -> tuple[Voxel, Voxel]:
        """(low, high), as the release names it (interfaces.py 70)"""
        return self.low, self.high

    @property
    def told(self) -> str:
        return self.name


def offered(part: PartHandle) -> ClassInstance:
    """As it is put into the hands of a program."""
    return ClassInstance(part, eager_attrs=("name", "position", "low", "high", "aabb", "normal"))


class MapFunctions:
    """For the programs that compose maps and find parts; they change nothing but the maps that they make."""

    def __init__(self, scene: Scene, grid: Grid) -> None:
        self._scene, self._grid = scene, grid

    def table(self) -> dict[str, Callable[..., object]]:
        def maker(kind: MapKind) -> Callable[..., object]:
            return lambda: ClassInstance(ValueMap(kind=kind))

        makers = {f"get_empty_{kind}_map": maker(kind) for kind in KINDS}
        return makers | {
            "detect": self.detect, "set_voxel": self.set_voxel, "set_voxel_by_radius": self.set_voxel_by_radius,
            "cm2index": self.cm2index, "index2cm": self.index2cm, "vec2quat": self.vec2quat,
            "get_ee_pos": self.get_ee_pos,
        }  # fmt: skip

    def detect(self, name: object) -> object:
        if not isinstance(name, str) or name not in NAMES:
            raise ValueError(f"detect: {name!r:.80} is not known; there is {', '.join(NAMES)}")
        return handle(self._scene.find(name), self._grid)

    def get_ee_pos(self) -> Voxel:
        return self._grid.voxel(self._scene.pose_tcp[:3])

    def set_voxel(self, voxel_map: object, voxel_xyz: object, value: object = 1) -> object:
        return self.set_voxel_by_radius(voxel_map, voxel_xyz, 0, value)

    def set_voxel_by_radius(
        self, voxel_map: object, voxel_xyz: object, radius_cm: object = 0, value: object = 1
    ) -> object:
        """The same map. Names and defaults are the release's (interfaces.py 251)."""
        if not isinstance(voxel_map, ValueMap):
            raise TypeError(f"expected a map from get_empty_..._map first, got {told(voxel_map)}")
        centre = numbers(voxel_xyz, 3, "voxel_xyz")
        radius = number(radius_cm, "radius_cm")
        if not 0 <= radius <= fixed.RADIUS_LIMIT_CM:
            raise ValueError(f"radius_cm {radius:g} is outside 0 to {fixed.RADIUS_LIMIT_CM:g}")
        x, y, z = (round(min(max(c, 0.0), fixed.MAP_SIZE - 1.0)) for c in centre)
        voxel_map.add((x, y, z), _value(voxel_map.kind, value), radius_cm=radius)
        return ClassInstance(voxel_map)

    def cm2index(self, cm: object, direction: object) -> object:
        """Whole voxels along an axis, or (x, y, z) of them along a vector; what is over is cut off."""
        length = number(cm, "cm") / 100
        if isinstance(direction, str):
            along = _axis(direction)
            return int(self._grid.whole_voxels(length) @ along)
        vector = _unit(numbers(direction, 3, "direction"))
        return tuple(self._grid.whole_voxels(length * vector).tolist())

    def index2cm(self, index: object, direction: object = None) -> float:
        """Without a direction by the mean of the three axes, as in the release (interfaces.py 231-234)."""
        resolution = self._grid.resolution_m
        edge = float(resolution.mean()) if direction is None else float(resolution @ _axis(direction))
        return number(index, "index") * edge * 100

    def vec2quat(self, vector: object) -> tuple[float, ...]:
        """The tool along the vector, turned about it as little as possible from where it is."""
        axis = _unit(numbers(vector, 3, "vector"))
        now = matrix_from_quat(self._scene.pose_tcp[3:])
        side = now[:, 0] if abs(float(now[:, 0] @ axis)) < 0.99 else now[:, 1]
        return tuple(tool_quat(axis, side).tolist())


def handle(part: Part, grid: Grid) -> ClassInstance:
    low, high = grid.voxel(part.points_m.min(axis=0)), grid.voxel(part.points_m.max(axis=0))
    nx, ny, nz = part.normal.tolist()
    seen = PartHandle(
        name=part.name, position=grid.voxel(part.position_m), low=low, high=high, normal=(nx, ny, nz)
    )  # fmt: skip
    return offered(seen)


def told(value: object) -> str:
    """What a program gave, in its own terms."""
    return str(getattr(value, "told", type(value).__name__))


def shown(value: object) -> str:
    """A value as a program would write it, if it is one of Python's."""
    return told(value) if hasattr(value, "told") else f"{value!r:.80}"


def number(value: object, what: str) -> float:
    """Raises TypeError or ValueError for what is no finite number of a workable size."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{what}: expected a number, got {told(value)}")
    if not abs(value) < 1e6:
        raise ValueError(f"{what}: {value!r:.40} is no workable number")
    return float(value)


def numbers(value: object, count: int, what: str) -> F64:
    if not isinstance(value, list | tuple) or len(cast("Sequence[object]", value)) != count:
        raise TypeError(f"{what}: expected {count} numbers, got {shown(cast('object', value))}")
    return np.array([number(v, what) for v in cast("Sequence[object]", value)])


def _value(kind: MapKind, value: object) -> tuple[float, ...]:
    if kind == "rotation":
        quat = numbers(value, 4, "rotation")
        norm = float(np.linalg.norm(quat))
        if norm < 1e-6:
            raise ValueError("rotation: a quaternion of length 0")
        return tuple((quat / norm).tolist())
    low, high = VALUE_RANGE[kind]
    got = number(value, kind)
    if not low <= got <= high:
        raise ValueError(f"{kind}: {got:g} is outside {low:g} to {high:g}")
    return (got,)


def _axis(direction: object) -> F64:
    if not isinstance(direction, str) or direction not in AXES:
        raise ValueError(f"direction: {shown(direction)}; valid: x, y, z or, for cm2index, a vector")
    return np.array(AXES[direction])


def _unit(vector: F64) -> F64:
    length = float(np.linalg.norm(vector))
    if length < 1e-9:
        raise ValueError("a direction of length 0")
    return vector / length
