"""What a program may call to find parts and to write maps: it gets handles, never an array or an object of Python's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pydantic_monty import ClassInstance

from carecontact.contract.geometry import matrix_from_quat
from carecontact.policies.motion import tool_quat
from carecontact.policies.voxposer import fixed_values as fixed
from carecontact.policies.voxposer.arguments import described, number, numbers, shown
from carecontact.policies.voxposer.grid import Grid, Voxel
from carecontact.policies.voxposer.maps import KINDS, VALUE_RANGE, MapKind, ValueMap
from carecontact.policies.voxposer.scene import NAMES, Part, Scene

F64 = npt.NDArray[np.float64]
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
    """Return a part as it is put into the hands of a program."""
    return ClassInstance(part, eager_attrs=("name", "position", "low", "high", "aabb", "normal"))


class MapFunctions:
    """The functions of programs that compose maps and find parts; they change nothing but the maps that they make.

    Every one of them raises TypeError or ValueError for an argument that it does not take.
    """

    def __init__(self, scene: Scene, grid: Grid) -> None:
        self._scene, self._grid = scene, grid

    def table(self) -> dict[str, Callable[..., object]]:
        """Return the functions by the names under which programs call them."""

        def maker(kind: MapKind) -> Callable[..., object]:
            return lambda: ClassInstance(ValueMap(kind=kind))

        makers = {f"get_empty_{kind}_map": maker(kind) for kind in KINDS}
        return makers | {
            "detect": self.detect, "set_voxel": self.set_voxel, "set_voxel_by_radius": self.set_voxel_by_radius,
            "cm2index": self.cm2index, "index2cm": self.index2cm, "vec2quat": self.vec2quat,
            "get_ee_pos": self.get_ee_pos,
        }  # fmt: skip

    def detect(self, name: object) -> object:
        """Return the part called ``name``. Raises PerceptionFailure if it cannot be found."""
        if not isinstance(name, str) or name not in NAMES:
            raise ValueError(f"detect: {name!r:.80} is not a known name; valid: {', '.join(NAMES)}")
        return handle(self._scene.find(name), self._grid)

    def get_ee_pos(self) -> Voxel:
        """Return the tool's voxel."""
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


def handle(part: Part, grid: Grid) -> ClassInstance:
    """Return the handle that a program gets for a part."""
    low, high = grid.voxel(part.points_m.min(axis=0)), grid.voxel(part.points_m.max(axis=0))
    nx, ny, nz = part.normal.tolist()
    seen = PartHandle(
        name=part.name, position=grid.voxel(part.position_m), low=low, high=high, normal=(nx, ny, nz)
    )  # fmt: skip
    return offered(seen)


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
