"""The part of a surface that a tool can reach, as square patches and the compliance between them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from carecontact.validation.fem.kernel import Kernel
from carecontact.validation.fem.tools import Tool
from carecontact.validation.result import Array

PRESS, ALONG, ACROSS = range(3)
"""Directions of displacement and force: inward along the press, along the limb, across it. They are the same for every
patch, and on a limb they lean from the patches' own."""
QUARTER = ((1, 1), (1, -1), (-1, 1), (-1, -1))
HALF = ((1, 1), (1, -1))
"""Mirror images, as signs along and across: those of a press (QUARTER), and of a tool that glides along (HALF)."""
SAMPLES = 4
"""Number of points along each side of a patch over which the gap is averaged."""


@dataclass(frozen=True, kw_only=True)
class Surface:
    """Patches of a surface. Each also represents its mirror images. Displacement and gap of a patch are means over
    it.
    """

    kernel: Kernel
    limb_radius_m: float | None
    places: npt.NDArray[np.int64]
    """(m, 2) number of the patch across and along from the axis; 0 is the first on the positive side."""
    images: tuple[tuple[int, int], ...]

    @property
    def count(self) -> int:
        """Number of patches that one patch represents, itself included."""
        return len(self.images)

    @cached_property
    def points_m(self) -> Array:
        """Sample points (m, SAMPLES^2, 3) of each patch: their places along and across, and their depth under the
        limb's top.
        """
        inside = (np.arange(SAMPLES) + 0.5) / SAMPLES
        across = (self.places[:, 0, None] + inside) * self.kernel.step_m[0]
        along = (self.places[:, 1, None] + inside) * self.kernel.step_m[1]
        radius = self.limb_radius_m
        drop = np.zeros_like(across) if radius is None else radius * (1 - np.cos(across / radius))
        flat = across if radius is None else radius * np.sin(across / radius)
        shape = (len(self.places), SAMPLES, SAMPLES)
        grids = along[:, None, :], flat[:, :, None], drop[:, :, None]
        return np.stack([np.broadcast_to(grid, shape).reshape(len(self.places), -1) for grid in grids], 2)

    def gap(self, tool: Tool, depth_m: float, *, moved_m: Array | float = 0.0) -> Array:
        """Return how far (m,) [m] each patch has to yield to a tool at this depth past first touch; negative means not
        at all.

        Args:
            moved_m: how far the tool has moved along over each patch.
        """
        along, across, drop = np.moveaxis(self.points_m, 2, 0)
        moved = np.broadcast_to(moved_m, len(self.places))[:, None]
        return (depth_m - drop - tool.height(along - moved, across)).mean(1)

    def compliance(self, to: tuple[int, ...], by: tuple[int, ...]) -> Array:
        """Return displacements (len(to) m, len(by) m) in the directions ``to`` by forces in the directions ``by`` on
        each patch and its mirror images.
        """
        m = len(self.places)
        found = np.zeros((len(to) * m, len(by) * m))
        here = self._directions(self.places)
        for along, across in self.images:
            # The number of a patch is that of its lower corner, so that the mirror image of 0 is -1.
            mirrored = np.where([across < 0, along < 0], -1 - self.places, self.places)
            there = self._directions(mirrored)
            apart = self.places[:, None, :] - mirrored[None, :, :]
            for a in range(3):
                for b in range(3):
                    left, right = here[list(to), a], there[list(by), b]
                    if not (left.any() and right.any()):
                        continue
                    value = self.kernel.between(apart, a, b)
                    for i, one in enumerate(left):
                        for j, two in enumerate(right):
                            if one.any() and two.any():
                                sign = {PRESS: 1, ALONG: along, ACROSS: across}[by[j]]
                                found[i * m : (i + 1) * m, j * m : (j + 1) * m] += (
                                    sign * value * one[:, None] * two[None, :]
                                )
        return found

    def everywhere(self, push: Array) -> tuple[Array, Array, Array]:
        """Return where (n, 2) every patch on the upper side lies, across and along from the press's axis, and how far
        (n,) it moves under pushes (m,): inward along this axis, and inward along its own normal.
        """
        shape = self.kernel.shape
        index = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), 2)
        index -= np.where(index >= np.array(shape) / 2, shape, 0)
        directions = self._directions(index.reshape(-1, 2))[PRESS]
        load = np.zeros(shape)
        for along, across in self.images:
            places = np.where([across < 0, along < 0], -1 - self.places, self.places)
            load[places[:, 0], places[:, 1]] = push
        inward, sunk = np.zeros(shape), np.zeros(shape)
        for a, to in enumerate(directions):
            for b, by in enumerate(directions):
                if to.any() and by.any():
                    waves = np.fft.rfft2(load * by.reshape(shape)) * np.fft.rfft2(self.kernel.values(a, b))
                    moved = np.fft.irfft2(waves, s=shape)
                    inward += to.reshape(shape) * moved
                    sunk -= moved if a == 0 else 0.0
        middle = (index + 0.5) * self.kernel.step_m
        radius = self.limb_radius_m
        across_m = middle[..., 0] if radius is None else radius * np.sin(middle[..., 0] / radius)
        upper = np.ones(shape, bool) if radius is None else np.abs(middle[..., 0]) < np.pi / 2 * radius
        places = np.asarray(np.stack([across_m, middle[..., 1]], -1), np.float64)
        return places[upper], inward[upper], sunk[upper]

    def _directions(self, places: npt.NDArray[np.int64]) -> Array:
        """Return the directions PRESS, ALONG and ACROSS (3, 3, n) at each patch, in its own directions outward, across,
        along.
        """
        radius = self.limb_radius_m
        middle = (places[:, 0] + 0.5) * self.kernel.step_m[0]
        angle = np.zeros(len(places)) if radius is None else middle / radius
        found = np.zeros((3, 3, len(places)))
        found[PRESS, 0], found[PRESS, 1] = -np.cos(angle), np.sin(angle)
        found[ACROSS, 0], found[ACROSS, 1] = np.sin(angle), np.cos(angle)
        found[ALONG, 2] = 1.0
        return found


def around(
    kernel: Kernel, limb_radius_m: float | None, reach_m: float, *, glides: bool = False, ahead_m: float = 0.0
) -> Surface:
    """Return the patches within ``reach_m`` of the axis, from the nearest to the farthest.

    Args:
        glides: whether tool and surface move along, so that only the two sides across are mirror images.
        ahead_m: how far the axis moves along; patches within reach of any of its places are kept.
    """
    across = np.arange(int(np.ceil(reach_m / kernel.step_m[0])))
    back = int(np.ceil(reach_m / kernel.step_m[1])) if glides else 0
    along = np.arange(-back, int(np.ceil((reach_m + ahead_m) / kernel.step_m[1])))
    places = np.array([(i, j) for i in across for j in along])
    middle = (places + 0.5) * kernel.step_m
    distance = np.hypot(middle[:, 0], middle[:, 1] - np.clip(middle[:, 1], 0.0, ahead_m))
    order = np.argsort(distance, kind="stable")
    return Surface(
        kernel=kernel, limb_radius_m=limb_radius_m, places=places[order[distance[order] <= reach_m]],
        images=HALF if glides else QUARTER,
    )  # fmt: skip
