"""The report and the page of a trial, opened in a real browser as a reader opens them."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from carecontact.report.baselines import beside_baselines
from carecontact.report.run_page import write_report
from carecontact.report.trial_page import write_trial_page
from carecontact.runs.pooling import RunScores
from carecontact.scoring import score_recording
from tests.report.browser import SMALLEST, WIDER, Browser, Opened
from tests.report.strict_html import StrictReader
from tests.report.synthetic import FAILED, Run, make_score, whole_trial

SMALLEST_PX = 8.0
"""Of text in figures, at every width: that of the small print on a phone."""
SHOWN = "[...document.querySelectorAll('#trial-table tbody')].filter(row => !row.hidden).map(row => row.id)"


def long_run(run: Run) -> RunScores:
    """140 trials; six seeds have recordings."""
    more = [
        make_score(f"T{task}", seed, **(FAILED if seed % 3 else {})) for task in range(1, 8) for seed in range(6, 20)
    ]
    return RunScores(scores=[*run.scores, *more])


@pytest.fixture(scope="module")
def report(run_of_42: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of 140 trials, with two other methods beside."""
    method, folder = long_run(run_of_42), tmp_path_factory.mktemp("run")
    others = [
        RunScores(scores=[s.model_copy(update={"policy": name}) for s in method.scores])
        for name in ("replay", "voxposer")
    ]
    return write_report(
        folder, scores=method.scores, recordings=run_of_42.read, skipped={}, baselines=beside_baselines(method, others)
    )


@pytest.fixture(scope="module")
def trial(tmp_path_factory: pytest.TempPathFactory) -> Path:
    recording = whole_trial()
    return write_trial_page(tmp_path_factory.mktemp("trial"), recording, score_recording(recording))


UNFOLD = "document.querySelectorAll('#all').forEach(fold => fold.open = true)"


def check_looks(page: Opened) -> None:
    """At a desk, on a tablet, on a phone, by day and by night."""
    page.value(UNFOLD)
    colours = set()
    for width in (1400, 800, 420):
        for dark in (False, True):
            page.resize(width, dark=dark)
            assert page.value(WIDER) == []
            assert page.value(SMALLEST) >= SMALLEST_PX
            colours.add(page.value("getComputedStyle(document.body).backgroundColor"))
    assert len(colours) == 2
    assert [url for url in page.requests if not url.startswith(("file:", "data:"))] == []
    assert page.complaints == []


def test_what_the_checks_look_for_is_found(browser: Browser, tmp_path: Path) -> None:
    file = tmp_path / "wrong.html"
    file.write_text(
        "<!DOCTYPE html>\n<html lang=en><head><title>x</title></head><body><p style='width: 2000px'>wide<p><div>"
        "<img src='https://example.invalid/x.png'></div></p><svg viewBox='0 0 900 9' style='width: 90px'>"
        "<text style='font-size: 12px'>t</text></svg><script>console.log('here')</script></body></html>"
    )
    page = browser.open(file)
    assert any("wide" in found for found in page.value(WIDER))
    assert page.value(SMALLEST) == pytest.approx(1.2)
    assert "https://example.invalid/x.png" in page.requests
    assert any("here" in complaint for complaint in page.complaints)
    read = StrictReader(file.read_text())
    assert any("<div> in <p>" in fault for fault in read.faults)
    assert any("without src and alt" in fault for fault in read.faults)
    assert browser.open(file, scripts=False).tree() != read.elements


def test_the_report_fits_every_window_and_asks_for_nothing(browser: Browser, report: Path) -> None:
    assert report.stat().st_size < 10e6
    page = browser.open(report)
    check_looks(page)
    assert page.requests[0] == report.as_uri()
    assert len([url for url in page.requests if url.startswith("file:")]) == 1


def test_the_page_of_a_trial_fits_every_window_and_asks_for_nothing(browser: Browser, trial: Path) -> None:
    page = browser.open(trial)
    check_looks(page)
    assert len([url for url in page.requests if url.startswith("file:")]) == 1


BROKEN = """
[...document.querySelectorAll("figure, svg, tr, #trial-table tbody")]
  .filter(node => getComputedStyle(node).breakInside !== "avoid").map(node => node.outerHTML.slice(0, 60))
"""
"""What a page may break in print."""


