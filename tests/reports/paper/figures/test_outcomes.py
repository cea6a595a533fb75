"""The panels of the figure of outcomes hold what their titles say."""

from __future__ import annotations

from pathlib import Path

import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from carecontact.recording import Recording, read_recording
from carecontact.reports.paper.figures import outcomes
from carecontact.reports.paper.method import Method, methods_of
from carecontact.reports.paper.published import read_paper
from carecontact.runs import score_run
from tests.reports.synthetic_run import FAILED, make_score

GOLDEN = Path(__file__).parents[3] / "golden"


def panels(methods: list[Method], paths: list[list[Recording]]) -> dict[str, Axes]:
    """Title without its letter -> the panel."""
    figure = Figure()
    outcomes.draw(figure, methods, paths)
    figure.draw_without_rendering()
    return {axes.get_title(loc="center").partition(") ")[2]: axes for part in figure.subfigs for axes in part.axes}


def method(title: str, modes: dict[str, int]) -> Method:
    failed = [FAILED | {"failure_mode": mode} for mode, count in modes.items() for _ in range(count)]
    scores = [make_score("T1", seed, policy=title, **fields) for seed, fields in enumerate(failed)]
    return Method(policy=title, title=title, scores=scores, published=None)


def test_every_count_of_a_failure_has_its_number_and_no_empty_class_a_bar() -> None:
    two = [method("a", {"time_limit": 90, "process_failure": 1}), method("b", {"time_limit": 3})]
    panel = panels(two, [[], []])["Why trials failed"]
    bars = sorted(bar.get_width() for bar in panel.patches)  # pyright: ignore[reportAttributeAccessIssue]
    assert bars == [1, 3, 90]
    assert sorted(text.get_text() for text in panel.texts) == ["1", "3", "90"]
    legend = panel.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["time limit", "process failure"]


def test_paths_are_drawn_region_by_region_with_an_outline_and_names() -> None:
    run = score_run(GOLDEN)
    recordings = [read_recording(GOLDEN / f"{task}-s000.h5") for task in ("T1", "T2", "T6")]
    shown = panels(methods_of([run], read_paper()), [recordings])
    assert [title for title in shown if "tool path" in title] == ["Forearm: tool path [mm]", "Abdomen: tool path [mm]"]
    forearm = shown["Forearm: tool path [mm]"]
    lines = {str(line.get_label()): line for line in forearm.lines}
    assert {"T1", "T2", "region"} <= set(lines)
    legend = forearm.get_legend()
    assert legend is not None
    assert legend.get_window_extent().y1 < forearm.get_window_extent().y0, "the legend covers no path"
    size_m = recordings[0]["scorer/region_size_m"][recordings[0].header.regions.index("forearm")]
    x, y = lines["region"].get_data()
    assert (max(x) - min(x), max(y) - min(y)) == pytest.approx((1000 * size_m[0], 2000 * size_m[1]))  # type: ignore[arg-type]


def test_a_force_has_its_spread_within_the_trial() -> None:
    run = score_run(GOLDEN)
    shown = panels(methods_of([run], read_paper()), [[]])
    push = shown["Push: force,\nmean and SD [N]"]
    (score,) = [s for s in run.scores if s.action == "push"]
    (bar,) = push.collections[0].get_segments()  # pyright: ignore[reportAttributeAccessIssue]
    assert score.c5_force_sd_n is not None
    assert bar[1, 1] - bar[0, 1] == pytest.approx(2 * score.c5_force_sd_n)
