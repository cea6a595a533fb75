"""Drawing for pages: axes and lines as SVG, recorded pictures as data, and the part of a time course that is shown."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any, Literal
from xml.sax.saxutils import escape, quoteattr

import numpy as np
import numpy.typing as npt

from carecontact.errors import RecordingError

# Inline SVG by hand: small, the same bytes for the same numbers, coloured by the page's style sheet.

Anchor = Literal["start", "middle", "end"]
Points = Iterable[tuple[float, float]]


@dataclass(kw_only=True)
class Drawing:
    """A figure of ``width`` x ``height`` pixels that grows element by element. Places are pixels from the top left."""

    width: float
    height: float
    style: str
    """Class of the figure; every element names its own as the first argument."""
    title: str
    """Text alternative."""
    parts: list[str] = field(default_factory=list[str])

    def path(self, style: str, d: str) -> None:
        self.parts.append(f'<path class="{style}" d="{d}"/>')

    def text(self, style: str, x: float, y: float, text: str, *, anchor: Anchor = "start") -> None:
        where = "" if anchor == "start" else f' text-anchor="{anchor}"'
        self.parts.append(f'<text class="{style}" x="{_px(x)}" y="{_px(y)}"{where}>{escape(text)}</text>')

    def line(self, style: str, ends: npt.ArrayLike) -> None:
        """(2, 2) from one place to another."""
        (x0, y0), (x1, y1) = np.asarray(ends).tolist()
        self.path(style, f"M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}")

    def cross(self, style: str, x: float, y: float) -> None:
        self.path(style, f"M{x - 5:.1f} {y - 5:.1f}l10 10m0 -10l-10 10")

    def circle(self, style: str, x: float, y: float, radius: float, *, opacity: float = 1.0) -> None:
        through = "" if opacity == 1.0 else f' opacity="{opacity:.2f}"'
        self.parts.append(f'<circle class="{style}" cx="{_px(x)}" cy="{_px(y)}" r="{radius:.3g}"{through}/>')

    def polyline(self, style: str, points: Points) -> None:
        self.parts.append(f'<polyline class="{style}" points="{_points(points)}"/>')

    def polygon(self, style: str, points: Points) -> None:
        self.parts.append(f'<polygon class="{style}" points="{_points(points)}"/>')

    def image(self, uri: str) -> None:
        """A picture as a data URI, as wide as the drawing."""
        self.parts.append(f'<image href="{uri}" x="0" y="0" width="{_px(self.width)}"/>')

    def svg(self) -> str:
        head = (
            f'<svg class="{self.style}" viewBox="0 0 {_px(self.width)} {_px(self.height)}" role="img" '
            f"aria-label={quoteattr(self.title)}>"
        )
        return head + "".join(self.parts) + "</svg>"


@dataclass(frozen=True, kw_only=True)
class Axes:
    """The part of a drawing that shows data: its margins [px], and the values at its edges."""

    drawing: Drawing
    left: float
    right: float
    top: float
    bottom: float
    x: tuple[float, float]
    """Value at the left and at the right edge."""
    y: tuple[float, float] = (0.0, 1.0)
    """Value at the lower and at the upper edge."""

    @property
    def width(self) -> float:
        return self.drawing.width - self.left - self.right

    @property
    def height(self) -> float:
        return self.drawing.height - self.top - self.bottom

    @property
    def floor(self) -> float:
        """Return the place of the lower edge [px]."""
        return self.top + self.height

    def px(self, value: float) -> float:
        return self.left + self.width * (value - self.x[0]) / (self.x[1] - self.x[0])

    def py(self, value: float) -> float:
        return self.floor - self.height * (value - self.y[0]) / (self.y[1] - self.y[0])

    def point(self, x: float, y: float) -> tuple[float, float]:
        return self.px(x), self.py(y)

    def across(self, style: str, value: float) -> None:
        """A line from edge to edge at this y."""
        self.drawing.path(style, f"M{_px(self.left)} {_px(self.py(value))}h{_px(self.width)}")

    def upright(self, style: str, value: float) -> None:
        """A line from edge to edge at this x."""
        self.drawing.path(style, f"M{_px(self.px(value))} {_px(self.top)}V{_px(self.floor)}")

    def y_ticks(self, ticks: Iterable[tuple[float, str]]) -> None:
        """A line and a label for each (value, text)."""
        for value, text in ticks:
            self.across("tick", value)
            self.drawing.text("label", self.left - 5, self.py(value) + 3.5, text, anchor="end")

    def windows(self, found: Iterable[tuple[float, float]]) -> None:
        """A band from edge to edge for each (first, last) value of x."""
        for start, stop in found:
            x, width = self.px(start), max(self.px(stop) - self.px(start), 0.8)
            self.drawing.parts.append(
                f'<rect class="window" x="{_px(x)}" y="{_px(self.top)}" width="{_px(width)}" '
                f'height="{_px(self.height)}"/>'
            )

    def peak(self, x: float, y: float, *, turn: float) -> None:
        """A point with its force [N], at the left of the point beyond a share ``turn`` of the width."""
        at, up = self.point(x, y)
        far = at > self.left + turn * self.width
        self.drawing.circle("peak", at, up, 2.6)
        anchor: Anchor = "end" if far else "start"
        self.drawing.text("label value", at + (-5 if far else 5), up - 4, f"{y:.1f} N", anchor=anchor)

    def x_labels(self, ticks: Iterable[tuple[float, str]], *, style: str = "label") -> None:
        for value, text in ticks:
            self.drawing.text(style, self.px(value), self.floor + 15, text, anchor="middle")


def nice_ticks(top: float, *, count: int) -> list[float]:
    """Return 2 to ``count`` + 1 multiples of 1, 2 or 5 times a power of ten from 0 up to ``top``, for count >= 3."""
    raw = top / count
    power = 10.0 ** math.floor(math.log10(raw))
    step = power * next(m for m in (1, 2, 5, 10) if m * power >= raw * (1 - 1e-9))
    return [round(i * step, 10) for i in range(int(top / step * (1 + 1e-9)) + 1)]


def with_unit(ticks: Sequence[float], unit: str) -> list[tuple[float, str]]:
    """Return each tick with its text; the last one names the unit."""
    return [(tick, f"{tick:g} {unit}" if tick == ticks[-1] else f"{tick:g}") for tick in ticks]


def _px(value: float) -> str:
    """Return the number to 0.1 pixel, without a trailing zero."""
    return f"{value:.1f}".removesuffix(".0")


def _points(points: Points) -> str:
    """Return the points to 0.1 pixel, without the inside of level stretches."""
    pairs = [(_px(x), _px(y)) for x, y in points]
    last = len(pairs) - 1
    kept = [pair for i, pair in enumerate(pairs) if i in (0, last) or not pairs[i - 1][1] == pair[1] == pairs[i + 1][1]]
    return " ".join(f"{x},{y}" for x, y in kept)


MAX_WIDTH = 640
MAX_BYTES = 90_000
"""Encoded size of one frame; seven tasks then stay under 0.9 MB of base64."""
QUALITIES = (85, 75, 60, 45, 30, 15)


def jpeg_data_uri(image: npt.NDArray[Any], *, max_width: int = MAX_WIDTH) -> str:
    """(H, W, 3) u1 RGB -> ``data:image/jpeg;base64,...``, at most ``max_width`` wide and MAX_BYTES long.

    Raises RecordingError on another shape or dtype, naming it.
    """
    from carecontact.pictures import jpeg, shrunk

    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or not image.size:
        raise RecordingError(f"stored frame has shape {image.shape} and dtype {image.dtype}; valid: (H, W, 3) uint8")
    data = b""
    for width, quality in product((max_width, max_width // 2), QUALITIES):
        data = jpeg(shrunk(image, width) if image.shape[1] > width else image, quality)
        if len(data) <= MAX_BYTES:
            break
    return "data:image/jpeg;base64," + base64.b64encode(data).decode()


def convex_hull(points: npt.NDArray[np.floating]) -> list[tuple[float, float]]:
    """Return the corners of the smallest convex polygon around (N, 2) points, in order (Andrew's monotone chain)."""
    ordered = sorted({(float(x), float(y)) for x, y in points})
    sides: list[list[tuple[float, float]]] = []
    for chain in (ordered, ordered[::-1]):
        side: list[tuple[float, float]] = []
        for point in chain:
            while len(side) > 1 and _turns(side[-2], side[-1], point) <= 0:
                side.pop()
            side.append(point)
        sides.append(side[:-1])
    return sides[0] + sides[1] or ordered


def _turns(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    """Positive where the way from a over b to c turns from x toward y."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def in_convex(point: tuple[float, float], hull: list[tuple[float, float]]) -> bool:
    """Whether a point lies in a polygon that ``convex_hull`` made, or on its border."""
    return all(_turns(a, b, point) >= 0 for a, b in zip(hull, hull[1:] + hull[:1], strict=True))


APART_PX = 0.7
"""Points of a drawn line that are nearer to each other than this look the same as one."""


def inside(points: npt.NDArray[np.float64], width: float, height: float) -> list[list[tuple[float, float]]]:
    """Return the parts of a line through (N, 2) points [px] inside the rectangle from (0, 0) to (width, height)."""
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
