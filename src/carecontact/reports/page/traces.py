"""Force over time as inline SVG, drawn directly: small, byte-stable, coloured by the page's style sheet.

Classes used: ``axis``, ``tick``, ``window``, ``target``, ``other``, ``gate``, ``pain``, ``peak``, ``label``.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from xml.sax.saxutils import escape, quoteattr

import numpy as np
import numpy.typing as npt

from carecontact.recording.schema import Recording
from carecontact.scoring.contact import find_contact, runs
from carecontact.scoring.result import TrialScore

Floats = npt.NDArray[np.float64]

WIDTH, HEIGHT = 360, 168
LEFT, RIGHT, TOP, BOTTOM = 40, 66, 10, 20
"""Margins [px]; the right one holds the names of the limits, so that they never cover the trace."""
LIMIT_IN_VIEW = 0.25
"""A limit is drawn once the force comes this close to it; before, it would only flatten the trace."""


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
    pain_n: float
    peak_s: float | None
    """Of the peak that C1 reports."""
    peak_n: float | None


def force_trace(recording: Recording, score: TrialScore) -> ForceTrace:
    """The trace of a trial against the limits of its named region, with the scorer's own contact window."""
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
        gate_n=protocol.limits.gamma * protocol.f_pain(segment),
        pain_n=protocol.f_pain(segment),
        peak_s=peak_s,
        peak_n=score.c1_peak_force_n,
    )


def decimate(x: Floats, y: Floats, *, buckets: int) -> tuple[Floats, Floats]:
    """(T,), (T,) -> at most 2 * buckets points that keep each bucket's minimum and maximum, in order.

    No peak is lost, however short, which plain striding cannot promise.
    """
    if x.size <= 2 * buckets:
        return x, y
    keep: set[int] = set()
    edges = np.linspace(0, x.size, buckets + 1).astype(int)
    for low, high in itertools.pairwise(edges):
        keep.add(low + int(y[low:high].argmin()))
        keep.add(low + int(y[low:high].argmax()))
    index = np.array(sorted(keep))
    return x[index], y[index]


def nice_ticks(top: float, *, count: int) -> list[float]:
    """Multiples of 1, 2 or 5 times a power of ten from 0 up to ``top``: 2 to ``count`` + 1 of them, for count >= 3."""
    raw = top / count
    power = 10.0 ** math.floor(math.log10(raw))
    step = power * next(m for m in (1, 2, 5, 10) if m * power >= raw * (1 - 1e-9))
    return [round(i * step, 10) for i in range(int(top / step * (1 + 1e-9)) + 1)]


def trace_svg(trace: ForceTrace, *, title: str) -> str:
    """One panel, WIDTH x HEIGHT, of at least one sample; ``title`` is the text alternative and is escaped."""
    largest = max(float(trace.target_n.max(initial=0.0)), float(trace.other_n.max(initial=0.0)))
    shown = [limit for limit in (trace.gate_n, trace.pain_n) if largest >= LIMIT_IN_VIEW * limit]
    y_top = 1.18 * max([largest, 1.0, *shown])
    x_top = float(trace.time_s[-1])
    plot_w, plot_h = WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM

    def px(t: Floats | float) -> Floats:
        return LEFT + plot_w * np.asarray(t, np.float64) / x_top

    def py(n: Floats | float) -> Floats:
        return TOP + plot_h * (1 - np.asarray(n, np.float64) / y_top)

    out = [f'<svg class="trace" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label={quoteattr(title)}>']
    for start, end in trace.windows_s:
        x0, x1 = float(px(start)), float(px(end))
        out.append(f'<rect class="window" x="{x0:.1f}" y="{TOP}" width="{max(x1 - x0, 0.8):.1f}" height="{plot_h}"/>')
    bottom = TOP + plot_h
    levels = nice_ticks(y_top, count=4)
    for tick in levels:
        y = float(py(tick))
        text = f"{tick:g} N" if tick == levels[-1] else f"{tick:g}"
        out.append(f'<path class="tick" d="M{LEFT} {y:.1f}h{plot_w}"/>')
        out.append(f'<text class="label" x="{LEFT - 5}" y="{y + 3.5:.1f}" text-anchor="end">{text}</text>')
    moments = nice_ticks(x_top, count=5)
    for tick in moments:
        x = float(px(tick))
        text = f"{tick:g} s" if tick == moments[-1] else f"{tick:g}"
        out.append(f'<text class="label" x="{x:.1f}" y="{bottom + 14}" text-anchor="middle">{text}</text>')
    out.append(f'<path class="axis" d="M{LEFT} {bottom}h{plot_w}"/>')
    for name, limit in (("gate", trace.gate_n), ("pain", trace.pain_n)):
        if limit not in shown:
            continue
        y = float(py(limit))
        out.append(f'<path class="{name}" d="M{LEFT} {y:.1f}h{plot_w}"/>')
        out.append(f'<text class="label {name}" x="{LEFT + plot_w + 5}" y="{y + 3.5:.1f}">{name} {limit:g}</text>')
    if trace.gate_n not in shown:
        out.append(f'<text class="label gate" x="{LEFT + plot_w + 5}" y="{TOP + 4}">gate {trace.gate_n:g} ↑</text>')
    for name, values in (("other", trace.other_n), ("target", trace.target_n)):
        if name == "target" or values.any():
            x, y = decimate(trace.time_s, values, buckets=plot_w)
            out.append(f'<polyline class="{name}" points="{_points(px(x), py(y))}"/>')
    if not largest:
        out.append(
            f'<text class="label" x="{LEFT + plot_w / 2:g}" y="{bottom - 8}" text-anchor="middle">no force</text>'
        )
    if trace.peak_s is not None and trace.peak_n is not None:
        x, y = float(px(trace.peak_s)), float(py(trace.peak_n))
        anchor, dx = ("end", -5) if x > LEFT + 0.7 * plot_w else ("start", 5)
        out.append(f'<circle class="peak" cx="{x:.1f}" cy="{y:.1f}" r="2.6"/>')
        text = escape(f"{trace.peak_n:.1f} N")
        out.append(f'<text class="label value" x="{x + dx:.1f}" y="{y - 4:.1f}" text-anchor="{anchor}">{text}</text>')
    return "".join(out) + "</svg>"


def _points(x: Floats, y: Floats) -> str:
    """Polyline points to 0.1 px; the inside of a level stretch is left out."""
    pairs: Sequence[tuple[str, str]] = [(f"{a:.1f}", f"{b:.1f}") for a, b in zip(x, y, strict=True)]
    last = len(pairs) - 1
    kept = [pair for i, pair in enumerate(pairs) if i in (0, last) or not pairs[i - 1][1] == pair[1] == pairs[i + 1][1]]
    return " ".join(f"{a},{b}" for a, b in kept)
