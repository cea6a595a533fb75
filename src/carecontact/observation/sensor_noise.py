"""Noise of real depth cameras and encoders; the same for the same seed, moment and camera."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from carecontact.contract.policy import CAMERAS
from carecontact.contract.protocol import Variation

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]

AXIAL_M, AXIAL_PER_M, AXIAL_FROM_M = 0.0012, 0.0019, 0.4
"""sigma = 1.2 mm + 1.9 mm/m^2 (z - 0.4 m)^2: Nguyen, Izadi and Lovell 2012, for surfaces seen at up to 60 deg."""
LATERAL_PX = 0.8
"""Nguyen, Izadi and Lovell 2012: a pixel's depth is that of a place this far off (sigma), which frays edges."""
DISPARITY_STEP_PER_M = 2.85e-3
"""Depth comes in steps of this times z^2: Khoshelham and Elberink 2012."""
GRAZING_DEG = 80.0
"""No depth where the surface turns away further from the line of sight, and so none at steps in depth; assumed."""


def structured_light(depth: F32, intrinsics: F64, rng: np.random.Generator) -> F32:
    """(H, W) true depth [m] -> what a structured-light camera of 640 x 480 px would report; NaN stays NaN."""
    height, width = depth.shape
    axial = rng.standard_normal((height, width))
    shift = np.rint(LATERAL_PX * rng.standard_normal((2, height, width))).astype(int)
    v, u = np.mgrid[:height, :width]
    seen = depth[np.clip(v + shift[0], 0, height - 1), np.clip(u + shift[1], 0, width - 1)].astype(np.float64)
    seen += axial * (AXIAL_M + AXIAL_PER_M * (seen - AXIAL_FROM_M) ** 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        seen = 1.0 / (DISPARITY_STEP_PER_M * np.rint(1.0 / (DISPARITY_STEP_PER_M * seen)))
    seen[~np.isfinite(depth) | (_incidence_deg(depth, intrinsics) > GRAZING_DEG) | ~(seen > 0)] = np.nan
    return seen.astype(np.float32)


def _incidence_deg(depth: F32, intrinsics: F64) -> F64:
    """(H, W) angle between line of sight and surface normal [deg]; 0 beside pixels without depth."""
    z = depth.astype(np.float64)
    per_v, per_u = np.gradient(z)
    v, u = np.mgrid[: z.shape[0], : z.shape[1]]
    right, down = u - intrinsics[0, 2], v - intrinsics[1, 2]
    focal_u, focal_v = intrinsics[0, 0], intrinsics[1, 1]
    # The normal of the surface (x, y, z)(u, v), up to length; its product with the line of sight is z.
    normal = np.sqrt((focal_u * per_u) ** 2 + (focal_v * per_v) ** 2 + (z + right * per_u + down * per_v) ** 2)
    sight = np.sqrt((right / focal_u) ** 2 + (down / focal_v) ** 2 + 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        angle = np.degrees(np.arccos(np.clip(z / (normal * sight), 0, 1)))
    return np.where(np.isfinite(angle), angle, 0.0)


class SensorNoise:
    """The protocol's noise for one trial. Every call for the same step and camera gives the same numbers."""

    def __init__(self, variation: Variation, *, key: Sequence[int], dt_s: float) -> None:
        self._variation, self._key, self._dt_s = variation, [int(k) for k in key], dt_s

    @property
    def on_encoders(self) -> bool:
        return self._variation.encoder_noise_rad > 0

    def depth(self, depth: F32, intrinsics: F64, *, camera: str, sim_time_s: float) -> F32:
        """(H, W) [m]"""
        if self._variation.depth_noise == "none":
            return depth
        return structured_light(depth, intrinsics, self._rng(sim_time_s, 1 + CAMERAS.index(camera)))

    def joint_position(self, joint_position: F64, *, sim_time_s: float) -> F64:
        """(joints,) [rad]"""
        if not self.on_encoders:
            return joint_position
        noise = self._rng(sim_time_s, 0).standard_normal(joint_position.shape)
        return joint_position + self._variation.encoder_noise_rad * noise

    def _rng(self, sim_time_s: float, sensor: int) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence([*self._key, round(sim_time_s / self._dt_s), sensor]))
