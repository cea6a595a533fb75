"""Displacement of each point of a surface by a force on another point: the sum of all waves, on a regular grid."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.interpolate import RectBivariateSpline

from carecontact.validation.fem.ground import Medium
from carecontact.validation.fem.waves import surface_compliance
from carecontact.validation.result import Array

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

    def __init__(self, medium: Medium, most: float, *, waves: int = WAVES) -> None:
        self.medium, self.most = medium, most
        near = FIRST / medium.ground.thickness_m
        self._at = near * np.sinh(np.linspace(0.0, np.arcsinh(1.001 * most / near), waves))
        q, k = (wave.ravel() for wave in np.meshgrid(self._at, self._at, indexing="ij"))
        found = surface_compliance(medium, q, k).reshape(waves, waves, 3, 3)
        # Compliance is proportional to the wavelength for short waves: the interpolated quantity is nearly constant.
        size = self._size(self._at[:, None], self._at[None, :])
        self._splines = {
            (a, b): RectBivariateSpline(self._at, self._at, found[:, :, a, b] * size, kx=3, ky=3)
            for a in range(3)
            for b in range(a, 3)
        }

    def __call__(self, q: Array, k: Array, a: int, b: int) -> Array:
        """Return the compliance (len(q), len(k)) of displacement ``a`` by traction ``b``, where 0 is u, 1 is v and 2 is
        w.
        """
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

    def between(self, apart: npt.NDArray[np.int64], a: int, b: int) -> Array:
        """Return ``values`` at distances (..., 2) in patches."""
        return self.values(a, b)[apart[..., 0], apart[..., 1]]

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