def test_pages_print_light_and_break_no_chart_and_no_row(browser: Browser, report: Path, trial: Path) -> None:
    for file in (report, trial):
        page = browser.open(file)
        page.resize(700, dark=True)
        night = {"name": "prefers-color-scheme", "value": "dark"}
        page.call("Emulation.setEmulatedMedia", media="print", features=[night])
        assert page.value("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
        assert page.value("getComputedStyle(document.querySelector('h1')).color") == "rgb(0, 0, 0)"
        assert page.value(BROKEN) == []
        assert page.value(WIDER) == []


def test_a_video_shows_a_still_until_it_plays(trial: Path) -> None:
    """In print, it never does: without the still, it would be a black box."""
    recording = whole_trial()
    rgb = np.full((8, 8, 3), 90, np.uint8)
    recording = replace(recording, arrays={**recording.arrays, "report/snapshot_rgb": rgb})
    trial.with_name("T1-s000.mp4").write_bytes(b"")
    page = write_trial_page(trial.parents[1], recording, score_recording(recording)).read_text()
    trial.with_name("T1-s000.mp4").unlink()
    assert re.search(r'<video [^>]*poster="data:image/jpeg;base64,', page)
    assert StrictReader(page).faults == []


def test_a_browser_reads_the_pages_as_they_are_written(browser: Browser, report: Path, trial: Path) -> None:
    """HTML that is not valid would be repaired, which moves elements. Without a script, the whole table is there."""
    for file in (report, trial):
        read = StrictReader(file.read_text())
        assert read.faults == []
        page = browser.open(file, scripts=False)
        assert page.tree() == read.elements
    page = browser.open(report, scripts=False)
    assert len(page.value(SHOWN)) == 140
    assert page.value("document.getElementById('filter').hidden") is True


HINTS = """
[...document.querySelectorAll(".scroll")].map(node =>
  [node.scrollWidth > node.clientWidth, parseFloat(getComputedStyle(node, "::before").height) > 0])
"""
"""For every table whether it is wider than its place, and whether it says so."""


def test_a_table_that_is_wider_than_its_place_says_that_it_scrolls(browser: Browser, report: Path) -> None:
    page = browser.open(report)
    page.value(UNFOLD)
    for width in (1400, 420):
        page.resize(width)
        found = page.value(HINTS)
        assert all(wider == hinted for wider, hinted in found)
        assert any(wider for wider, _ in found) is (width == 420)


def test_the_table_of_trials_filters(browser: Browser, report: Path) -> None:
    page = browser.open(report)
    assert len(page.value(SHOWN)) == 140
    choose = "var f = document.getElementById('filter-{}'); f.value = '{}'; f.dispatchEvent(new Event('{}'))"
    page.value(choose.format("task", "T3", "change"))
    shown = page.value(SHOWN)
    assert len(shown) == 20
    assert {name[:2] for name in shown} == {"T3"}
    assert page.value("document.getElementById('filter-count').textContent") == "20 of 140 trials"
    page.value(choose.format("result", "failed", "change"))
    assert 0 < len(page.value(SHOWN)) < 20
    page.value(choose.format("task", "", "change"))
    page.value(choose.format("result", "", "change"))
    page.value(choose.format("words", "latched abdomen", "input"))
    assert {name[:2] for name in page.value(SHOWN)} == {"T6"}


def test_the_table_of_trials_sorts(browser: Browser, report: Path) -> None:
    page = browser.open(report)
    peaks = (
        "[...document.querySelectorAll('#trial-table tbody')].map(row => parseFloat(row.rows[0].cells[4].dataset.v))"
        ".map(peak => isNaN(peak) ? null : peak)"
    )
    for order in (1, -1):
        page.value("document.querySelector('#trial-table thead').rows[0].cells[4].firstChild.click()")
        found = page.value(peaks)
        numbers = [peak for peak in found if peak is not None]
        assert numbers == sorted(numbers, reverse=order < 0)
        assert found[len(numbers) :] == [None] * (140 - len(numbers)), "what is NA stays last"
    assert page.value("document.querySelectorAll('[aria-sort=descending]').length") == 1
