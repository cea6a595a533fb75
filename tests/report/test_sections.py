from __future__ import annotations

import dataclasses
import re
from typing import Literal
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carecontact.protocol.load import load_protocol
from carecontact.report.force_trace import ForceTrace, Limit, decimate, force_trace, trace_svg
from carecontact.report.sections.gates import gamma_axes, gamma_svg, gate_panels, panel_axes
from carecontact.report.svg import nice_ticks
from tests.report.synthetic import FAILED, NO_CONTACT, PROTOCOL, make_recording, make_score, plateau

T = (np.arange(6000) + 1) * PROTOCOL.physics.dt_s


def classes(svg: str) -> list[str]:
    return [element.get("class", "") for element in ElementTree.fromstring(svg).iter()]


def made(target: np.ndarray, other: np.ndarray | None = None, **changes: object) -> ForceTrace:
    rows: list[tuple[Literal["gate", "pain"], float]] = [("gate", 35.0), ("pain", 100.0)]
    limits = tuple(
        Limit(style=style, segment="right forearm", value_n=value, largest_n=float(target.max()))
        for style, value in rows
    )
    base = ForceTrace(
        time_s=T, target_n=target, other_n=np.zeros_like(T) if other is None else other, windows_s=[(3.0, 9.0)],
        gate_n=35.0, limits=limits, peak_s=None, peak_n=None,
    )  # fmt: skip
    return dataclasses.replace(base, **changes)


@settings(deadline=None)
@given(st.integers(1, 5000), st.integers(1, 300), st.integers(0, 2**32 - 1))
def test_decimation_keeps_extremes_order_and_size(size: int, buckets: int, seed: int) -> None:
    y = np.random.default_rng(seed).normal(size=size)
    x = np.arange(size, dtype=np.float64)
    kept_x, kept_y = decimate(x, y, buckets=buckets)
    assert kept_y.max() == y.max()
    assert kept_y.min() == y.min()
    assert np.all(np.diff(kept_x) > 0)
    assert kept_x.size <= 2 * buckets
    assert np.array_equal(y[kept_x.astype(int)], kept_y)


def test_a_spike_of_one_sample_reaches_the_drawing() -> None:
    force = np.zeros_like(T)
    force[4321] = 80.0
    svg = trace_svg(made(force), title="x")
    points = re.search(r'class="target" points="([^"]+)"', svg)
    assert points
    heights = [float(p.split(",")[1]) for p in points[1].split()]
    gate = re.search(r'<path class="gate" d="M\S+ (\S+)h', svg)
    pain = re.search(r'<path class="pain" d="M\S+ (\S+)h', svg)
    assert gate
    assert pain
    assert float(pain[1]) < min(heights) < float(gate[1])
    bottom = max(heights)
    assert (bottom - min(heights)) / (bottom - float(pain[1])) == pytest.approx(0.8, abs=0.005)


@pytest.mark.parametrize(
    ("peak", "drawn"), [(2.0, []), (8.7, []), (8.8, ["gate"]), (24.9, ["gate"]), (25.0, ["gate", "pain"])]
)
def test_limits_are_drawn_once_the_force_comes_near(peak: float, drawn: list[str]) -> None:
    svg = trace_svg(made(plateau(T, start=3, end=9, level=peak, ripple=0)), title="x")
    lines = sorted(c for c in classes(svg) if c in ("gate", "pain"))
    assert lines == drawn
    assert "limit 35" in svg


def test_other_segments_are_drawn_only_when_touched() -> None:
    on_target = plateau(T, start=3, end=9, level=5, ripple=0)
    assert "other" not in classes(trace_svg(made(on_target), title="x"))
    assert "other" in classes(trace_svg(made(on_target, other=on_target / 2), title="x"))


def test_title_is_escaped() -> None:
    svg = trace_svg(made(np.zeros_like(T)), title='"><script>')
    assert "<script" not in svg
    assert ElementTree.fromstring(svg).get("aria-label") == '"><script>'


