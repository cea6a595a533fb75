"""Which pixel shows what, from one RGB-D image, the key-point estimator's person mask and the robot's own model."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

PERSON_PROBABILITY = 0.5
PERSON_ABOVE_BED_M = 0.008
"""The sheet round a limb often gets a person's label; the depth image knows better."""
BED_BAND_M = 0.04
"""Half thickness of the layer that counts as bed: mattress, sheet, arm board."""
ROBOT_TOLERANCE_M = 0.02
"""Between seen and predicted robot depth: calibration and encoder errors of a real cell."""


def robot_mask(depth: F32, robot_depth: F32) -> Bool:
    """(H, W) self-filter: seen where the robot's model says that it must be. NaN (nothing there) is never robot."""
    with np.errstate(invalid="ignore"):
        return np.abs(depth - robot_depth) < ROBOT_TOLERANCE_M


def segment(
    *, person: F32, depth: F32, robot_depth: F32, height_in_base: F64, bed_height_in_base_m: float
) -> dict[str, Bool]:
    """Four disjoint (H, W) masks that cover the image: human, robot, bed, background.

    ``height_in_base`` is each pixel's z in base [m], NaN without depth. A calibrated cell knows its bed's height.
    """
    robot = robot_mask(depth, robot_depth)
    with np.errstate(invalid="ignore"):
        above = height_in_base - bed_height_in_base_m
        human = (person > PERSON_PROBABILITY) & (above > PERSON_ABOVE_BED_M) & ~robot
        bed = (np.abs(above) < BED_BAND_M) & ~human & ~robot
    return {"human": human, "robot": robot, "bed": bed, "background": ~(human | robot | bed)}
