"""The charts beside a film's pictures: readings, the force over time, and the pressure on the region."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from carecontact.replaying.film.ink import (
    ACCENT,
    FAINT,
    GHOST,
    INK,
    PAPER,
    SOFT,
    Picture,
    box,
    dashes,
    dot,
    heat,
    line,
    text_width,
    wrapped,
    write,
)
from carecontact.replaying.film.story import RegionMap, Story
from carecontact.reports.page.force_trace import LIMIT_IN_VIEW, decimate
from carecontact.reports.svg import nice_ticks

WIDTH, HEIGHT, MARGIN = 440, 720, 30
CHART = (74, 246, WIDTH - MARGIN, 396)
"""Left, top, right and bottom of the force's axes [px]."""
MAP = (MARGIN, 466, WIDTH - MARGIN, 632)
UNTOUCHED, TOUCHED = (236, 234, 230), (243, 222, 203)
LEAST_KPA = 0.05
"""Pressures below this are drawn like no pressure [kPa]."""


class Panel:
    """The charts of one trial. What does not change is drawn once, and each frame adds the values at its time."""

    def __init__(self, story: Story, *, note: str) -> None:
        """``note``: one line below the charts."""
        self._story = story
        trace = story.trace
        self._time_s, self._force_n = decimate(trace.time_s, trace.target_n, buckets=700)
        top = max(float(self._force_n.max(initial=0.0)), float(trace.other_n.max(initial=0.0)), 1.0)
        if top >= LIMIT_IN_VIEW * trace.gate_n:
            top = max(top, trace.gate_n)
        self._top_n = 1.12 * top
        self._paper = np.full((HEIGHT, WIDTH, 3), PAPER, np.uint8)
        self._head(note)
        self._axes()
        self._map = None if story.map is None else _CellMap(story.map)
        if self._map is None:
            write(self._paper, MAP[0], MAP[1] - 20, f"Pressure on the {story.region}", 13, bold=True)
            write(self._paper, MAP[0], MAP[1] + 8, "not recorded: this region is rigid", 13, colour=SOFT)
        else:
            self._map.base(self._paper, story.region)

    def _head(self, note: str) -> None:
        paper, story = self._paper, self._story
        write(paper, MARGIN, 44, story.title, 22, bold=True)
        for row, words in enumerate(wrapped(f"“{story.prompt}”", 15, WIDTH - 2 * MARGIN)):
            write(paper, MARGIN, 72 + 21 * row, words, 15)
        for row, words in enumerate(wrapped(story.about, 12, WIDTH - 2 * MARGIN)):
            write(paper, MARGIN, 114 + 15 * row, words, 12, colour=SOFT)
        for x, label in zip(COLUMNS, ("time", "force", "indentation"), strict=True):
            write(paper, x, 152, label, 12, colour=SOFT)
        write(paper, MARGIN, HEIGHT - 14, note, 11, colour=SOFT)

    def _axes(self) -> None:
        paper, (left, top, right, bottom) = self._paper, CHART
        write(paper, MARGIN, top - 16, f"Force on the {self._story.segment} [N]", 13, bold=True)
        for start, stop in self._story.trace.windows_s:
            box(paper, self._x(start), top, max(self._x(stop), self._x(start) + 1), bottom, (244, 241, 235))
        for tick in nice_ticks(self._top_n, count=4):
            y = self._y(tick)
            line(paper, np.array([[left, y], [right, y]]), FAINT)
            write(paper, left - 8, y + 4, f"{tick:g}", 12, colour=SOFT, anchor="right")
        ticks = nice_ticks(self._story.duration_s, count=5)
        for tick in ticks:
            unit = " s" if tick == ticks[-1] else ""
            write(paper, self._x(tick), bottom + 19, f"{tick:g}{unit}", 12, colour=SOFT, anchor="middle")
        gate = self._story.trace.gate_n
        if gate <= self._top_n:
            dashes(paper, left, right, self._y(gate), INK)
            write(paper, right, self._y(gate) - 5, f"safety gate {gate:g} N", 11, anchor="right")
        line(paper, self._points(len(self._time_s)), GHOST, width=2)

    def at(self, time_s: float) -> Picture:
        """(HEIGHT, WIDTH, 3)"""
        out, story = self._paper.copy(), self._story
        force = float(np.interp(time_s, story.trace.time_s, story.trace.target_n))
        row = min(int(np.searchsorted(story.depth_s, time_s - 1e-9)), len(story.depth_s) - 1)
        depth = float(story.depth_mm[row]) if row >= 0 else 0.0
        for x, number, unit in zip(
            COLUMNS, (f"{time_s:.2f}", f"{force:.1f}", f"{depth:.1f}"), ("s", "N", "mm"), strict=True
        ):
            write(out, x, 184, number, 27, bold=True)
            write(out, x + text_width(number, 27, bold=True) + 5, 184, unit, 14, colour=SOFT)
        shown = int(np.searchsorted(self._time_s, time_s, side="right"))
        line(out, self._points(shown), ACCENT, width=2)
        x, (_, top, _, bottom) = self._x(time_s), CHART
        line(out, np.array([[x, top], [x, bottom]]), INK)
        dot(out, x, self._y(min(force, self._top_n)), 4.0, ACCENT)
        for event in story.events:
            if event.time_s <= time_s:
                dot(out, self._x(event.time_s), bottom, 3.0, INK)
        if self._map is not None:
            self._map.draw(out, time_s)
        return out

    def _points(self, count: int) -> npt.NDArray[np.float64]:
        return np.stack([self._x(self._time_s[:count]), self._y(self._force_n[:count])], 1)

    def _x(self, time_s: Any) -> Any:
        return CHART[0] + (CHART[2] - CHART[0]) * time_s / self._story.duration_s

    def _y(self, force_n: Any) -> Any:
        return CHART[3] - (CHART[3] - CHART[1]) * force_n / self._top_n