def test_trace_of_a_recording() -> None:
    target = plateau(T, start=3, end=9, level=10, ripple=0)
    target[2500] = 22.0
    hand = plateau(T, start=5, end=6, level=40, ripple=0)
    recording = make_recording("T1", 0, {"right_forearm": target, "right_hand": hand}, duration_s=12)
    trace = force_trace(recording, make_score("T1", 0, c1_peak_force_n=22.0))
    assert trace.target_n.max() == pytest.approx(22.0)
    assert trace.other_n.max() == pytest.approx(40.0)
    assert trace.gate_n == pytest.approx(35.0)
    assert trace.peak_s == T[2500]
    ((start, end),) = trace.windows_s
    assert (start, end) == (pytest.approx(3.0, abs=0.1), pytest.approx(9.0, abs=0.1))


def test_abdomen_has_its_own_limits_and_na_has_no_peak() -> None:
    recording = make_recording("T6", 0, {}, duration_s=2)
    trace = force_trace(recording, make_score("T6", 0, **NO_CONTACT))
    assert trace.gate_n == pytest.approx(21.0)
    assert trace.windows_s == []
    assert trace.peak_s is None
    assert not trace.is_touched


def test_off_target_trial_marks_the_peak_on_the_reported_segment() -> None:
    hand = plateau(T, start=5, end=6, level=9, ripple=0)
    hand[2700] = 11.0
    recording = make_recording("T1", 0, {"right_hand": hand}, duration_s=12)
    score = make_score("T1", 0, anatomy="off_target", reported_segment="right_hand", c1_peak_force_n=11.0)
    trace = force_trace(recording, score)
    assert not trace.target_n.any()
    assert trace.peak_s == T[2700]
    assert len(trace.windows_s) == 1


def test_each_limit_is_of_the_segment_that_is_drawn_and_named_on_its_line() -> None:
    """A trial that touched the pelvis alone shows the pelvis's limits; one that touched both shows both."""
    pelvis = plateau(T, start=3, end=9, level=80, ripple=0)
    svg = trace_svg(
        force_trace(make_recording("T1", 0, {"pelvis": pelvis}, duration_s=12), make_score("T1", 0)), title=""
    )
    of_pelvis = PROTOCOL.f_pain("pelvis")
    assert f">limit {PROTOCOL.limits.gamma * of_pelvis:g}<" in svg
    assert f">pain {of_pelvis:g}<" in svg
    assert ">pelvis<" in svg
    assert "right forearm" not in svg
    assert ">limit 35<" not in svg
    both = {"pelvis": pelvis, "right_forearm": pelvis / 4}
    svg = trace_svg(force_trace(make_recording("T1", 0, both, duration_s=12), make_score("T1", 0)), title="")
    assert (svg.count(">pelvis<"), svg.count(">right forearm<")) == (2, 1), "20 N is below a quarter of 100 N"


def test_on_the_exam_a_trace_shows_the_limit_that_decides() -> None:
    """The largest force of a trial is less than the safety gate, and the thorax came nearer to it than the pelvis."""
    forces = {
        name: plateau(T, start=3, end=9, level=level, ripple=0) for name, level in (("pelvis", 11), ("thorax", 12))
    }
    recording = make_recording("T1", 0, forces, duration_s=12)
    spec = recording.header.spec
    limits = {"pelvis": 100.0, "thorax": 200.0, "forearm": 100.0}
    protocol = load_protocol("bathing-wide-v2", level="L0")
    protocol = protocol.model_copy(update={"limits": protocol.limits.model_copy(update={"f_pain_n": limits})})
    header = recording.header.model_copy(update={"spec": spec.model_copy(update={"protocol": protocol})})
    trace = force_trace(dataclasses.replace(recording, header=header), make_score("T1", 0))
    assert trace.gate_n == pytest.approx(15.0)
    assert [(limit.segment, limit.style, limit.value_n) for limit in trace.limits] == [
        ("thorax", "gate", 15.0), ("thorax", "pain", 200.0),
    ]  # fmt: skip


