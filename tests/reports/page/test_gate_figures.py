"""The drawings show the counts: read back from the coordinates."""

from __future__ import annotations

import re

import pytest

from carecontact.protocols import load_protocol
from carecontact.reports.page.gate_figures import gamma_axes, gamma_svg, gate_panels, panel_axes
from tests.reports.synthetic_run import FAILED, make_score

PROTOCOL = load_protocol()


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
    assert gamma_svg([], gamma=0.35) == ""


def test_panels_count_the_trials_that_have_to_pass_the_gate() -> None:
    touch = {"floor_n": {"0.25": 3, "0.5": 2, "1": 1}, "push_force_n": {"1": 3, "3": 3, "5": 3}}
    push = {"floor_n": {"0.25": 3, "0.5": 3, "1": 0}, "push_force_n": {"1": 3, "3": 1, "5": 0}}
    scores = [make_score("T1", 0, gate_sweep=touch), make_score("T2", 0, gate_sweep=push)]
    floor, force = gate_panels(scores, PROTOCOL)
    assert (floor.title, floor.n, force.title, force.n) == ("Contact floor [N]", 2, "Push: force [N]", 1)

    def counts(svg: str, level: int, n: int) -> list[float]:
        axes = panel_axes("", 3, n)
        return [pytest.approx(n * (axes.floor - y) / axes.height, abs=1e-2) for _, y in line(svg, level)]

    assert [counts(floor.svg, level, 2) for level in range(3)] == [[2, 2, 1], [2, 2, 0], [2, 1, 0]]
    assert [counts(force.svg, level, 1) for level in range(3)] == [[1, 1, 0], [1, 0, 0], [1, 0, 0]]
    marked = re.search(r'class="name"[^>]*>([\d.]+)<', floor.svg)
    assert marked is not None
    assert marked[1] == "0.5"
