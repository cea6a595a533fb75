"""The time course of a trial as a figure, with what happened in it and when."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from carecontact.recording.reason import reason_of
from carecontact.recording.schema import ARRAYS, OPTIONAL_ARRAYS, EndReason, Recording, dimensions
from carecontact.report.force_trace import ForceTrace, Limit, decimate
from carecontact.report.moment import region_column
from carecontact.report.skin_view import Paths
from carecontact.report.svg import Axes, Drawing, inside, nice_ticks, with_unit
from carecontact.scoring.contact import Contact, find_contact
from carecontact.scoring.metrics.success import judge

TENSE_S = 0.1
"""Time before the recorded onset of a movement at which the person's muscles begin to tense [s] (RISE in
``tissue/c/life.c``)."""
TOLD_ENDS: dict[EndReason, str] = {
    "safety_truncation": "cut by the benchmark",
    "process_failure": "the policy crashed",
    "time_limit": "time limit",
}
"""The ends of a trial that are events. A policy that is done, and a harness that fails, do nothing to the person."""


@dataclass(frozen=True, kw_only=True)
class Event:
    time_s: float
    text: str


def events(contact: Contact) -> list[Event]:
    """Return the events of a trial in the order of time. A sensor's time is that at which its physics step began."""
    header = contact.recording.header
    if not len(contact.time_s):
        return []
    found = _faint(contact) if contact.reported is None else []
    for name, on in zip(contact.segments, contact.on.T, strict=True):
        if on.any():
            text = f"first contact with the {name.replace('_', ' ')}"
            found.append(Event(time_s=contact.time_s[int(on.argmax())], text=text))
    if (passed := gate_met_s(contact)) is not None:
        found.append(Event(time_s=passed, text=f"gate of {contact.task.action} met"))
    if contact.reported is not None and contact.window.any():
        inside = np.where(contact.window, contact.force_norm[:, contact.reported], -1.0)
        name = contact.segments[contact.reported].replace("_", " ")
        text = f"peak force, {inside.max():.1f} N on the {name}"
        found.append(Event(time_s=contact.time_s[int(inside.argmax())], text=text))
    found += _of_the_person(contact.recording)
    if header.ended in TOLD_ENDS:
        cut = header.failure if header.ended == "safety_truncation" else None
        why = "" if cut is None else f": {reason_of(cut)}"
        found.append(Event(time_s=contact.time_s[-1], text=f"{TOLD_ENDS[header.ended]}{why}"))
    return [replace(event, time_s=float(event.time_s)) for event in sorted(found, key=lambda event: event.time_s)]


def _faint(contact: Contact) -> list[Event]:
    """Return when a press began that was too light to count as contact, and its largest force."""
    felt = (contact.force_norm > 0).any(axis=1)
    if not felt.any():
        return []
    step, segment = np.unravel_index(int(contact.force_norm.argmax()), contact.force_norm.shape)
    name, least = contact.segments[int(segment)].replace("_", " "), contact.protocol.contact.on_n
    largest = f"largest force, {contact.force_norm[step, segment]:.1f} N on the {name}"
    return [
        Event(time_s=contact.time_s[int(felt.argmax())], text=f"first force, below the {least:g} N that contact needs"),
        Event(time_s=contact.time_s[int(step)], text=largest),
    ]


def _of_the_person(recording: Recording) -> list[Event]:
    """Return what the person did by itself, as far as it came before the trial's end."""
    end = float(recording["scorer/time_s"][-1])
    times, turns = (recording.arrays.get(f"scorer/repositioning_{unit}", np.zeros(0)) for unit in ("s", "rad"))
    found: list[Event] = []
    for time_s, turn in zip(times, turns, strict=True):
        way = f"{abs(np.degrees(turn)):.0f}° {'away from' if turn > 0 else 'toward'} the trunk"
        found.append(
            Event(time_s=max(0.0, float(time_s) - TENSE_S), text=f"the person begins to turn the arm by {way}")
        )
    withdrawn = recording.arrays.get("scorer/withdrawal_s", np.zeros(0))
    found += [Event(time_s=float(t), text="the person withdraws the arm") for t in withdrawn if t >= 0]
    return [event for event in found if event.time_s <= end]


