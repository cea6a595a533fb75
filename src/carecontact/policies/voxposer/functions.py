"""What a program may call, and what it gets: handles to maps and parts, never an array, never anything of Python's."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
import numpy.typing as npt
from pydantic_monty import ClassInstance

from carecontact.contract.geometry import matrix_from_quat
from carecontact.policies.state_machine.primitives import tool_quat
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
        }  # fmt: skip

    def detect(self, name: object) -> object:
        if not isinstance(name, str) or name not in NAMES:
            raise ValueError(f"detect: {name!r:.80} is not known; there is {', '.join(NAMES)}")
        return handle(self._scene.find(name), self._grid)

    def set_voxel(self, value_map: object, voxel: object, value: object) -> None:
        self.set_voxel_by_radius(value_map, voxel, 0, value)

    def set_voxel_by_radius(self, value_map: object, voxel: object, radius_cm: object, value: object) -> None:
        if not isinstance(value_map, ValueMap):
            raise TypeError(f"expected a map first, got {type(value_map).__name__}")
        centre = numbers(voxel, 3, "voxel")
        radius = number(radius_cm, "radius_cm")
        if not 0 <= radius <= fixed.RADIUS_LIMIT_CM:
            raise ValueError(f"radius_cm {radius:g} is outside 0 to {fixed.RADIUS_LIMIT_CM:g}")
        x, y, z = (round(min(max(c, 0.0), fixed.MAP_SIZE - 1.0)) for c in centre)
        value_map.add((x, y, z), _value(value_map.kind, value), radius_cm=radius)

    def cm2index(self, cm: object, direction: object) -> object:
        """Whole voxels along an axis, or (x, y, z) of them along a vector; what is over is cut off."""
        length = number(cm, "cm") / 100
        if isinstance(direction, str):
            along = _axis(direction)
            return int(self._grid.whole_voxels(length) @ along)
        vector = _unit(numbers(direction, 3, "direction"))
        return tuple(self._grid.whole_voxels(length * vector).tolist())

    def index2cm(self, count: object, direction: object) -> float:
        return number(count, "count") * float(self._grid.resolution_m @ _axis(direction)) * 100

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
    return ClassInstance(seen, eager_attrs=("name", "position", "low", "high", "normal"))


def number(value: object, what: str) -> float:
    """Raises TypeError or ValueError for what is no finite number of a workable size."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{what}: expected a number, got {type(value).__name__}")
    if not abs(value) < 1e6:
        raise ValueError(f"{what}: {value!r:.40} is no workable number")
    return float(value)


def numbers(value: object, count: int, what: str) -> F64:
    if not isinstance(value, list | tuple) or len(cast("Sequence[object]", value)) != count:
        raise TypeError(f"{what}: expected {count} numbers, got {value!r:.80}")
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
        raise ValueError(f"direction: {direction!r:.40}; valid: x, y, z or a vector")
    return np.array(AXES[direction])


def _unit(vector: F64) -> F64:
    length = float(np.linalg.norm(vector))
    if length < 1e-9:
        raise ValueError("a direction of length 0")
    return vector / length
