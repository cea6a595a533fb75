"""Force over time as a small figure.

Classes used: ``axis``, ``tick``, ``window``, ``target``, ``other``, ``gate``, ``pain``, ``peak``, ``label``, ``value``.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from carecontact.recording.schema import Recording
from carecontact.report.svg import Axes, Drawing, nice_ticks, with_unit
from carecontact.scoring.contact import Contact, find_contact, runs
from carecontact.scoring.result import TrialScore

Floats = npt.NDArray[np.float64]
LIMIT_IN_VIEW = 0.25
"""A limit is drawn once the force comes this close to it; before, it would only flatten the trace."""
LINE_PX = 10.5
"""Height of a line of small text."""


@dataclass(frozen=True, kw_only=True)
class Limit:
    """A limit of one segment."""

    style: Literal["gate", "pain"]
    segment: str
    value_n: float
    largest_n: float
    """Largest force on the segment."""

    @property
    def in_view(self) -> bool:
        return self.largest_n >= LIMIT_IN_VIEW * self.value_n


@dataclass(frozen=True, kw_only=True)
class ForceTrace:
    """T samples of one trial. Norms of region forces [N]."""

    time_s: Floats
    """(T,)"""
    target_n: Floats
    """(T,) on the named region's segment"""
    other_n: Floats
    """(T,) largest over all other segments"""
    windows_s: list[tuple[float, float]]
    """Contact window of the reported segment."""
    gate_n: float
    """Largest force that the named region's segment may bear [N] (``Protocol.most_n``)."""
    limits: tuple[Limit, ...]
    """Limits of every segment that is drawn; those of the named region's segment come first, if it was touched."""
    peak_s: float | None
    """Time of the peak that C1 reports [s]."""
    peak_n: float | None

    @property
    def is_touched(self) -> bool:
        return bool(self.target_n.any() or self.other_n.any())


def force_trace(recording: Recording, score: TrialScore) -> ForceTrace:
    contact = find_contact(recording)
    protocol, segment = contact.protocol, contact.segments[contact.target]
    peak_s = None
    if score.c1_peak_force_n is not None and contact.reported is not None:
        inside = np.where(contact.window, contact.force_norm[:, contact.reported], -1.0)
        peak_s = float(contact.time_s[inside.argmax()])
    return ForceTrace(
        time_s=contact.time_s,
        target_n=contact.force_norm[:, contact.target],
        other_n=np.delete(contact.force_norm, contact.target, axis=1).max(axis=1, initial=0.0),
        windows_s=[
            (float(contact.time_s[start] - contact.dt_s), float(contact.time_s[stop - 1]))
            for start, stop in runs(contact.window)
        ],
        gate_n=protocol.most_n(contact.task.action, segment),
        limits=_limits(contact),
        peak_s=peak_s,
        peak_n=score.c1_peak_force_n,
    )


def _limits(contact: Contact) -> tuple[Limit, ...]:
    """Return the limits of the named region's segment, and of the other segment that came nearest to its own. A segment
    that was never touched has none, unless no segment was touched."""
    protocol, action = contact.protocol, contact.task.action
    largest = contact.force_norm.max(axis=0, initial=0.0)
    drawn = [contact.target] if largest[contact.target] or not largest.any() else []
    others = [i for i in np.flatnonzero(largest).tolist() if i != contact.target]
    if others:
        drawn.append(max(others, key=lambda i: largest[i] / protocol.most_n(action, contact.segments[i])))
    limits: list[Limit] = []
    for i in drawn:
        name = contact.segments[i]
        of_segment = {"segment": name.replace("_", " "), "largest_n": largest[i]}
        limits.append(Limit(style="gate", value_n=protocol.most_n(action, name), **of_segment))
        limits.append(Limit(style="pain", value_n=protocol.f_pain(name), **of_segment))
    return tuple(limits)


def decimate(x: Floats, y: Floats, *, buckets: int) -> tuple[Floats, Floats]:
    """(T,), (T,) -> at most 2 * buckets points, among them each bucket's minimum and maximum: no peak is lost."""
    if x.size <= 2 * buckets:
        return x, y
    edges = np.linspace(0, x.size, buckets + 1).astype(int)
    ends = [(low + y[low:high].argmin(), low + y[low:high].argmax()) for low, high in itertools.pairwise(edges)]
    index = np.unique(ends)
    return x[index], y[index]


def trace_svg(trace: ForceTrace, *, title: str) -> str:
    """Return one panel of at least one sample; ``title`` is the text alternative."""
    largest = max(float(trace.target_n.max(initial=0.0)), float(trace.other_n.max(initial=0.0)))
    in_view = [limit for limit in trace.limits if limit.in_view]
    y_top, x_top = 1.18 * max([largest, 1.0, *(limit.value_n for limit in in_view)]), float(trace.time_s[-1])
    drawing = Drawing(width=360, height=168, style="trace", title=title)
    # The right margin holds the names of the limits, so that they never cover the trace.
    axes = Axes(drawing=drawing, left=40, right=92, top=10, bottom=20, x=(0.0, x_top), y=(0.0, y_top))
    axes.windows(trace.windows_s)
    axes.y_ticks(with_unit(nice_ticks(y_top, count=4), "N"))
    axes.x_labels(with_unit(nice_ticks(x_top, count=5), "s"))
    axes.across("axis", 0.0)
    _draw_limits(axes, in_view, trace.limits)
    for style, values in (("other", trace.other_n), ("target", trace.target_n)):
        if style == "target" or values.any():
            kept = decimate(trace.time_s, values, buckets=int(axes.width))
            drawing.polyline(style, [axes.point(t, n) for t, n in zip(*(k.tolist() for k in kept), strict=True)])
    if trace.peak_s is not None and trace.peak_n is not None:
        axes.peak(trace.peak_s, trace.peak_n, turn=0.7)
    return drawing.svg()


def _draw_limits(axes: Axes, in_view: Sequence[Limit], limits: Sequence[Limit]) -> None:
    """Each line has its name and its segment at the right, in two lines; names that would overlap move down."""
    right, free = axes.left + axes.width + 5, axes.top + 4
    if limits and not any(limit.style == "gate" for limit in in_view):
        axes.drawing.text("label gate", right, free, f"limit {limits[0].value_n:g} ↑")
        axes.drawing.text("label", right, free + LINE_PX, limits[0].segment)
        free += 2 * LINE_PX
    for limit in sorted(in_view, key=lambda limit: -limit.value_n):
        axes.across(limit.style, limit.value_n)
        y = max(axes.py(limit.value_n) + 3.5, free)
        axes.drawing.text(
            f"label {limit.style}", right, y, f"{'limit' if limit.style == 'gate' else limit.style} {limit.value_n:g}"
        )
        axes.drawing.text("label", right, y + LINE_PX, limit.segment)
        free = y + 2 * LINE_PX