def gate_met_s(contact: Contact) -> float | None:
    """Return when a trial that is a success became one [s], exact to a few hundredths: some progress is filtered.

    Where a gate has an upper end, a trial can pass, fail and pass again: one of the moments at which it began to pass.
    """
    if not judge(contact).success:
        return None
    fails, passes = 0, len(contact.time_s)
    while passes - fails > 1:
        middle = (fails + passes) // 2
        if judge(find_contact(_beginning(contact.recording, middle))).success:
            passes = middle
        else:
            fails = middle
    return float(contact.time_s[passes - 1])


def _beginning(recording: Recording, steps: int) -> Recording:
    """Return the recording's first physics steps; no gate reads arrays over other units of time, which stay whole."""
    described = ARRAYS | {path: row for path, row in OPTIONAL_ARRAYS.items() if path in recording.arrays}
    cut = {path: recording[path][:steps] for path in described if dimensions(path)[0] == "T"}
    return replace(recording, arrays={**recording.arrays, **cut})


# Force, depth, speed, and the commanded against the reached pose of one trial, on one time axis with its events.
#
# Classes used: those of ``reports.page.force_trace``, and ``line``, ``commanded``, ``cut``, ``event``, ``mark``,
# ``look``.

F64 = npt.NDArray[np.float64]
WIDTH, LEFT, RIGHT, HEAD = 640, 52, 12, 32
PANEL, TITLE, FOOT = 74, 22, 22
"""Heights of a panel, of the line above it that says what it shows, and of the labels of time below all of them."""
NO_EVENTS_HEAD = 4
"""Takes the place of HEAD, which has room for the letters of events, where there is no event."""
OUT_M = 0.25
"""Places farther from the region's middle than this are cut off: far away, what matters at the skin would be flat."""
EDGE_PX = 0.5
"""A part of a curve that begins or ends so near to the upper or lower edge of its panel is cut there."""

LIMIT_NAMES = {"gate": "force limit", "pain": "pain limit"}


@dataclass(frozen=True)
class Curve:
    style: str
    time_s: F64
    values: F64


@dataclass(frozen=True, kw_only=True)
class Panel:
    title: str
    curves: tuple[Curve, ...]
    low: float
    high: float
    lines: tuple[Limit, ...] = ()
    at_right: str = ""
    """The segment whose limits have their names at the right end."""
    is_cut: bool = False
    """Whether a curve goes on beyond the panel."""
    above: str = ""
    """What lies above the panel, in words at its upper right."""
    peak: tuple[float, float] | None = None
    """Time [s] and value [N] of a point that is marked with its value."""


def timeline_svg(panels: Sequence[Panel], trace: ForceTrace, events: Sequence[Event], looks: Sequence[float]) -> str:
    """``looks``: when the policy was shown a new view, or of a policy without cameras, an observation [s]."""
    head = HEAD if events else NO_EVENTS_HEAD
    height = head + (TITLE + PANEL) * len(panels) + FOOT
    listing = "; ".join(f"{letter(i)}: {event.text} at {event.time_s:.2f} s" for i, event in enumerate(events))
    drawing = Drawing(width=WIDTH, height=height, style="timeline", title=f"Time course of the trial. {listing}")
    end = float(trace.time_s[-1]) or 1.0
    rows = [_axes(drawing, head + number * (TITLE + PANEL), panel, end) for number, panel in enumerate(panels)]
    for axes in rows:
        axes.windows(trace.windows_s)
    for axes, panel in zip(rows, panels, strict=True):
        _draw_panel(axes, panel)
    for time_s in looks:
        x = rows[-1].px(min(time_s, end))
        drawing.path("look", f"M{x:.1f} {rows[-1].floor:.1f}l-3 6h6z")
    rows[-1].x_labels(with_unit(nice_ticks(end, count=6), "s"))
    _draw_events(drawing, rows, events)
    return drawing.svg()


def letter(index: int) -> str:
    return chr(ord("A") + index % 26)


def _axes(drawing: Drawing, above: float, panel: Panel, end: float) -> Axes:
    """``above``: upper edge of the line that says what the panel shows [px]."""
    top = above + TITLE
    return Axes(
        drawing=drawing, left=LEFT, right=RIGHT, top=top, bottom=drawing.height - top - PANEL, x=(0.0, end),
        y=(panel.low, panel.high),
    )  # fmt: skip


