"""The error of the extrinsic calibration of the fixed cameras in one trial."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
import numpy.typing as npt

from carecontact.contract.policy import CAMERAS
from carecontact.contract.protocol import Protocol

F64 = npt.NDArray[np.float64]
Calibration = Mapping[str, F64]
"""Fixed camera -> (4, 4) error in its own frame (x right, y down, z forward): believed pose = true pose @ error. A
camera on the hand has none; its pose follows the encoders."""


def draw_calibration(rng: np.random.Generator, protocol: Protocol) -> dict[str, F64]:
    """Draw the error of every fixed camera of the protocol: a shift along and a rotation vector about each axis,
    normal with the protocol's standard deviations. Empty where both are 0.

    A camera has the same draws whichever other cameras the protocol names.
    """
    shift_m, turn_deg = protocol.variation.calibration_m, protocol.variation.calibration_deg
    if not (shift_m or turn_deg):
        return {}
    draws = rng.standard_normal((len(CAMERAS), 2, 3))
    return {
        name: _transform(shift_m * shift, np.radians(turn_deg) * turn)
        for name, (shift, turn) in zip(CAMERAS, draws, strict=True)
        if name in protocol.cameras and protocol.cameras[name].mount == "world"
    }


def _transform(shift_m: F64, turn_rad: F64) -> F64:
    error = np.eye(4)
    error[:3, :3], error[:3, 3] = cv2.Rodrigues(turn_rad)[0], shift_m
    return error
