"""The voxels that all maps share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from carecontact.policies.voxposer import fixed_values as fixed

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
        return (self.high_m - self.low_m) / (fixed.MAP_SIZE - 1)

    @property
    def resolution_m(self) -> F64:
        """(3,) length [m] that counts as one voxel when a program converts centimetres.

        It is the box divided by MAP_SIZE and not by one less, as in the release (interfaces.py 25).
        """
        return (self.high_m - self.low_m) / fixed.MAP_SIZE

    def whole_voxels(self, length_m: float | F64) -> I64:
        """Return (3,) voxels of a length, or of (3,) lengths along the axes [m].

        Fractions are cut off towards zero, as in the release (interfaces.py 209-229).
        """
        return np.trunc(length_m / self.resolution_m).astype(np.int64)

    @property
    def shape(self) -> Voxel:
        """Shape of a map's array."""
        return fixed.MAP_SIZE, fixed.MAP_SIZE, fixed.MAP_SIZE

    def voxel(self, point_m: F64) -> Voxel:
        """Return the voxel nearest to a point (3,) [m]; points outside go to the border."""
        x, y, z = self.voxels(point_m[None])[0].tolist()
        return x, y, z

    def voxels(self, points_m: F64) -> I64:
        """Return the (N, 3) voxels nearest to points (N, 3) [m]; points outside go to the border."""
        index = np.rint((points_m - self.low_m) / self.pitch_m)
        return np.clip(index, 0, fixed.MAP_SIZE - 1).astype(np.int64)

    def contains(self, points_m: F64) -> npt.NDArray[np.bool_]:
        """Return (N,): whether each of the points (N, 3) [m] lies inside the workspace."""
        return np.asarray(((points_m >= self.low_m) & (points_m <= self.high_m)).all(axis=1))

    def points(self, voxels: F64) -> F64:
        """Return (..., 3) points in base [m] of voxels (..., 3), which may have fractions."""
        return self.low_m + voxels * self.pitch_m