COLUMNS = (MARGIN, MARGIN + 138, MARGIN + 262)


class _CellMap:
    """The cells as squares on a plane."""

    def __init__(self, cells: RegionMap) -> None:
        self._cells = cells
        self._top_kpa = max(float(cells.pressure_kpa.max()), 1.0)
        low, high = cells.places_m.min(0), cells.places_m.max(0)
        left, top, right, bottom = MAP
        self._side = _spacing(cells.places_m)
        wide, tall = high - low + self._side
        self._scale = min((right - left) / wide, (bottom - top) / tall)
        offset = (cells.places_m - (low + high) / 2) * self._scale
        self._centre = np.stack([(left + right) / 2 + offset[:, 0], (top + bottom) / 2 - offset[:, 1]], 1)

    def base(self, paper: Picture, region: str) -> None:
        write(paper, MAP[0], MAP[1] - 20, f"Pressure on the {region} [kPa]", 13, bold=True)
        self._squares(paper, np.tile(np.array(UNTOUCHED, np.uint8), (len(self._centre), 1)))
        y, left, right = MAP[3] + 24, MAP[0] + 4, MAP[0] + 164
        bar = heat(np.linspace(0, 1, right - left))
        paper[y : y + 8, left:right] = bar[None]
        write(paper, left, y + 22, "0", 11, colour=SOFT, anchor="middle")
        write(paper, right, y + 22, f"{self._top_kpa:.0f}", 11, colour=SOFT, anchor="middle")
        write(paper, MAP[2], y + 9, f"{self._cells.toward} →", 12, colour=SOFT, anchor="right")

    def draw(self, out: Picture, time_s: float) -> None:
        pressure, touched = self._cells.at(time_s)
        colours = np.where(touched[:, None], np.array(TOUCHED, np.uint8), np.array(UNTOUCHED, np.uint8))
        pressed = pressure > LEAST_KPA
        colours[pressed] = heat(pressure[pressed] / self._top_kpa)
        changed = touched | pressed
        self._squares(out, colours, only=changed)

    def _squares(self, out: Picture, colours: npt.NDArray[np.uint8], only: npt.NDArray[np.bool_] | None = None) -> None:
        half = self._side * self._scale / 2 - 0.5
        for k in range(len(self._centre)) if only is None else np.flatnonzero(only):
            x, y = self._centre[k]
            out[round(y - half) : round(y + half), round(x - half) : round(x + half)] = colours[k]


def _spacing(places: npt.NDArray[np.float64]) -> float:
    """Distance to the nearest neighbour, for most of the cells."""
    apart = np.abs(places[:, None] - places[None]).max(2)
    np.fill_diagonal(apart, np.inf)
    return float(np.median(apart.min(1)))