def _draw_panel(axes: Axes, panel: Panel) -> None:
    drawing = axes.drawing
    drawing.text("name", axes.left, axes.top - 7, panel.title)
    axes.y_ticks((value, f"{value:g}") for value in ticks(panel.low, panel.high))
    if panel.low <= 0:
        axes.across("axis", 0.0)
    for limit in panel.lines:
        axes.across(limit.style, limit.value_n)
    outside = [c for c in panel.curves if not ((c.values >= panel.low) & (c.values <= panel.high)).any()]
    for row, curve in enumerate(outside):
        name = "commanded" if curve.style == "commanded" else "reached"
        note = f"{name}: farther than {1000 * OUT_M:g} mm throughout"
        drawing.text("label", axes.left + axes.width / 2, axes.top + 20 + 18 * row, note, anchor="middle")
    for curve in panel.curves:
        times, values = decimate(curve.time_s, curve.values, buckets=int(axes.width))
        points = np.array([axes.point(t, v) for t, v in zip(times.tolist(), values.tolist(), strict=True)])
        if panel.is_cut:
            _draw_inside(axes, curve.style, points)
        else:
            drawing.polyline(curve.style, points.tolist())
    for limit in panel.lines:
        # The names of the other segment's limits are at the left, where they do not meet those at the right.
        right = limit.segment == panel.at_right
        x, anchor = (axes.left + axes.width - 3, "end") if right else (axes.left + 3, "start")
        words = f"{LIMIT_NAMES[limit.style]} of the {limit.segment} {limit.value_n:g} N"
        drawing.text(f"label {limit.style} over", x, axes.py(limit.value_n) - 3, words, anchor=anchor)
    if panel.above:
        drawing.text("label gate", axes.left + axes.width, axes.top - 7, panel.above, anchor="end")
    if panel.peak is not None:
        axes.peak(*panel.peak, turn=0.85)


def _draw_inside(axes: Axes, style: str, points: F64) -> None:
    """The parts of a line, (N, 2) [px], that lie in the panel, with a triangle wherever it leaves the panel."""
    corner = np.array([axes.left, axes.top])
    for part in inside(points - corner, axes.width, axes.height):
        axes.drawing.polyline(style, (np.array(part) + corner).tolist())
        for x, y in (part[0], part[-1]):
            if y < EDGE_PX:
                axes.drawing.path("cut", f"M{axes.left + x - 4:.1f} {axes.top + 6:.1f}h8l-4 -6z")
            elif y > axes.height - EDGE_PX:
                axes.drawing.path("cut", f"M{axes.left + x - 4:.1f} {axes.floor - 6:.1f}h8l-4 6z")


def ticks(low: float, high: float) -> list[float]:
    """Return multiples of a round number from ``low`` to ``high``: two or more, and three or so."""
    steps = (nice_ticks(high - low, count=count)[1] for count in (3, 6))
    found = ([round(k * step, 10) for k in range(math.ceil(low / step), math.floor(high / step) + 1)] for step in steps)
    return next(row for row in found if len(row) > 1)


def _draw_events(drawing: Drawing, rows: Sequence[Axes], events: Sequence[Event]) -> None:
    """A line through all panels for each, and its letter above; letters that would overlap move to the right."""
    free = 0.0
    for i, event in enumerate(events):
        x = rows[0].px(event.time_s)
        drawing.path("event", f"M{x:.1f} {HEAD - 4}V{rows[-1].floor:.1f}")
        at = max(x, free)
        drawing.circle("mark", at, HEAD - 16, 11)
        drawing.text("letter", at, HEAD - 11, letter(i), anchor="middle")
        free = at + 25


def panels_of(recording: Recording, trace: ForceTrace, found: Paths | None) -> list[Panel]:
    """Return the panels that have something to show: without a touch, none of force and indentation."""
    panels = [_force_panel(trace)] if trace.is_touched else []
    depth = recording["scorer/indentation_m"][:, region_column(recording)].astype(np.float64)
    if found is not None and depth.any():
        panels.append(_positive("Indentation of the region [mm]", 2.0, found.time_s, 1000 * depth))
    speed = recording["scorer/tcp_speed"].astype(np.float64)
    panels.append(_positive("Speed of the tool [mm/s]", 20.0, trace.time_s, 1000 * speed))
    panels += _commanded_panels(recording)
    if found is not None:
        names = ("Along the region", "Across it", "Outward from its axis")
        panels += [_pose_panel(f"{name} [mm]", found, axis) for axis, name in enumerate(names)]
        apart = 1000 * np.linalg.norm(found.commanded_m - found.reached_m, axis=1)
        panels.append(_positive("Distance between commanded and reached place [mm]", 5.0, found.time_s, apart))
        turned = np.degrees(found.turned_rad)
        panels.append(_positive("Angle between commanded and reached orientation [°]", 2.0, found.time_s, turned))
    return panels


