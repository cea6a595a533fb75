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
"""The order in which ``execute`` takes them (release: interfaces.py 78-79)."""
VALUE_RANGE: dict[str, tuple[float, float]] = {
    "affordance": (0.0, 1.0), "avoidance": (-1.0, 1.0), "velocity": (0.0, 2.0), "gripper": (0.0, 1.0)
}  # fmt: skip
"""Lowest and highest value that a program may write; rotations are unit quaternions."""


@dataclass(frozen=True)
class Entry:
    """One voxel or box that a program wrote."""

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
        if len(self.entries) >= fixed.MAX_MAP_ENTRIES:
            raise ValueError(f"a map holds at most {fixed.MAX_MAP_ENTRIES} entries; use a radius")
        self.entries.append(Entry(centre, radius_cm, value))

    def rows(self) -> list[list[float]]:
        """Return the entries for notes: x, y, z of the voxel, radius [cm], and the value."""
        return [[*entry.centre, entry.radius_cm, *entry.value] for entry in self.entries]

    def dense(self, grid: Grid) -> F32:
        """Return the map as (MAP_SIZE,) * 3, with 0 where nothing was written. Rotation maps have no such array."""
        out = np.zeros(grid.shape, np.float32)
        for entry in self.entries:
            low, high = _box(grid, entry)
            out[tuple(slice(max(a, 0), b + 1) for a, b in zip(low.tolist(), high.tolist(), strict=True))] = entry.value[
                0
            ]
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
