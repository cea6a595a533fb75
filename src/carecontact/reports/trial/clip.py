"""The parts of a line that lie inside a rectangle."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

APART_PX = 0.7
"""Points of a drawn line that are nearer to each other than this look the same as one."""


def inside(points: npt.NDArray[np.float64], width: float, height: float) -> list[list[tuple[float, float]]]:
    """Cut a line through (N, 2) points [px] at the edges of the rectangle from (0, 0) to (width, height).

    Returns:
        One list of (x, y) [px] for each part of the line inside the rectangle, in the order of the line. Points nearer
        than about ``APART_PX`` to their predecessor are left out, except the last one of a part.
    """
    along = np.diff(points, axis=0)
    divisor = np.where(along == 0, 1e-12, along)
    at_edges = np.sort([-points[:-1] / divisor, ([width, height] - points[:-1]) / divisor], axis=0)
    enter, leave = at_edges[0].max(axis=1).clip(0), at_edges[1].min(axis=1).clip(max=1)
    parts: list[list[tuple[float, float]]] = []
    for index in np.flatnonzero(enter < leave).tolist():
        ends = points[index] + np.outer((enter[index], leave[index]), along[index])
        first, last = ((float(x), float(y)) for x, y in ends)
        if enter[index] > 0 or index == 0 or leave[index - 1] < 1 or enter[index - 1] >= leave[index - 1]:
            parts.append([first])
        parts[-1].append(last)
    return [_thinned(part) for part in parts]


def _thinned(part: list[tuple[float, float]]) -> list[tuple[float, float]]:
    kept = part[:1]
    for x, y in part[1:-1]:
        if abs(x - kept[-1][0]) + abs(y - kept[-1][1]) > APART_PX:
            kept.append((x, y))
    return [*kept, part[-1]]
