"""Labels every pixel from one RGB-D image, a model's person mask, the robot's own model and the empty cell."""

from __future__ import annotations

from typing import Protocol as TypingProtocol

import cv2
import numpy as np
import numpy.typing as npt

from carecontact.observation.bed_plane import bed_plane

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]
U8 = npt.NDArray[np.uint8]

PERSON_PROBABILITY = 0.25
PERSON_GROWN_PX = 5
"""The pose mask is smooth and loses fingers, toes and hair: up to this far from it, whatever stands before the empty
cell counts as the person."""
NEARER_M = 0.015
"""How much nearer than the empty cell a pixel must be. The sheet and pillow round a limb often get a person's label;
the depth image knows better. Tuned on development scenes: with structured-light noise 6 mm cost 6 % of IoU; without
noise 15 mm cost 0.1 %."""
BED_BAND_M = 0.04
"""Half thickness of the layer that counts as bed: mattress, sheet, arm board."""
ROBOT_TOLERANCE_M = 0.02
"""Largest difference between seen and predicted robot depth: calibration and encoder errors of a real cell."""


class PersonSegmenter(TypingProtocol):
    def person(self, rgb: U8) -> F32:
        """(H, W) probability that a pixel shows the person, from one (H, W, 3) image alone; 0 where nobody is found."""
        ...


def robot_mask(depth: F32, robot_depth: F32) -> Bool:
    """(H, W) self-filter: seen where the robot's model says that it must be. NaN (nothing there) is never robot."""
    with np.errstate(invalid="ignore"):
        return np.abs(depth - robot_depth) < ROBOT_TOLERANCE_M


def nearer_than_cell(depth: F32, cell_depth: F32) -> Bool:
    """(H, W) something stands before the empty cell; where the cell has no depth, anything that has one does."""
    with np.errstate(invalid="ignore"):
        return np.isfinite(depth) & ~(depth > cell_depth - NEARER_M)


def segment(
    *,
    person: F32,
    depth: F32,
    robot_depth: F32,
    cell_depth: F32,
    points: F64,
) -> dict[str, Bool]:
    """Four disjoint (H, W) masks that cover the image: human, robot, bed, background.

    Human: near the model's person, nearer than the empty cell, and not robot. Where nobody was found (``person`` all 0)
    nothing is human. Bed: near the plane that ``bed_plane`` finds in this image, and neither; where it finds none,
    nothing is bed. ``points`` (H, W, 3) are the pixels in base [m], NaN without depth.
    """
    robot = robot_mask(depth, robot_depth)
    human = _grown(person > PERSON_PROBABILITY, PERSON_GROWN_PX) & nearer_than_cell(depth, cell_depth) & ~robot
    plane, bed = bed_plane(points, free=~(human | robot), person=human), np.zeros_like(human)
    if plane is not None:
        with np.errstate(invalid="ignore"):
            above = points[..., 2] - points[..., :2] @ plane[:2] - plane[2]
            bed = (np.abs(above) < BED_BAND_M) & ~human & ~robot
    return {"human": human, "robot": robot, "bed": bed, "background": ~(human | robot | bed)}


def _grown(mask: Bool, radius_px: int) -> Bool:
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius_px + 1, 2 * radius_px + 1))
    return cv2.dilate(mask.astype(np.uint8), disc).astype(bool)
