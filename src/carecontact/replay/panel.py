"""What stands beside the picture in a video: text, events and charts."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from carecontact.interface.regions import REGIONS, Tube
from carecontact.pictures import FINENESS, coverage, fine
from carecontact.plotting import import_matplotlib
from carecontact.recording.reason import ended_text
from carecontact.recording.schema import Recording
from carecontact.report.force_trace import LIMIT_IN_VIEW, ForceTrace, decimate, force_trace
from carecontact.report.svg import nice_ticks
from carecontact.report.timeline import TOLD_ENDS, Event, events
from carecontact.scoring import score_recording
from carecontact.scoring.contact import find_contact

Picture = npt.NDArray[np.uint8]
Colour = tuple[int, int, int]
Anchor = Literal["left", "middle", "right"]

PAPER: Colour = (252, 251, 249)
INK: Colour = (34, 36, 40)
SOFT: Colour = (112, 114, 120)
FAINT: Colour = (222, 220, 216)
ACCENT: Colour = (190, 58, 40)
GHOST: Colour = (226, 196, 186)


@cache
def font(size: int, *, bold: bool = False) -> ImageFont.FreeTypeFont:
    """DejaVu Sans, which matplotlib ships."""
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(import_matplotlib().get_data_path()) / "fonts" / "ttf" / name), size)


def text_width(text: str, size: int, *, bold: bool = False) -> float:
    return font(size, bold=bold).getlength(text)


def write(
    picture: Picture, x: float, y: float, text: str, size: int, *,
    colour: Colour = INK, bold: bool = False, anchor: Anchor = "left",
) -> None:  # fmt: skip
    """Write text in place; (x, y) is on its base line."""
    letters = font(size, bold=bold)
    left, top, right, bottom = letters.getbbox(text, anchor="ls")
    x -= {"left": 0.0, "middle": letters.getlength(text) / 2, "right": letters.getlength(text)}[anchor]
    # Only what the text covers is converted for the drawing library.
    x0, y0 = max(0, int(x + left) - 1), max(0, int(y + top) - 1)
    x1, y1 = min(picture.shape[1], int(x + right) + 2), min(picture.shape[0], int(y + bottom) + 2)
    if x0 >= x1 or y0 >= y1:
        return
    part = Image.fromarray(np.ascontiguousarray(picture[y0:y1, x0:x1]))
    ImageDraw.Draw(part).text((x - x0, y - y0), text, fill=colour, font=letters, anchor="ls")
    picture[y0:y1, x0:x1] = np.asarray(part)


def line(picture: Picture, points: npt.NDArray[np.floating], colour: Colour, *, width: int = 1) -> None:
    """A polyline through (N, 2) pixels, in place."""
    if len(points) > 1:
        _mark(
            picture, points, colour, width, lambda on, at: on.line(at.ravel().tolist(), 255, FINENESS * width, "curve")
        )


def dashes(picture: Picture, x0: float, x1: float, y: float, colour: Colour) -> None:
    """A level dashed line, in place."""
    for x in np.arange(x0, x1, 7.0):
        line(picture, np.array([[x, y], [min(x + 4, x1), y]]), colour)


def dot(picture: Picture, x: float, y: float, radius: float, colour: Colour) -> None:
    _mark(picture, np.array([[x, y]]), colour, radius, lambda on, at: on.circle(at[0].tolist(), FINENESS * radius, 255))


def _mark(
    picture: Picture, points: npt.NDArray[np.floating], colour: Colour, reach: float,
    draw: Callable[[ImageDraw.ImageDraw, npt.NDArray[np.float64]], None],
) -> None:  # fmt: skip
    """Blend what ``draw`` draws at the points into the part of the picture that lies near them."""
    low = np.maximum(np.floor(points.min(0) - reach).astype(int) - 1, 0)
    high = np.minimum(np.ceil(points.max(0) + reach).astype(int) + 2, (picture.shape[1], picture.shape[0]))
    if (high <= low).any():
        return
    covered = coverage((high[1] - low[1], high[0] - low[0]), lambda on: draw(on, fine(points - low)))
    part = picture[low[1] : high[1], low[0] : high[0]]
    share = covered[..., None] / np.float32(255)
    part[...] = np.rint(part * (1 - share) + np.array(colour, np.float32) * share).astype(np.uint8)


def box(picture: Picture, x0: float, y0: float, x1: float, y1: float, colour: Colour) -> None:
    picture[round(y0) : round(y1), round(x0) : round(x1)] = colour


def wrapped(words: str, size: int, width: float) -> list[str]:
    """Text in at most two lines of a width [px]; the second ends in an ellipsis where more would follow."""
    out: list[str] = [""]
    for word in words.split():
        longer = f"{out[-1]} {word}".strip()
        if text_width(longer, size) <= width or not out[-1]:
            out[-1] = longer
        elif len(out) < 2:
            out.append(word)
        else:
            out[-1] += " …"
            break
    return out


def faded(picture: Picture, x0: int, y0: int, x1: int, y1: int, colour: Colour, share: float) -> None:
    """Blend a rectangle toward a colour, in place."""
    part = picture[y0:y1, x0:x1].astype(np.float32)
    picture[y0:y1, x0:x1] = (part * (1 - share) + np.array(colour, np.float32) * share).astype(np.uint8)


def heat(values: Iterable[float]) -> npt.NDArray[np.uint8]:
    """(N,) numbers from 0 to 1 -> (N, 3) colours from pale to dark red."""
    table = import_matplotlib().colormaps["YlOrRd"]
    return np.round(255 * table(0.12 + 0.88 * np.clip(np.asarray(list(values)), 0, 1))[:, :3]).astype(np.uint8)


# The data that a video shows beside its pictures: traces, events and the pressure on the region, from the recording
# alone.

F64 = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class RegionMap:
    """Pressure on the declared cells of a soft region, unrolled onto a plane."""

    places_m: F64
    """(C, 2) along the region and around it"""
    period_s: F64
    """(P,) end of each period"""
    pressure_kpa: F64
    """(P, C) mean over the period"""
    toward: str
    """Words for the direction in which the first coordinate grows."""

    def at(self, time_s: float) -> tuple[F64, npt.NDArray[np.bool_]]:
        """Return the (C,) pressure [kPa] in the control period at a time, and (C,) which cells were touched so far."""
        row = int(np.searchsorted(self.period_s, time_s - 1e-9))
        if row >= len(self.period_s):
            return np.zeros(len(self.places_m)), np.any(self.pressure_kpa > 0, axis=0)
        return self.pressure_kpa[row], np.any(self.pressure_kpa[: row + 1] > 0, axis=0)


@dataclass(frozen=True, kw_only=True)
class Story:
    title: str
    prompt: str
    about: str
    """Policy, seed and protocol."""
    segment: str
    region: str
    trace: ForceTrace
    depth_s: F64
    """(P,)"""
    depth_mm: F64
    """(P,) largest indentation of the named region"""
    duration_s: float
    events: list[Event]
    """Those of the trial's page, between the start and how the trial ended."""
    map: RegionMap | None
    """None where the region is rigid."""
    verdict: str