def _commanded_panels(recording: Recording) -> list[Panel]:
    """Return the feedforward that actions command, and the stiffness along the tool, which is its z axis; each only
    where a trial uses it. An action holds until the next."""
    wrench = recording.arrays.get("actions/wrench_in_tcp", np.zeros((0, 6)))
    stiffness = recording.arrays.get("actions/axis_stiffness", recording["actions/stiffness"])
    stiffness = stiffness[:, 2 if stiffness.shape[1] == 6 else 0]
    starts, end = recording["actions/time_s"].astype(np.float64), float(recording["scorer/time_s"][-1])

    def held(values: F64) -> tuple[F64, F64]:
        return np.repeat(np.append(starts, max(end, starts[-1])), 2)[1:-1], np.repeat(values.astype(np.float64), 2)

    panels: list[Panel] = []
    if wrench[:, :3].any():
        across = np.linalg.norm(wrench[:, :2], axis=1)
        drawn = {"line": wrench[:, 2], "commanded": across} if across.any() else {"line": wrench[:, 2]}
        curves = tuple(Curve(style, *held(values)) for style, values in drawn.items())
        low, high = min(0.0, float(wrench[:, 2].min())), max(1.0, float(wrench[:, 2].max()), float(across.max()))
        title = f"Feedforward along the tool{', dashed across it' if across.any() else ''} [N]"
        panels.append(Panel(title=title, curves=curves, low=1.08 * low, high=1.08 * high))
    if len(stiffness) and np.ptp(stiffness) > 0:
        panels.append(_positive("Stiffness along the tool [N/m]", 100.0, *held(stiffness)))
    return panels


def _force_panel(trace: ForceTrace) -> Panel:
    largest = max(float(trace.target_n.max(initial=0.0)), float(trace.other_n.max(initial=0.0)), 1.0)
    seen = [limit for limit in trace.limits if limit.in_view]
    drawn = {"other": trace.other_n, "target": trace.target_n} if trace.other_n.any() else {"target": trace.target_n}
    curves = tuple(Curve(style, trace.time_s, values) for style, values in drawn.items())
    gate = next((limit for limit in trace.limits if limit.style == "gate"), None)
    above = "" if gate is None or gate in seen else f"↑ force limit of the {gate.segment} {gate.value_n:g} N"
    peak = None if trace.peak_s is None or trace.peak_n is None else (trace.peak_s, trace.peak_n)
    top = 1.25 * max([largest, *(limit.value_n for limit in seen)])
    return Panel(title="Force [N]", curves=curves, low=0.0, high=top, lines=tuple(seen),
                 at_right=trace.limits[0].segment if seen else "", above=above, peak=peak)  # fmt: skip


def _positive(title: str, least: float, time_s: F64, values: F64) -> Panel:
    """Return a panel from 0 to the largest value, or to ``least`` if that is larger."""
    high = 1.08 * max(least, float(values.max(initial=0.0)))
    return Panel(title=title, curves=(Curve("line", time_s, values),), low=0.0, high=high)


def _pose_panel(title: str, found: Paths, axis: int) -> Panel:
    commanded, reached = (1000 * places[:, axis] for places in (found.commanded_m, found.reached_m))
    both, out = np.concatenate([commanded, reached]), 1000 * OUT_M
    low, high = (float(np.clip(end, -out, out)) for end in (both.min(), both.max()))
    room = 0.06 * max(high - low, 10.0)
    cut = both.min() < -out or both.max() > out
    curves = (Curve("line", found.time_s, reached), Curve("commanded", found.time_s, commanded))
    return Panel(
        title=title, curves=curves, is_cut=bool(cut), low=low - room * (low > -out), high=high + room * (high < out),
    )  # fmt: skip
