"""The part of a layer's surface that an indenter can reach, condensed to a compliance matrix."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from carecontact.validation.fem.profiles import Profile
from carecontact.validation.result import Array


@dataclass(frozen=True, kw_only=True)
class Surface:
    """A node's displacement is its mean over the node's hat function, inward along the press direction, and so is its
    gap: contact holds in this mean (a mortar method), with which quadratic elements need no care for their corners.
    """

    normal: Array
    """(m, m) inward displacement [m] by inward force [N]"""
    cross: Array
    """(m, m) inward displacement by outward radial force"""
    radial: Array
    """(m, m) outward radial displacement by outward radial force"""
    distance_m: Array
    """(m,) from the indenter's axis"""
    mean: csr_matrix
    """(m, q) from values at the surface's quadrature points to the nodes' means"""
    mean_distance_m: Array
    """(q,) distance of the quadrature points from the indenter's axis"""
    outline_m: Array
    """(k,) distance from the axis of points at which the deformed surface is told, increasing"""
    outline: Array
    """(k, m) inward displacement there by inward nodal force"""

    def gap(self, profile: Profile, depth_m: float) -> Array:
        """(m,) by how much each node has to yield to an indenter this far past first touch; negative: not at all."""
        return self.mean @ (depth_m - profile(self.mean_distance_m))

    def dimple(self, nodal_n: Array) -> Array:
        """(k,) inward displacement [m] of the points of ``outline_m`` under these pushes."""
        return self.outline @ nodal_n[: self.outline.shape[1]]

    def scaled(self, modulus: float) -> Surface:
        """The same layer with every modulus multiplied."""
        return Surface(
            normal=self.normal / modulus, cross=self.cross / modulus, radial=self.radial / modulus,
            distance_m=self.distance_m, mean=self.mean, mean_distance_m=self.mean_distance_m,
            outline_m=self.outline_m, outline=self.outline / modulus,
        )  # fmt: skip


def graded(fine_m: float, fine_to_m: float, end_m: float, growth: float = 1.2) -> Array:
    """(n,) increasing from 0 to ``end_m``: steps of at most ``fine_m`` up to ``fine_to_m``, then longer and longer."""
    points = list(np.linspace(0.0, min(fine_to_m, end_m), max(1, int(np.ceil(min(fine_to_m, end_m) / fine_m))) + 1))
    step, rest = fine_m, []
    while points[-1] + sum(rest) < end_m - 1e-12:
        step *= growth
        rest.append(step)
    scale = (end_m - points[-1]) / sum(rest) if rest else 1.0
    return np.r_[points, points[-1] + scale * np.cumsum(rest)]
