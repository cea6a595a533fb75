"""Computes where rays meet the triangles of a surface."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from carecontact.errors import SceneError

Array = npt.NDArray[np.float64]


class Triangles:
    """Triangles with corners (m, 3, 3), prepared for many rays (Moeller and Trumbore 1997, J Graphics Tools 2:21)."""

    def __init__(self, corners: Array) -> None:
        a = corners[:, 0]
        self._e1, self._e2 = corners[:, 1] - a, corners[:, 2] - a
        self._normal = np.cross(self._e1, self._e2)
        self._e1_a, self._e2_a = np.cross(self._e1, a), np.cross(self._e2, a)
        self._offset = np.einsum("ij,ij->i", a, self._normal)

    def first_hits(self, origins: Array, directions: Array) -> Array:
        """Return the distance (n,) to the first hit along each ray, as ``distances`` does.

        Raises SceneError when a ray misses.
        """
        first = self.distances(origins, directions)
        if np.isinf(first).any():
            begins: Array = np.broadcast_to(origins, directions.shape)[np.isinf(first)][0]
            place = np.round(begins, 3).tolist()
            raise SceneError(f"a ray from {place} misses the body's surface: the region does not fit this body")
        return first

    def distances(self, origins: Array, directions: Array) -> Array:
        """Return the distance (n,) to the first hit along each ray; infinite for a ray that misses.

        Args:
            origins, directions: (n, 3); a single origin is used for all rays. Distances are multiples of the length of
                the direction.
        """
        o = np.broadcast_to(origins, directions.shape)
        # The triple products of the method, for all rays and triangles at once, as matrix products.
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = -1 / (directions @ self._normal.T)
            turned = np.cross(o, directions)
            u = (turned @ self._e2.T - directions @ self._e2_a.T) * inverse
            v = (directions @ self._e1_a.T - turned @ self._e1.T) * inverse
            distance = (o @ self._normal.T - self._offset) * inverse
            hit = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (distance > 0)
        return np.where(hit, distance, np.inf).min(1, initial=np.inf)
