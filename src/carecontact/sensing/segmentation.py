"""Labels every pixel from one RGB-D image, a model's person mask, the robot's own model and the empty cell.

The bed is a plane through the level surface on which the person lies.
"""

from __future__ import annotations

from typing import Protocol as TypingProtocol

import numpy as np

from carecontact.interface.observation import F32, F64, U8, Bool

ENOUGH_PX = 60_000
"""Number of pixels that suffice; of a larger image, only every second (third, ...) row and column is used."""
CELL_M = 0.04
"""Side of the squares of the base's horizontal plane whose heights count: a surface counts by its area, however far the
camera is and however obliquely it looks."""
MIN_PIXELS = 3
"""Least number of pixels in a square whose height counts."""
LEVEL_M = 0.05
"""Largest difference between the quartiles of a square's heights: what is steeper, such as a wall or an edge, is no
place to lie on. Structured-light noise at 2.4 m has quartiles 20 mm apart."""
MIN_AREA_M2 = 0.10
"""Least area of a level surface that counts as a bed: a twentieth of a mattress."""
LAYER_M = 0.02
"""Half thickness of the layer in which squares count as one surface, before a plane is fitted."""
PERSON_M = 0.40
"""Nine tenths of what is seen of a lying person are at most this far above the bed; the floor is farther below
(assumed)."""
UNDER_M = 0.05
"""How far under the highest level surface the mattress may be: an arm board or a folded sheet lies on it."""
SAME_M = 0.006
"""How far from a plane a square may be and still belong to it: less than a third of an arm board's thickness."""
MAX_TILT_DEG = 0.75
"""A bed is level. What its picture is tilted by is the calibration's error: with 0.2 deg about each axis one picture in
a thousand is tilted more. A plane over mattress and arm board would be tilted by 1.4 deg."""
TRIPLES, ROUNDS = 300, 5
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


def bed_plane(points: F64, *, free: Bool, person: Bool) -> F64 | None:
    """Fit z = a x + b y + c in base to the bed that the person lies on.

    It is the highest level surface of MIN_AREA_M2 or more between the person's middle height and PERSON_M below the
    person, and of the planes down to UNDER_M under it the one with most area: the mattress, where an arm board lies on
    it. Random triples of squares propose planes, always the same ones (Fischler and Bolles 1981), and least squares fit
    the best.

    Args:
        points: (H, W, 3) of every pixel in base [m], NaN without depth.
        free: (H, W) what is neither person nor robot.
        person: (H, W) the person.

    Returns:
        (3,) a, b, c [m]; None where no person is seen, or less than MIN_AREA_M2 of a level surface.
    """
    step = max(1, round((person.size / ENOUGH_PX) ** 0.5))
    thin, seen = np.s_[::step, ::step], np.isfinite(points[..., 2])
    lying = points[thin][person[thin] & seen[thin], 2]
    if not len(lying):
        return None
    middle, top = np.percentile(lying, [50, 90])
    # First of all, because a camera may see the floor under the bed.
    with np.errstate(invalid="ignore"):
        below = (points[thin][..., 2] > top - PERSON_M) & (points[thin][..., 2] < middle)
    cells = _level_cells(points[thin][free[thin] & below])
    height = _highest(np.sort(cells[:, 2]))
    if height is None:
        return None
    return _plane(cells[(cells[:, 2] > height - UNDER_M) & (cells[:, 2] < height + LAYER_M)])


def _level_cells(points: F64) -> F64:
    """(N, 3) points -> (C, 3) middle of each level square of CELL_M, and its median height."""
    if not len(points):
        return np.empty((0, 3))
    square = np.floor(points[:, :2] / CELL_M).astype(np.int64)
    key = (square[:, 0] - square[:, 0].min()) * (np.ptp(square[:, 1]) + 1) + square[:, 1] - square[:, 1].min()
    order = np.lexsort((points[:, 2], key))
    square, height, key = square[order], points[order, 2], key[order]
    first = np.flatnonzero(np.r_[True, key[1:] != key[:-1]])
    count = np.diff(np.r_[first, len(key)])
    low, middle, high = (height[first + (count * share).astype(int)] for share in (0.25, 0.5, 0.75))
    level = (count >= MIN_PIXELS) & (high - low < LEVEL_M)
    return np.column_stack([(square[first[level]] + 0.5) * CELL_M, middle[level]]).astype(np.float64)


