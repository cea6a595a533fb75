"""Value maps as a program writes them: single voxels and balls over a default. Arrays are made on demand."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from carecontact.policies.voxposer import fixed_values as fixed
from carecontact.policies.voxposer.grid import Grid, Voxel

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
MapKind = Literal["affordance", "avoidance", "velocity", "rotation", "gripper"]
KINDS: tuple[MapKind, ...] = ("affordance", "avoidance", "velocity", "rotation", "gripper")
VALUE_RANGE: dict[str, tuple[float, float]] = {
    "affordance": (0.0, 1.0), "avoidance": (-1.0, 1.0), "velocity": (0.0, 2.0), "gripper": (0.0, 1.0)
}  # fmt: skip
"""Of what a program may write; rotations are unit quaternions."""


@dataclass(frozen=True)
class Entry:
    centre: Voxel
    radius_cm: float
    """0: the voxel alone"""
    value: tuple[float, ...]
    """(1,) or for rotations (4,) quat_wxyz"""


@dataclass(kw_only=True)
class ValueMap:
    """Later entries win over earlier ones."""

    kind: MapKind
    entries: list[Entry] = field(default_factory=list[Entry])

    def add(self, centre: Voxel, value: tuple[float, ...], *, radius_cm: float = 0.0) -> None:
        """Raises ValueError when there are too many."""
        if len(self.entries) >= fixed.MAX_MAP_ENTRIES:
            raise ValueError(f"more than {fixed.MAX_MAP_ENTRIES} entries in one map; use a radius")
        self.entries.append(Entry(centre, radius_cm, value))

    def dense(self, grid: Grid) -> F32:
        """(MAP_SIZE,) * 3, 0 where nothing was written. Not for rotations."""
        out = np.zeros(grid.shape, np.float32)
        for entry in self.entries:
            out[_ball(grid, entry)] = entry.value[0]
        return out

    def at(self, grid: Grid, point_m: F64) -> tuple[float, ...] | None:
        """Value at a point [m]; None where nothing was written."""
        for entry in reversed(self.entries):
            offset = point_m - grid.points(np.array(entry.centre, np.float64))
            inside = np.linalg.norm(offset) <= entry.radius_cm / 100 or bool((np.abs(offset) <= grid.pitch_m / 2).all())
            if inside:
                return entry.value
        return None


def _ball(grid: Grid, entry: Entry) -> tuple[npt.NDArray[np.int64], ...]:
    reach = np.maximum(np.floor(entry.radius_cm / 100 / grid.pitch_m), 0).astype(int)
    low = np.maximum(np.array(entry.centre) - reach, 0)
    high = np.minimum(np.array(entry.centre) + reach, fixed.MAP_SIZE - 1)
    ranges: list[npt.NDArray[np.int64]] = [np.arange(low[k], high[k] + 1) for k in range(3)]
    offset = [(ranges[k] - entry.centre[k]) * float(grid.pitch_m[k]) for k in range(3)]
    square = offset[0][:, None, None] ** 2 + offset[1][None, :, None] ** 2 + offset[2][None, None, :] ** 2
    inside = np.nonzero(np.asarray(square <= (entry.radius_cm / 100) ** 2 + 1e-12))
    return tuple(ranges[k][inside[k]] for k in range(3))