def test_empty_recording_has_an_empty_trace() -> None:
    trace = force_trace(make_recording("T7", 0, {}, duration_s=0), make_score("T7", 0, **NO_CONTACT))
    assert trace.time_s.size == trace.target_n.size == trace.other_n.size == 0


@settings(deadline=None)
@given(st.floats(1e-3, 1e4), st.integers(3, 8))
def test_ticks_start_at_zero_stay_inside_and_are_few(top: float, count: int) -> None:
    ticks = nice_ticks(top, count=count)
    assert ticks[0] == 0
    assert ticks[-1] <= top * 1.001
    assert 1 < len(ticks) <= count + 1
    assert np.allclose(np.diff(ticks), ticks[1])


def test_known_ticks() -> None:
    assert nice_ticks(41.3, count=4) == [0, 20, 40]
    assert nice_ticks(12.0, count=5) == [0, 5, 10]
    assert nice_ticks(1.18, count=4) == [0, 0.5, 1]


# The drawings show the counts: read back from the coordinates.

GATE_FIGURES_PROTOCOL = load_protocol("bathing-v3")


def line(svg: str, level: int) -> list[tuple[float, float]]:
    points = re.findall(rf'<polyline class="level{level}" points="([^"]+)"', svg)
    return [(float(x), float(y)) for x, y in (pair.split(",") for pair in points[0].split())]


def test_gamma_curve_is_to_scale() -> None:
    """Peaks of 25, 50 and 120 N on a segment that bears 100 N, and a failure: 1 of 4 from 0.25 on, 2 from 0.50 on."""
    scores = [make_score("T1", i, peak_force_n={"right_forearm": f}) for i, f in enumerate((25.0, 50.0, 120.0))]
    svg = gamma_svg([*scores, make_score("T1", 3, **FAILED)], gamma=0.35)
    curve = line(svg, 2)
    axes = gamma_axes("")
    share = [(axes.floor - y) / axes.height for _, y in curve]
    gamma = [0.2 + 0.8 * (x - axes.left) / axes.width for x, _ in curve]
    assert (gamma[0], gamma[-1]) == (pytest.approx(0.2), pytest.approx(1.0))
    for g, s in zip(gamma, share, strict=True):
        assert s == pytest.approx((0 if g < 0.245 else 1 if g < 0.495 else 2) / 4, abs=1e-3)
    assert "region-correct, 3" in svg
    assert "1 of 4 at γ′ = 0.35" in svg
    assert 'class="own"' not in gamma_svg(scores, gamma=None)


def test_panels_count_the_trials_that_have_to_pass_the_gate() -> None:
    touch = {"floor_n": {"0.25": 3, "0.5": 2, "1": 1}, "push_force_n": {"1": 3, "3": 3, "5": 3}}
    push = {"floor_n": {"0.25": 3, "0.5": 3, "1": 0}, "push_force_n": {"1": 3, "3": 1, "5": 0}}
    scores = [make_score("T1", 0, gate_sweep=touch), make_score("T2", 0, gate_sweep=push)]
    floor, force = gate_panels(scores, GATE_FIGURES_PROTOCOL)
    assert (floor.title, floor.n, force.title, force.n) == ("Contact floor [N]", 2, "Push: force [N]", 1)

    def counts(svg: str, level: int, n: int) -> list[float]:
        axes = panel_axes("", 3, n)
        return [pytest.approx(n * (axes.floor - y) / axes.height, abs=1e-2) for _, y in line(svg, level)]

    assert [counts(floor.svg, level, 2) for level in range(3)] == [[2, 2, 1], [2, 2, 0], [2, 1, 0]]
    assert [counts(force.svg, level, 1) for level in range(3)] == [[1, 1, 0], [1, 0, 0], [1, 0, 0]]
    marked = re.search(r'class="name"[^>]*>([\d.]+)<', floor.svg)
    assert marked is not None
    assert marked[1] == "0.5"