def _highest(heights: F64) -> float | None:
    """(C,) sorted -> height of the middle of the highest layer with enough squares."""
    beside = np.searchsorted(heights, heights + LAYER_M) - np.searchsorted(heights, heights - LAYER_M)
    enough = np.flatnonzero(beside * CELL_M**2 >= MIN_AREA_M2)
    return float(heights[enough[-1]]) if len(enough) else None


def _plane(cells: F64) -> F64:
    triples = np.random.default_rng(0).integers(len(cells), size=(TRIPLES, 3))
    corner, first, second = (cells[triples[:, k]] for k in range(3))
    normal = np.cross(first - corner, second - corner)
    steep = np.hypot(normal[:, 0], normal[:, 1]) > np.tan(np.radians(MAX_TILT_DEG)) * np.abs(normal[:, 2])
    normal[steep | (np.abs(normal[:, 2]) < CELL_M**2)] = [0.0, 0.0, 1.0]
    slope = -normal[:, :2] / normal[:, 2:]
    planes = np.column_stack([slope, corner[:, 2] - (slope * corner[:, :2]).sum(1)])
    design = np.column_stack([cells[:, :2], np.ones(len(cells))])
    near = (np.abs(cells[:, 2] - planes @ design.T) < SAME_M).sum(1)
    plane = planes[np.argmax(near)]
    for _ in range(ROUNDS):
        kept = np.abs(cells[:, 2] - design @ plane) < SAME_M
        found = np.linalg.lstsq(design[kept], cells[kept, 2], rcond=None)[0]
        if np.hypot(*found[:2]) > np.tan(np.radians(MAX_TILT_DEG)):
            break
        plane = found
    return plane


class PersonSegmenter(TypingProtocol):
    def person(self, rgb: U8) -> F32:
        """(H, W) probability that a pixel shows the person, from one (H, W, 3) image alone; 0 where there is none."""
        ...


def robot_mask(depth: F32, robot_depth: F32) -> Bool:
    """(H, W) self-filter: seen where the robot's model says that it must be. NaN (nothing there) is never robot."""
    with np.errstate(invalid="ignore"):
        return np.abs(depth - robot_depth) < ROBOT_TOLERANCE_M


def nearer_than_cell(depth: F32, cell_depth: F32) -> Bool:
    """(H, W) something stands before the empty cell; where the cell has no depth, anything that has one does."""
    with np.errstate(invalid="ignore"):
        return np.isfinite(depth) & ~(depth > cell_depth - NEARER_M)


def segment(*, person: F32, depth: F32, robot_depth: F32, cell_depth: F32, points: F64) -> dict[str, Bool]:
    """Four disjoint (H, W) masks that cover the image: human, robot, bed, background.

    Human: near the model's person, nearer than the empty cell, and not robot. Without a person (``person`` all 0),
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


def _grown(mask: Bool, reach: int) -> Bool:
    """(H, W) pixels within so many pixels of one that is set."""
    # Rows grow step by step to either side, and each height of the disc takes the rows of its width.
    wide = [mask]
    for step in range(1, reach + 1):
        row = wide[-1].copy()
        row[:, step:] |= mask[:, :-step]
        row[:, :-step] |= mask[:, step:]
        wide.append(row)
    out = wide[reach].copy()
    for step in range(1, reach + 1):
        row = wide[round(np.sqrt(reach**2 - step**2))]
        out[step:] |= row[:-step]
        out[:-step] |= row[step:]
    return out