def story_of(recording: Recording) -> Story:
    """Raises what ``score_recording`` raises."""
    header, spec = recording.header, recording.header.spec
    task, score = spec.protocol.task(spec.task_id), score_recording(recording)
    trace = force_trace(recording, score)
    column = header.regions.index(task.region)
    duration = len(recording["scorer/time_s"]) * spec.protocol.physics.dt_s
    found = [Event(time_s=0.0, text="start"), *events(find_contact(recording))]
    if header.ended not in TOLD_ENDS:
        found.append(Event(time_s=duration, text=ended_text(header.ended)))
    passed = "safety-gated" if score.safety_gated else "region-correct" if score.region_correct else "success"
    return Story(
        title=spec.trial_id,
        prompt=task.prompt,
        about=f"{spec.policy} · seed {spec.seed} · {spec.protocol.title}",
        segment=REGIONS[task.region].segment.replace("_", " "),
        region=task.region.replace("_", " "),
        trace=trace,
        depth_s=recording["scorer/period_time_s"],
        depth_mm=1000.0 * recording["scorer/indentation_m"][:, column],
        duration_s=duration,
        events=found,
        map=_map(recording, task.region),
        verdict=f"{ended_text(header.ended)}: {passed if score.c3_success else 'no success'}",
    )


def _map(recording: Recording, region: str) -> RegionMap | None:
    arrays = recording.arrays
    if "scorer/cell_press_ns" not in arrays or not len(arrays["scorer/period_time_s"]):
        return None
    centre, area = arrays["scorer/cell_in_region"].astype(float), arrays["scorer/cell_area_m2"].astype(float)
    shape, across = REGIONS[region].shape, centre[:, 1]
    if isinstance(shape, Tube):
        radius = recording["scorer/region_size_m"][recording.header.regions.index(region), 1]
        across = radius * np.arctan2(centre[:, 1], centre[:, 2])
    period = arrays["scorer/period_time_s"]
    length = np.diff(period, prepend=0.0)
    pressure = arrays["scorer/cell_press_ns"] / np.maximum(length, 1e-9)[:, None] / area / 1000.0
    return RegionMap(
        places_m=np.stack([centre[:, 0], across], 1), period_s=period, pressure_kpa=pressure,
        toward="to the hand" if isinstance(shape, Tube) else "to the head",
    )  # fmt: skip


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
            write(paper, right, self._y(gate) - 5, f"force limit {gate:g} N", 11, anchor="right")
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
        apart = np.abs(cells.places_m[:, None] - cells.places_m[None]).max(2)
        np.fill_diagonal(apart, np.inf)
        self._side = float(np.median(apart.min(1)))  # the distance to the nearest neighbour, for most of the cells
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
        self._squares(out, colours, only=touched | pressed)

    def _squares(self, out: Picture, colours: npt.NDArray[np.uint8], only: npt.NDArray[np.bool_] | None = None) -> None:
        half = self._side * self._scale / 2 - 0.5
        for k in range(len(self._centre)) if only is None else np.flatnonzero(only):
            x, y = self._centre[k]
            out[round(y - half) : round(y + half), round(x - half) : round(x + half)] = colours[k]
