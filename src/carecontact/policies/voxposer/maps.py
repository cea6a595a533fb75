"""Value maps as a program writes them: single voxels and boxes over a default. Arrays are made on demand."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from carecontact.policies.voxposer import fixed_values as fixed
from carecontact.policies.voxposer.grid import I64, Grid, Voxel

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
MapKind = Literal["affordance", "avoidance", "velocity", "rotation", "gripper"]
KINDS: tuple[MapKind, ...] = ("affordance", "avoidance", "rotation", "velocity", "gripper")
"""In the order in which ``execute`` takes them (release: interfaces.py 78-79)."""
VALUE_RANGE: dict[str, tuple[float, float]] = {
    "affordance": (0.0, 1.0), "avoidance": (-1.0, 1.0), "velocity": (0.0, 2.0), "gripper": (0.0, 1.0)
}  # fmt: skip
"""Of what a program may write; rotations are unit quaternions."""


@dataclass(frozen=True)
class Entry:
    centre: Voxel
    radius_cm: float
    """Half the width of a box, the release's "radius" (interfaces.py 251-266); 0: the voxel alone"""
    value: tuple[float, ...]
    """(1,) or for rotations (4,) quat_wxyz"""


@dataclass(kw_only=True)
class ValueMap:
    """Later entries win over earlier ones."""

    kind: MapKind
    entries: list[Entry] = field(default_factory=list[Entry])

    @property
    def told(self) -> str:
        return f"{self.kind} map"

    def add(self, centre: Voxel, value: tuple[float, ...], *, radius_cm: float = 0.0) -> None:
        """Raises ValueError when there are too many."""
        if len(self.entries) >= fixed.MAX_MAP_ENTRIES:
            raise ValueError(f"more than {fixed.MAX_MAP_ENTRIES} entries in one map; use a radius")
        self.entries.append(Entry(centre, radius_cm, value))

    def rows(self) -> list[list[float]]:
        """For notes: x, y, z of the voxel, radius [cm], then the value."""
        return [[*entry.centre, entry.radius_cm, *entry.value] for entry in self.entries]

    def dense(self, grid: Grid) -> F32:
        """(MAP_SIZE,) * 3, 0 where nothing was written. Not for rotations."""
        out = np.zeros(grid.shape, np.float32)
        for entry in self.entries:
            low, high = _box(grid, entry)
            out[tuple(slice(max(a, 0), b + 1) for a, b in zip(low.tolist(), high.tolist(), strict=True))] = entry.value[
                0
            ]
        return out

    def at(self, grid: Grid, point_m: F64) -> tuple[float, ...] | None:
        """Value of the voxel nearest to a point [m]; None where nothing was written."""
        voxel = np.array(grid.voxel(point_m))
        for entry in reversed(self.entries):
            low, high = _box(grid, entry)
            if ((voxel >= low) & (voxel <= high)).all():
                return entry.value
        return None


def _box(grid: Grid, entry: Entry) -> tuple[I64, I64]:
    """(3,) lowest and highest voxel, which may lie outside the map."""
    reach = grid.whole_voxels(entry.radius_cm / 100)
    return np.array(entry.centre) - reach, np.array(entry.centre) + reach
