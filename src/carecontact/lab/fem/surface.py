"""Compliance of a soft surface: elasticity wave by wave, summed on a grid, as patches that a tool can reach."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from numpy.polynomial.legendre import leggauss
from scipy.interpolate import RectBivariateSpline

from carecontact.lab.fem.cases import Medium, Tool
from carecontact.lab.validation.result import Array

# Linear elasticity of a layer or a limb, wave by wave: finite elements through the thickness, Fourier series along the
# surface (a semi-analytical finite element method: Zienkiewicz and Taylor 2000, The Finite Element Method, vol. 2,
# chapter 9; of layers Cheung and Zienkiewicz 1965).
#
# Ground that is uniform along its surface responds to a load that varies as a wave with displacements of the same wave.
# For each wave, this leaves a problem in one variable, the depth, with three displacements: outward u, across i v and
# along i w, times exp(i (k x + q y)). The i makes every equation real.

TOP_M, GROWTH = 0.0002, 1.25
"""Thickness of the element at the surface, and how much thicker each next one is. A test halves both."""
POINTS_FULL, POINTS_REDUCED = 3, 2
"""Gauss points of the energy of shear and of volume: quadratic elements with one point less for the volume carry
nearly incompressible tissue without locking (Malkus and Hughes 1978, Comput Methods Appl Mech Eng 15:63)."""
_POWERS = ((0, 0), (0, 1), (1, 0), (1, 1), (0, 2), (2, 0))
"""Powers of q and k in the stiffness of an element, which is a polynomial in both."""


def surface_compliance(medium: Medium, q: Array, k: Array, *, top_m: float = TOP_M, growth: float = GROWTH) -> Array:
    """Return displacements (n, 3, 3) [m/Pa] of the surface, (u, v, w), by tractions of the same wave.

    Args:
        q: (n,) wavenumbers across [rad/m] at the surface; on a limb, around it.
        k: (n,) wavenumbers along [rad/m].
    """
    # From the bone up, all that lies below an element is condensed to a 3 x 3 stiffness at its lower face.
    powers = np.stack([q**a * k**b for a, b in _POWERS], 1)
    below: Array | None = None
    for low, high, modulus in _elements(medium, top_m, growth):
        element = np.einsum("np,pij->nij", powers, _element(medium, low, high, modulus))
        if below is None:
            element = element[:, 3:, 3:]  # bonded to bone
        else:
            element[:, :3, :3] += below
        inner, top = slice(0, -3), slice(-3, None)
        below = element[:, top, top] - element[:, top, inner] @ np.linalg.solve(
            element[:, inner, inner], element[:, inner, top]
        )
    assert below is not None
    return np.asarray(np.linalg.inv(below), np.float64)


def _elements(medium: Medium, top_m: float, growth: float) -> list[tuple[float, float, float]]:
    """Return each element's depths [m] of its lower and upper face and its Young's modulus [Pa], from the bone up."""
    skin, thickness = medium.skin.thickness_m, medium.ground.thickness_m
    faces = [0.0]
    if skin:
        count = max(2, int(np.ceil(skin / (2 * top_m))))
        faces += list(np.linspace(0.0, skin, count + 1)[1:])
    step, rest = top_m, [faces[-1]]
    while rest[-1] < thickness:
        rest.append(rest[-1] + step)
        step *= growth
    scale = (thickness - faces[-1]) / (rest[-1] - faces[-1])
    faces += [faces[-1] + scale * (z - rest[0]) for z in rest[1:]]
    stiff = medium.skin.modulus_pa
    return [(b, t, stiff if b <= skin * (1 + 1e-9) else medium.tissue_pa)
            for t, b in itertools.pairwise(faces)][::-1]  # fmt: skip


def _element(medium: Medium, low_m: float, high_m: float, modulus: float) -> Array:
    """Return stiffness (6, 9, 9) of a quadratic element by _POWERS: three nodes from below, (u, v, w) at each."""
    poisson = medium.ground.poisson
    first = modulus * poisson / ((1 + poisson) * (1 - 2 * poisson))
    second = modulus / (2 * (1 + poisson))
    # Strains zz, yy, xx, zy, zx, xy.
    shear = second * np.diag([2.0, 2.0, 2.0, 1.0, 1.0, 1.0])
    volume = np.zeros((6, 6))
    volume[:3, :3] = first
    return _integral(medium, low_m, high_m, shear, POINTS_FULL) + _integral(
        medium, low_m, high_m, volume, POINTS_REDUCED
    )


def _integral(medium: Medium, low_m: float, high_m: float, law: Array, points: int) -> Array:
    radius = medium.ground.limb_radius_m
    half = (low_m - high_m) / 2
    total = np.zeros((6, 9, 9))
    for s, weight in zip(*leggauss(points), strict=True):
        depth = (low_m + high_m) / 2 - half * s
        value = np.array([s * (s - 1) / 2, 1 - s**2, s * (s + 1) / 2])
        slope = np.array([s - 0.5, -2 * s, s + 0.5]) / half
        # On a limb, circumferences shrink with depth, and wavelengths with them.
        share, curvature = (1.0, 0.0) if radius is None else (1 - depth / radius, 1 / (radius - depth))
        strain = _strains(value, slope, share, curvature)
        for number, (a, b) in enumerate(_POWERS):
            for one in range(3):
                for two in range(3):
                    if (one == 1) + (two == 1) == a and (one == 2) + (two == 2) == b:
                        total[number] += weight * half * share * strain[one].T @ law @ strain[two]
    return total


def _strains(value: Array, slope: Array, share: float, curvature: float) -> Array:
    """Return the strains (3, 6, 9) by nodal displacements: the constant part, the part with q and the part with k."""
    strain = np.zeros((3, 6, 9))
    u, v, w = (slice(axis, None, 3) for axis in range(3))
    around = value / share
    strain[0, 0, u] = slope
    strain[0, 1, u] = curvature * value
    strain[0, 3, v] = slope - curvature * value
    strain[0, 4, w] = slope
    strain[1, 1, v], strain[1, 3, u], strain[1, 5, w] = -around, around, -around
    strain[2, 2, w], strain[2, 4, u], strain[2, 5, v] = -value, value, -value
    return strain


PERIOD_M = 0.3
"""Loads repeat at this distance along the surface, and around a limb at its circumference. The effect of a load on
bonded tissue fades within about two thicknesses."""
WAVES, FIRST = 70, 0.35
"""Compliance is a smooth function of the wavenumber. It is computed for this number of waves in each direction, close
together up to FIRST divided by the thickness, and interpolated between them."""
OVERSAMPLED = 2
"""Waves are summed up to this multiple of the finest wave that the grid resolves, because a patch has sharp sides."""


class Spectrum:
    """The compliance of a medium for every wave up to a largest wavenumber [rad/m]."""

    def __init__(self, medium: Medium, most: float) -> None:
        self.medium, self.most = medium, most
        near = FIRST / medium.ground.thickness_m
        self._at = near * np.sinh(np.linspace(0.0, np.arcsinh(1.001 * most / near), WAVES))
        q, k = (wave.ravel() for wave in np.meshgrid(self._at, self._at, indexing="ij"))
        found = surface_compliance(medium, q, k).reshape(WAVES, WAVES, 3, 3)
        # Compliance is proportional to the wavelength for short waves: the interpolated quantity is nearly constant.
        size = self._size(self._at[:, None], self._at[None, :])
        self._splines = {
            (a, b): RectBivariateSpline(self._at, self._at, found[:, :, a, b] * size, kx=3, ky=3)
            for a in range(3)
            for b in range(a, 3)
        }

    def __call__(self, q: Array, k: Array, a: int, b: int) -> Array:
        """Return the compliance (len(q), len(k)) of displacement ``a`` by traction ``b``: 0 is u, 1 v, 2 w."""
        odd = lambda wave, axis: np.where((a == axis) != (b == axis), np.sign(wave), 1.0)  # noqa: E731
        spline = self._splines[min(a, b), max(a, b)]
        rows, order = np.unique(np.abs(q), return_inverse=True)
        value = spline(rows, np.abs(k))[order] / self._size(q[:, None], k[None, :])
        return value * odd(q, 1)[:, None] * odd(k, 2)[None, :]

    def _size(self, q: Array, k: Array) -> Array:
        return np.sqrt(q**2 + k**2 + 1 / self.medium.ground.thickness_m**2)


class Kernel:
    """Displacement between the square patches of a grid, in the surface's own directions: 0 outward, 1 across and
    2 along.

    Args:
        fine_m: side of a patch along; across, the side is the nearest one that divides the period.
        period_m: distance at which loads repeat, where the ground does not end by itself.
    """

    def __init__(self, spectrum: Spectrum, fine_m: float, *, period_m: float = PERIOD_M) -> None:
        radius = spectrum.medium.ground.limb_radius_m
        width = period_m if radius is None else 2 * np.pi * radius
        self.shape = 2 * round(width / fine_m / 2), 2 * round(period_m / fine_m / 2)
        self.step_m = width / self.shape[0], period_m / self.shape[1]
        self._spectrum = spectrum
        self._values: dict[tuple[int, int], Array] = {}

    def values(self, a: int, b: int) -> Array:
        """Return mean displacements (n, m) [m] of a patch in direction ``a`` by 1 N spread over another in direction
        ``b``.

        The indices say how many patches the moved one lies across and along from the loaded one; they are periodic.
        """
        if (a, b) not in self._values:
            self._values[a, b] = self._sum(a, b)
        return self._values[a, b]

    def _sum(self, a: int, b: int) -> Array:
        fine = [OVERSAMPLED * count for count in self.shape]
        q, k = (
            2 * np.pi * np.asarray(np.fft.fftfreq(count, step / OVERSAMPLED), np.float64)
            for count, step in zip(fine, self.step_m, strict=True)
        )
        k = np.abs(k[: fine[1] // 2 + 1])
        # A force is uniform over its patch, and a displacement is the mean over its patch.
        patch = [np.sinc(wave * step / 2 / np.pi) ** 2 for wave, step in zip((q, k), self.step_m, strict=True)]
        # u is real, and v and w have a factor i: displacement u by traction v or w has -i, and v or w by u has +i.
        phase = (1j if a else 1) * (-1j if b else 1)
        waves = phase * self._spectrum(q, k, a, b) * np.outer(*patch)
        area = np.prod(self.step_m) / OVERSAMPLED**2
        return np.fft.irfft2(waves, s=fine)[::OVERSAMPLED, ::OVERSAMPLED] / area


def finest(fine_m: float) -> float:
    """Return the largest wavenumber [rad/m], in each direction, that a grid with this step needs."""
    return 1.02 * OVERSAMPLED * np.pi / fine_m


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
    """Patches of a surface, each also for its mirror images; displacement and gap are means over a patch."""

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
        """Sample points (m, SAMPLES^2, 3) of each patch: along, across, and depth under the limb's top."""
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
        """Return displacements (len(to) m, len(by) m) along ``to`` by forces along ``by`` on patches and images."""
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
                    value = self.kernel.values(a, b)[apart[..., 0], apart[..., 1]]
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
        (n,) it moves under pushes (m,): inward along this axis, and inward along its own normal."""
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
        """Return PRESS, ALONG and ACROSS (3, 3, n) at each patch, in its own directions outward, across, along."""
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
