"""The report and the pages of its trials link each other, whichever is written first."""

from __future__ import annotations

import re
from pathlib import Path

from carecontact.reports.page.page import write_report
from carecontact.reports.trial.page import write_trial_page
from carecontact.scoring import score_recording
from tests.reports.synthetic_trial import whole_trial

RECORDING = whole_trial()
SCORE = score_recording(RECORDING)


def page(folder: Path) -> Path:
    return write_trial_page(folder, RECORDING, SCORE)


def report(folder: Path) -> Path:
    return write_report(folder, scores=[SCORE], recordings=lambda trial_id: RECORDING, skipped={})


def shown_links(path: Path) -> list[str]:
    """Addresses of the links that a reader sees."""
    text = re.sub(r"<span hidden>.*?</span>", "", path.read_text())
    return [address for address in re.findall(r'<a href="([^"]+)"', text) if not address.startswith("#")]


def test_alone_neither_links_what_is_not_there(tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    assert shown_links(page(tmp_path)) == []
    assert shown_links(report(tmp_path / "b")) == []


def test_whichever_is_written_first_both_link_each_other_and_have_the_same_bytes(tmp_path: Path) -> None:
    written: list[list[str]] = []
    for name, order in (("a", (page, report)), ("b", (report, page)), ("c", (page, report, page, report))):
        folder = tmp_path / name
        folder.mkdir()
        for write in order:
            write(folder)
        assert shown_links(folder / "trial" / "T1-s000.html") == ["../report.html#T1-s000"]
        assert "trial/T1-s000.html" in shown_links(folder / "report.html")
        pages = [folder / "trial" / "T1-s000.html", folder / "report.html"]
        # A command that a page prints names the folder of the run.
        written.append([page.read_text().replace(str(folder), "RUN") for page in pages])
    assert written[0][0] == written[1][0] == written[2][0]
    assert written[0][1] == written[2][1]
