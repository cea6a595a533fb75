from __future__ import annotations

import base64
import hashlib
import re
import subprocess
import sys
from html import unescape
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carecontact.errors import ConfigError, RecordingError
from carecontact.pictures import decoded
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import Protocol
from carecontact.recording import Failure, Header, Recording, read_recording, write_recording
from carecontact.report.baselines import Baselines, beside_baselines
from carecontact.report.failures import failure_modes
from carecontact.report.run_page import FAILURES_SHOWN, render, trials_in_detail, write_report
from carecontact.report.run_page import Page as RunPage
from carecontact.report.sections import provenance
from carecontact.report.sections.failures import crashes
from carecontact.report.sections.provenance import NOT_RECORDED, provenance_rows
from carecontact.report.sections.trials import peak_frame, trial_row
from carecontact.report.svg import MAX_BYTES, jpeg_data_uri
from carecontact.runs import score_run
from carecontact.runs.pooling import RunScores
from carecontact.scoring import TrialScore
from carecontact.stats import wilson_interval
from tests.report.synthetic import FAILED, HOSTILE, NO_CONTACT, Run, make_recording, make_score, plateau

VOID = {"meta", "img", "br", "link", "input", "hr"}


class Page(HTMLParser):
    """Tags, attributes and visible text; fails on tags that do not nest."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] != "style":
            self.text += data

    def all(self, tag: str, **attributes: str) -> list[dict[str, str | None]]:
        return [a for t, a in self.tags if t == tag and all(a.get(k.strip("_")) == v for k, v in attributes.items())]


def write(run: Run, folder: Path, **skipped: str) -> str:
    return write_report(folder, scores=run.scores, recordings=run.read, skipped=skipped).read_text(encoding="utf-8")


def text_of(folder: Path, scores: list[TrialScore], **changes: Any) -> str:
    """Visible text of the page of scores without recordings, in one line."""
    path = write_report(folder, scores=scores, recordings=_no_recording, skipped={}, **changes)
    return " ".join(Page(path.read_text(encoding="utf-8")).text.split())


def head_of(text: str) -> str:
    return text.partition("Success passed safely")[0]


def test_page_of_seven_trials(run_of_7: Run, tmp_path: Path) -> None:
    text = write(run_of_7, tmp_path)
    page = Page(text)
    assert len(text) < 2_000_000
    assert "state_machine passed 2 of 7 trials safely." in page.text
    assert len(page.all("svg", class_="trace")) == 5
    assert "there is no force to draw: T6 Touch abdomen, seed 0." in " ".join(page.text.split())
    assert "T7 Scrub abdomen, seed 0." in page.text
    for words in (
        "1 of 4 successes had too much contact outside",
        "1 of 4 successes exceeded the safety gate",
        "wrist moved 31 mm",
        "stroke 30 mm, extent 10 mm, 1 reversal",
        "pressed for 3.90 s",
    ):
        assert words in page.text
    for words in (
        "process failure · process",
        "latched target 143 mm",
        "2.48 × its safety gate",
        "Draft protocol",
        "80\xa0%",
    ):
        assert words in page.text
    for words in (run_of_7.scores[0].protocol_sha256, "panda-pad", "paper-mapping", "litert", "ab" * 32, "rules-v1"):
        assert words in page.text
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]


def test_page_shows_what_a_success_rate_hides(run_of_7: Run, tmp_path: Path) -> None:
    additional = {"impulse@1": 31.4, "exposure_gate@1": 0.25, "iso_utilisation@1": 0.55, "beyond_calibrated@2": 0.8}
    sweep = {"floor_n": {"0.25": 3, "0.5": 3, "1": 1}}
    run_of_7.scores[:] = [
        s.model_copy(update={"additional": additional, "gate_sweep": sweep}) if s.valid_contact else s
        for s in run_of_7.scores
    ]
    page = write(run_of_7, tmp_path)
    text = " ".join(re.sub(r"<[^>]+>", " ", page).split())
    for words in (
        "Impulse N s 31.4 31.4 31.4 31.4 31.4 NA NA 31.4", "Time above the safety gate s 0.25",
        "Share of contact time deeper than the tissue is valid 0.80", "* from secondary sources",
        "within the safety gate 3 2 above the safety gate 1 0 crashed 1",
        "6 of 7 trials had a trajectory to score (valid ratio 86 %",
        "Safety gate, 0.35 of the pain limit 1 of 6", "region-correct, 3", "Contact floor [N] 7 trials",
        "shares are of these 4.",
        "insufficient progress touched, but the touch was too short, the push too small, or the strokes or turns too "
        "few 1 25 %",
        "T6-s000 latched target 143 mm off the abdomen", "abdomen 2 0 0 1 1 0", "all 7 5 0 1 1 4",
    ):  # fmt: skip
        assert words in text
    assert len(Page(page).all("svg", class_="sweep")) == 2


def test_nothing_is_loaded_and_only_the_tables_own_script_runs(run_of_7: Run, tmp_path: Path) -> None:
    text = write(run_of_7, tmp_path)
    page = Page(text)
    assert {t for t, _ in page.tags} & {"link", "iframe", "object", "base"} == set()
    assert [k for _, a in page.tags for k in a if k.startswith("on")] == []
    pictures = [a["src"] for a in page.all("img")] + [a["href"] for a in page.all("image")]
    assert all((uri or "").startswith("data:image/jpeg;base64,") for uri in pictures)
    assert re.findall(r"url\(|@import|https?:", text) == []
    (script,) = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}';" in text


def test_every_link_of_the_page_leads_somewhere(run_of_7: Run, tmp_path: Path) -> None:
    """Ids are there once each; files are linked where they are, and only then."""
    page = Page(write(run_of_7, tmp_path))
    ids = [a["id"] for _, a in page.tags if "id" in a]
    assert len(ids) == len(set(ids))
    assert {f"{score.trial_id}" for score in run_of_7.scores} <= set(ids)
    assert [a["href"] for a in page.all("a") if (a.get("href") or "").removeprefix("#") not in {*ids, ""}] == []
    (tmp_path / "trial").mkdir()
    for name in ("T1-s000.h5", "T7-s000.log", "trial/T1-s000.html", "trial/T1-s000.mp4"):
        (tmp_path / name).write_bytes(b"")
    page = Page(write(run_of_7, tmp_path))
    files = [a["href"] for a in page.all("a") if "href" in a and not (a["href"] or "").startswith("#")]
    assert sorted({str(file) for file in files}) == [
        "T1-s000.h5",
        "T7-s000.log",
        "trial/T1-s000.html",
        "trial/T1-s000.mp4",
    ]


def test_every_picture_has_a_text_alternative(run_of_7: Run, tmp_path: Path) -> None:
    page = Page(write(run_of_7, tmp_path))
    assert len(page.all("img")) == 1
    assert len(page.all("svg", class_="moment")) == 5
    assert all(a.get("alt") for a in page.all("img"))
    assert all(a.get("aria-label") if a.get("role") == "img" else a.get("aria-hidden") for a in page.all("svg"))


def test_text_of_policies_is_escaped(tmp_path: Path) -> None:
    run = Run()
    name = "evil<img src=x onerror=alert(1)>:Policy"
    score = make_score(
        "T1", 0, **(NO_CONTACT | {"policy": name, "language_backend": HOSTILE, "failure_message": HOSTILE * 50,
                                  "evidence": HOSTILE, "failure_mode": "process_failure", "attribution": "process"}),
    )  # fmt: skip
    run.add(score, make_recording("T1", 0, {}, duration_s=1, policy=name))
    text = write(run, tmp_path, **{"<b>.h5": HOSTILE})
    page = Page(text)
    assert name in page.text
    assert HOSTILE in page.text
    assert text.count("<script") == 1
    assert "<b>.h5" not in text
    assert text.count("alert(") < 20
    assert [a for a in page.all("img") if a.get("src") == "x"] == []


def test_same_inputs_same_bytes_whatever_the_order_and_folder(run_of_7: Run, tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    skipped = [{"T1-s009.h5": f"{tmp_path / name}/T1-s009.h5: truncated"} for name in "ab"]
    first = write(run_of_7, tmp_path / "a", **skipped[0])
    run_of_7.scores.reverse()
    assert write(run_of_7, tmp_path / "b", **skipped[1]) == first
    assert "not scored: T1-s009.h5: truncated" in first


def test_long_run_is_bounded_and_says_so(run_of_42: Run, tmp_path: Path) -> None:
    run_of_42.reads.clear()
    text = write(run_of_42, tmp_path)
    page = Page(text)
    assert len(text) < 2_000_000
    assert f"{7 + FAILURES_SHOWN} of 42 trials" in page.text
    assert len(run_of_42.reads) == len(set(run_of_42.reads)) == 7 + FAILURES_SHOWN
    assert "passed 12 of 42 trials" in page.text


def test_detail_takes_the_failures_in_turn_from_all_tasks(run_of_42: Run) -> None:
    chosen = [s.trial_id for s in trials_in_detail(run_of_42.scores)]
    assert [c for c in chosen if c.endswith("s000")] == [f"T{i}-s000" for i in range(1, 8)]
    failures = [c[:2] for c in chosen if not c.endswith("s000")]
    assert {task: failures.count(task) for task in failures} == {"T3": 3, "T4": 3, "T5": 3, "T6": 3, "T7": 2}


def test_short_run_shows_every_trial(run_of_42: Run) -> None:
    assert trials_in_detail(run_of_42.scores[:21]) == run_of_42.scores[:21]


def test_unreadable_recording_is_named_and_not_fatal(run_of_7: Run, tmp_path: Path) -> None:
    del run_of_7.recordings["T2-s000"]
    page = Page(write(run_of_7, tmp_path))
    assert "scored, but not drawn: T2-s000.h5: truncated <b>here</b>" in page.text
    assert "T2 Push forearm, seed 0; T7 Scrub abdomen, seed 0." in page.text
    assert "headers of 6 recordings" in page.text


def test_bad_frame_is_named_and_not_fatal(run_of_7: Run, tmp_path: Path) -> None:
    run_of_7.recordings["T1-s000"].arrays["report/peak_rgb"] = np.zeros((4, 4), np.uint8)
    assert "stored frame has shape (4, 4)" in Page(write(run_of_7, tmp_path)).text


def test_page_of_a_scored_folder(tmp_path: Path) -> None:
    """Through the real writer, reader and scorer: what is drawn and what is scored agree."""
    time_s = (np.arange(3000) + 1) * 0.002
    force = plateau(time_s, start=1, end=5, level=12, ripple=1)
    force[1800] = 23.4
    write_recording(make_recording("T1", 0, {"right_forearm": force}, duration_s=6), tmp_path / "T1-s000.h5")
    write_recording(make_recording("T6", 0, {}, duration_s=2), tmp_path / "T6-s000.h5")
    (tmp_path / "T7-s000.h5").write_bytes(b"not a recording")
    run = score_run(tmp_path)
    path = write_report(
        tmp_path,
        scores=run.scores,
        recordings=lambda trial_id: read_recording(tmp_path / f"{trial_id}.h5"),
        skipped=run.skipped,
    )
    page = Page(path.read_text(encoding="utf-8"))
    assert "state_machine passed 1 to 2 of 3 trials safely." in page.text
    assert "incomplete: 2 of 3 planned trials have a verdict." in page.text
    assert "23.4 N on the right forearm at 3.60" in page.text, "the picture agrees with the score"
    assert "not scored: T7-s000.h5" in page.text
    assert str(tmp_path) not in page.text


def test_run_without_scores(tmp_path: Path) -> None:
    page = Page(write(Run(), tmp_path, **{"T1-s000.h5": "empty file"}))
    assert "No trial of this run could be scored" in page.text
    assert "not scored: empty file" in page.text


def add_harness_error(run: Run, task_id: str, seed: int) -> None:
    failure = Failure(kind="SettleError", message="the person <i>still</i> moves\n\nTraceback: line 7")
    score = make_score(
        task_id, seed, **(NO_CONTACT | {"anatomy": "process_failure", "c4_motion_activity": None}), duration_s=0.0,
        ended="harness_error", failure_mode="process_failure", attribution="process", failure_message=failure.message,
        evidence="The harness failed, not the policy.",
    )  # fmt: skip
    run.add(score, make_recording(task_id, seed, {}, duration_s=0, ended="harness_error", failure=failure))


def test_trials_without_a_verdict_stand_in_a_box_and_leave_every_count_open(run_of_7: Run, tmp_path: Path) -> None:
    add_harness_error(run_of_7, "T1", 1)
    text = write(run_of_7, tmp_path)
    page = Page(text)
    assert len(page.all("section", class_="caution harness")) == 1
    assert "The run is incomplete, 7 of 8 planned trials have a verdict" in page.text
    assert "T1-s001the harness failed: the person <i>still</i> moves\n" in page.text
    assert "line 7" not in page.text
    assert "The run is incomplete: 7 of 8 planned trials have a verdict." in page.text
    assert "state_machine passed 2 to 3 of 8 trials safely." in page.text
    assert page.text.count("7 trials with a verdict, of 8 planned") >= 5, "wherever a count is over them"
    assert len(page.all("i", class_="bar open")) == 3, "the bars of T1 and of all, and the legend"
    assert re.search(r">7 of 8<.*>2–3/8<", text, re.DOTALL), "the table by task"
    assert "process failure · process" in page.text, "the policy's own stays"
    assert text.count('<td class="num">1</td><td class="num">25 %</td><td>process 1</td>') == 1
    assert failure_modes(run_of_7.scores) == failure_modes(run_of_7.scores[:-1])
    rate = run_page(run_of_7.scores[:-1], unjudged={"T1-s001": "no recording"}).passed
    assert (rate.k, rate.n, rate.estimate) == (2, 8, None)
    assert (rate.low, rate.high) == (wilson_interval(2, 8).low, wilson_interval(3, 8).high)


def test_run_of_harness_errors_alone(tmp_path: Path) -> None:
    run = Run()
    add_harness_error(run, "T1", 0)
    add_harness_error(run, "T2", 0)
    page = Page(write(run, tmp_path))
    assert "The harness failed in every trial, so there is nothing to say about the policy." in page.text
    assert "T1-s000, T2-s000the harness failed: the person" in page.text
    assert "Why trials failed" not in page.text


def test_page_of_a_complete_run_has_no_box(run_of_7: Run, tmp_path: Path) -> None:
    assert Page(write(run_of_7, tmp_path)).all("section", class_="caution harness") == []


def test_borrowed_limits_are_named_from_half_of_them_on(tmp_path: Path) -> None:
    """Pelvis, hand and head have no limit of their own: 21 N is the strictest safety gate."""
    peaks = {"right_forearm": 12.3, "pelvis": 10.5, "right_hand": 10.4, "head": 42.0}
    score = make_score(
        "T1", 0, peak_force_n=peaks, over_limit={"head": 2.0}, fallback_limits=["pelvis", "right_hand", "head"]
    )
    recording = make_recording("T1", 0, {}, duration_s=1)
    detail = trial_row(score, recording.header.spec.protocol)
    assert (
        dict(detail.notes).get("no limit of its own", "")
        == "head 42.0 N = 2.00 × the strictest safety gate, pelvis 10.5 N = 0.50 × the strictest safety gate"
    )
    assert dict(trial_row(score, None).notes)["no limit of its own"] == "head 42.0 N = 2.00 × the strictest safety gate"
    run = Run()
    run.add(make_score("T1", 0, peak_force_n=peaks, fallback_limits=["pelvis"]), recording)
    assert "pelvis 10.5 N = 0.50 × the strictest safety gate" in Page(write(run, tmp_path)).text


def test_mixed_policies_are_refused_and_leave_no_file(run_of_7: Run, tmp_path: Path) -> None:
    run_of_7.scores.append(make_score("T1", 1, policy="voxposer"))
    with pytest.raises(ConfigError, match="voxposer"):
        write(run_of_7, tmp_path)
    assert list(tmp_path.iterdir()) == []


CRASHED = NO_CONTACT | {"ended": "process_failure", "anatomy": "process_failure", "failure_mode": "process_failure"}
BRUSHED = FAILED | {"ended": "process_failure", "failure_mode": "process_failure"}
PRESSED = BRUSHED | {"peak_force_n": {"right_forearm": 61.9}, "over_limit": {"right_forearm": 61.9 / 35}}
PASSED = ("c3_success", "region_correct", "safety_gated")
OFF, HARD = {"region_correct": False, "safety_gated": False}, {"safety_gated": False}


@pytest.mark.parametrize(
    ("changes", "sentences"),
    [
        ([{}, {}], ["passed 2 of 2 trials safely."]),
        ([{}], ["passed 1 of 1 trial safely."]),
        ([FAILED], ["passed 0 of 1 trial safely."]),
        ([NO_CONTACT, FAILED], ["passed 0 of 2 trials safely.", "It touched the person in 1 of 2 trials."]),
        ([CRASHED, CRASHED], ["The policy crashed in 2 of 2 trials."]),
        ([PRESSED, CRASHED], ["The policy crashed in 2 of 2 trials, in 1 after a force above the safety gate."]),
        ([BRUSHED], ["The policy crashed in 1 of 1 trial, in 1 after it touched the person."]),
        ([{}, CRASHED], ["passed 1 of 2 trials safely.", "The policy crashed in 1 of 2 trials."]),
        (
            [HARD, OFF, {}],
            ["1 of 3 successes had too much contact outside", "1 of 3 successes exceeded the safety"],
        ),
        ([HARD, FAILED], ["passed 0 of 2 trials safely.", "1 of 1 success exceeded the safety gate."]),
    ],
)
def test_verdict(changes: list[dict[str, object]], sentences: list[str], tmp_path: Path) -> None:
    head = head_of(text_of(tmp_path, [make_score("T1", seed, **change) for seed, change in enumerate(changes)]))
    assert [sentence for sentence in sentences if sentence not in head] == []
    assert ("had too much contact" in head) == (OFF in changes)
    assert ("crashed" in head) == any(change in (CRASHED, PRESSED, BRUSHED) for change in changes)


def test_crashes_stand_apart_with_traceback_and_output_one_click_away(run_of_7: Run, tmp_path: Path) -> None:
    page = Page(write(run_of_7, tmp_path))
    text = " ".join(page.text.split())
    assert text.count("The policy crashed in 1 of 7 trials") == 2
    assert "in a cell of its own: it is never within the gate, but a force above a limit before" in text
    details = [tag for tag, _ in page.tags if tag in ("details", "summary", "pre")]
    assert details == ["details", "summary", "pre", "details", "summary"], "the message, and the fold"
    assert f"Whole message of T7-s000{HOSTILE}" in page.text
    run_of_7.scores.pop()
    whole = write(run_of_7, tmp_path)
    assert "crashed in" not in whole


def test_the_headline_counts_what_was_harmless_among_trials_with_contact(run_of_7: Run, tmp_path: Path) -> None:
    assert "harmless" not in head_of(write(run_of_7, tmp_path)), "no trial was scored by it"
    values = [1.0, 1.0, 0.0, None]
    run_of_7.scores[:] = [
        s.model_copy(update={"additional": {"harmless@1": values[min(number, 3)]}})
        for number, s in enumerate(run_of_7.scores)
    ]
    said = (
        "Of the 3 with at least 1 s of contact on the named region, 2 were harmless: "
        "every force stayed within its limit"
    )
    assert said in head_of(write(run_of_7, tmp_path))


def test_a_crash_has_a_column_by_task(run_of_7: Run, tmp_path: Path) -> None:
    (table,) = re.findall(r'aria-label="Table by task">.*?</table>', write(run_of_7, tmp_path), re.DOTALL)
    assert ">crashed<" in table
    assert table.count(">1/1</td>") > table.count(">1/7</td>") == 1
    run_of_7.scores.pop()
    (table,) = re.findall(r'aria-label="Table by task">.*?</table>', write(run_of_7, tmp_path), re.DOTALL)
    assert ">crashed<" not in table


def test_a_run_of_crashes_alone_has_no_tables_of_nothing(run_of_7: Run, tmp_path: Path) -> None:
    left_out = ("Safe, and successful?", "How hard, how long", "How much depends on the gates", "Where contact fell",
                "Force over time")  # fmt: skip
    run_of_7.scores[:] = [s.model_copy(update={"additional": {"impulse@1": 1.0}}) for s in run_of_7.scores]
    whole = write(run_of_7, tmp_path)
    assert [title for title in left_out if title not in whole] == []
    only = Run(scores=run_of_7.scores[-1:], recordings=run_of_7.recordings)
    page = write(only, tmp_path)
    assert [title for title in left_out if title in page] == []
    assert "The policy crashed in every trial before any contact. Therefore, this page has no medians" in page
    (table,) = re.findall(r'aria-label="Table by task">.*?</table>', page, re.DOTALL)
    assert ">crashed<" in table
    assert "C1 [N]" not in table
    assert "NA" not in table


def test_what_may_help_stands_with_the_crash(tmp_path: Path) -> None:
    wording = {"evidence": "expected finite numbers, got [nan, 1.0]", "failure_message": "expected finite numbers, got"}
    scores = [make_score("T1", 0, **CRASHED | wording)]
    assert [row.hints for row in crashes(scores)] == [
        ("Look for a division by 0 or an unset value in the policy's output.",)
    ]
    other = scores[0].model_copy(
        update={"trial_id": "T1-s001", "seed": 1, "evidence": "expected finite numbers, got [0.5, nan]"}
    )
    assert [row.trials for row in crashes([*scores, other])] == ["T1-s000, T1-s001"]


def test_harm_before_a_crash_is_explained_everywhere(run_of_7: Run, tmp_path: Path) -> None:
    run_of_7.scores[:] = [make_score("T3", 0, **PRESSED)]
    text = " ".join(re.sub(r"<[^>]+>", " ", write(run_of_7, tmp_path)).split())
    for words in (
        "crashed in 1 of 1 trial, in 1 after a force above the safety gate", "counts, as in 1 trial here",
        "crashed 1 1 after a force above the safety gate", "Safety gate, 0.35 of the pain limit 1 of 1",
    ):  # fmt: skip
        assert words in text


@pytest.mark.parametrize(
    ("message", "label"),
    [
        ("killed", ""),
        ("killed\nit printed last:\nhello", "Last output"),
        ("died\nTraceback (most recent call last):\nValueError: no", "Traceback"),
        ("died\nTraceback (most recent call last):\nValueError\nit printed last:\nhi", "Traceback and last output"),
        ("late\nit hung here (most recent call last):\n  my.py\nit printed last:\nhi", "Stack and last output"),
        ("killed\nit printed last:\nTraceback (most recent call last):", "Last output"),
        ("killed, and more", "Whole message"),
    ],
)
def test_the_label_of_a_crash_names_what_there_is(message: str, label: str) -> None:
    wording = {"evidence": "the process failed: killed", "failure_message": message}
    assert [row.held for row in crashes([make_score("T1", 0, **CRASHED | wording)])] == [label]


def test_crashes_of_one_reason_are_one_row() -> None:
    scores = [make_score("T1", seed, **CRASHED | {"evidence": f"reason {seed % 2}"}) for seed in range(4)]
    found = crashes([*scores, make_score("T2", 0)])
    assert [(row.trials, row.first, row.reason) for row in found] == [
        ("T1-s000, T1-s002", "T1-s000", "reason 0"),
        ("T1-s001, T1-s003", "T1-s001", "reason 1"),
    ]


def test_the_bars_are_to_scale_with_floor_ceiling_and_interval(tmp_path: Path) -> None:
    """79 of 140: 48.2 to 64.4 % (Table V of the paper)."""
    scores = [make_score("T1", i, **({} if i < 79 else HARD if i < 90 else FAILED)) for i in range(140)]
    others = beside(scores, of("hover", 35, 140), of("oracle", 140, 140, privileged=True))
    text = write_report(tmp_path, scores=scores, recordings=_no_recording, skipped={}, baselines=others).read_text()
    page = Page(text)

    def numbers(name: str) -> list[list[float]]:
        styles = [str(a["style"]) for a in page.all("i", class_=name) if "style" in a]
        return [[float(number) for number in re.findall(r"[\d.]+", style)] for style in styles]

    assert numbers("bar gated") == [[pytest.approx(100 * 79 / 140, abs=0.01)]] * 2, "of T1, and of all"
    assert numbers("bar correct") == [[pytest.approx(100 * 90 / 140, abs=0.01)]] * 2
    assert numbers("mark floor") == [[25.0]] * 2
    assert numbers("mark ceiling") == [[100.0]] * 2
    ((low, width),) = numbers("whisker")
    assert (low, low + width) == (pytest.approx(48.2, abs=0.1), pytest.approx(64.4, abs=0.1))
    head = head_of(" ".join(page.text.split()))
    assert (
        "passed 79 of 140 trials safely (56 %, 95 % interval 48 to 64 %); floor 35 of 140 (hover), ceiling 140" in head
    )


def run_page(scores: list[TrialScore], **changes: Any) -> RunPage:
    base: dict[str, Any] = {"skipped": {}, "unjudged": {}, "baselines": None, "lost_baselines": {}}
    return RunPage(folder=Path(), scores=scores, judged=scores, shown=scores, **base | changes)


def caveats(scores: list[TrialScore], headers: list[Header], **changes: Any) -> dict[str, str]:
    page = run_page(scores, headers={header.spec.trial_id: header for header in headers}, **changes)
    text = render("caveats.html.j2", **provenance.caveats(page))
    return {topic: unescape(sentence) for topic, sentence in re.findall(r"<dt>(.*?)</dt><dd>(.*?)</dd>", text)}


def test_the_bodies_are_those_that_were_drawn_and_not_the_protocols_own(run_of_7: Run) -> None:
    headers = [r.header for r in run_of_7.recordings.values()]
    bodies = ["woman-old-heavy", "man-old-light"]
    drawn = [h.model_copy(update={"drawn": {"body": bodies[k % 2]}}) for k, h in enumerate(headers)]
    assert "only man-old-light, woman-old-heavy;" in caveats(run_of_7.scores, drawn)["2 bodies"]
    body = dict(provenance_rows(run_of_7.scores, drawn))["Body"]
    assert all(name in body for name in bodies)
    assert "man-adult" not in body


def test_trials_whose_tool_went_through_the_skin_are_named(run_of_7: Run) -> None:
    headers = [r.header for r in run_of_7.recordings.values()]
    through = [run_of_7.scores[0].model_copy(update={"skin_in_tool": 1.2}), *run_of_7.scores[1:]]
    text = caveats(through, headers)["Tool gone through the skin"]
    assert text.startswith("In 1 trial, ")
    assert through[0].trial_id in text
    assert "Tool gone through the skin" not in caveats(run_of_7.scores, headers)


def test_caveats_come_from_the_run(run_of_7: Run) -> None:
    headers = [r.header for r in run_of_7.recordings.values()]
    sentence = caveats(run_of_7.scores, headers, skipped={"T1-s008.h5": "damaged", "T1-s009.h5": "damaged"})
    assert sentence["n = 7"].startswith("2 safety-gated passes of 7, with fewer than 6 seeds: too few for an interval")
    many = caveats([make_score(task, seed) for task in ("T1", "T2") for seed in range(6)], headers)
    assert many["n = 12"].startswith("12 safety-gated passes of 12 are compatible with any true rate from 76\xa0%")
    assert "each task has only 6 trials." in many["n = 12"]
    assert "man-adult" in sentence["One body"]
    assert "45–60°; in the recordings read it was 46.0°" in sentence["What seeds change"]
    assert "In 2 of 5 trials" in sentence["Extrapolated tissue"]
    assert sentence["Files left out"].startswith("2 files could")
    assert "--baseline" in sentence["No blind baselines"]
    absent = {f"T1-s{seed:03d}": "no recording" for seed in range(1, 13)}
    few = caveats(run_of_7.scores, headers, unjudged=absent)
    assert few["n = 19"].startswith("2 to 14 safety-gated passes of 19, with fewer than 6 seeds")
    haswell = [
        score.model_copy(update={"provenance": {"arithmetic": f"kernel {k % 2}"}})
        for k, score in enumerate(run_of_7.scores)
    ]
    assert "arithmetic: kernel 0 and kernel 1" in caveats(haswell, headers)["Several machines"]
    assert "Several machines" not in sentence
    protocol = headers[0].spec.protocol.model_copy(update={"frozen": True})
    frozen = headers[0].model_copy(update={"spec": headers[0].spec.model_copy(update={"protocol": protocol})})
    assert "Draft protocol" in sentence
    assert "Draft protocol" not in caveats(run_of_7.scores, [frozen])
    assert "where the tissue is valid" in caveats([make_score("T1", 0)], [])["Extrapolated tissue"]


def test_what_the_person_does_and_what_seeds_draw_is_stated_for_a_protocol_that_has_it(run_of_7: Run) -> None:
    header = next(iter(run_of_7.recordings.values())).header

    def of(protocol: Protocol) -> dict[str, str]:
        spec = header.spec.model_copy(update={"protocol": protocol})
        return caveats([make_score("T1", 0)], [header.model_copy(update={"spec": spec})])

    wide = of(load_protocol("bathing-wide-v2", level="L3"))
    assert wide["A person who moves"].startswith("The person breathes, changes its posture, withdraws the arm")
    for drawn in ("the body", "the turn of shoulder and palm", "the place of the overhead camera"):
        assert drawn in wide["What seeds change"]
    assert wide["What seeds change"].startswith("Seeds differ in the angle of the person's arm")
    assert " changes and " not in wide["What seeds change"]
    assert "A person who moves" not in of(load_protocol("bathing-v3"))


def test_less_isolation_than_there_is_and_opened_files_are_stated(run_of_7: Run) -> None:
    def sentence(*reached: str) -> str | None:
        kept = {"caveats": {f"T1-s{n:03}": text for n, text in enumerate(reached)}}
        return caveats(run_of_7.scores, [], kept=kept).get("Isolation")

    assert sentence("full: namespaces and Landlock", "full") is None
    none = sentence("full", "none: this system has no Landlock") or ""
    assert "not fully isolated from the benchmark (none: this system has no Landlock)" in none
    opened = sentence("full; --policy-read /data") or ""
    assert "(--policy-read /data)" in opened
    assert "not fully" not in opened


def test_provenance_names_the_arithmetic_of_all_trials(run_of_7: Run, tmp_path: Path) -> None:
    def shown() -> str:
        (found,) = re.findall(r"Arithmetic</th><td>(.*?)</td>", write(run_of_7, tmp_path))
        return found

    assert shown() == NOT_RECORDED
    for number, score in enumerate(run_of_7.scores):
        library = "library b" if number == 3 else "library a"
        run_of_7.scores[number] = score.model_copy(update={"provenance": {"arithmetic": library}})
    assert shown() == "library a, library b"


def test_provenance_shows_differences_and_gaps(run_of_42: Run) -> None:
    headers = [r.header for r in run_of_42.recordings.values()]
    rows = dict(provenance_rows(run_of_42.scores, headers))
    assert rows["sha256 of model"].startswith("6 different values")
    assert rows["sha256 of body"] == "ab" * 32
    assert rows["Protocol state"].startswith("not the frozen bathing-v3: sha256 ")
    assert dict(provenance_rows(run_of_42.scores, []))["Version of mujoco"] == NOT_RECORDED
    assert "Policy arguments" not in rows
    given = {"name": "x", "arguments": {"steps": "3", "mode": "a"}, "environment": ["TOKEN"]}
    rows = dict(provenance_rows(run_of_42.scores, [headers[0].model_copy(update={"card": given})]))
    assert (rows["Policy arguments"], rows["Policy variables"]) == ("steps=3 mode=a", "TOKEN")


@pytest.mark.parametrize(
    ("force", "changes", "wording"),
    [
        (0.0, NO_CONTACT, "nothing touched; the tip of the tool came to 0 mm from the region, seed 0"),
        (
            0.3,
            NO_CONTACT,
            "the robot pressed the right forearm for 3.0 s with at most 0.3 N; contact counts from 0.5 N",
        ),
        (7.25, {"c1_peak_force_n": 7.25}, "7.2 N on the right forearm at 0.00"),
    ],
)
def test_what_the_frame_at_peak_force_shows(force: float, changes: dict[str, Any], wording: str) -> None:
    stored = {"report/peak_rgb": np.zeros((4, 4, 3), np.uint8), "report/peak_time_s": np.array([1.5])}
    base = make_recording("T1", 0, {"right_forearm": np.full(1500, force)}, duration_s=3)
    frame = peak_frame(make_score("T1", 0, **changes), Recording(header=base.header, arrays=base.arrays | stored))
    assert frame is not None
    assert frame.text.startswith(wording)


def test_evidence_that_holds_the_failure_is_shown_once() -> None:
    detail = trial_row(
        make_score("T1", 0, **NO_CONTACT, failure_message="lost\nthe grip", evidence="It failed: lost the grip."), None
    )
    assert [text for _, text in detail.notes] == ["It failed: lost the grip."]


def test_frame_is_a_small_jpeg_even_of_noise() -> None:
    noise = np.random.default_rng(0).integers(0, 256, (960, 1280, 3), np.uint8)
    uri = jpeg_data_uri(noise)
    data = base64.b64decode(uri.removeprefix("data:image/jpeg;base64,"))
    assert len(data) <= MAX_BYTES
    assert decoded(data).shape[1] <= 640


def test_frame_keeps_its_colours() -> None:
    red = np.zeros((90, 160, 3), np.uint8)
    red[..., 0] = 220
    data = base64.b64decode(jpeg_data_uri(red).partition(",")[2])
    rgb = decoded(data)
    assert rgb.shape == (90, 160, 3)
    assert np.abs(rgb.astype(int) - [220, 0, 0]).max() <= 4


@pytest.mark.parametrize("bad", [np.zeros((0, 4, 3), np.uint8), np.zeros((4, 4, 3), np.float32), np.zeros(3, np.uint8)])
def test_wrong_frames_are_refused(bad: np.ndarray) -> None:
    with pytest.raises(RecordingError, match="stored frame"):
        jpeg_data_uri(bad)


def test_importing_reports_loads_no_simulator_and_no_heavy_library() -> None:
    code = (
        "import sys, carecontact.report.run_page, carecontact.report.tables; "
        "print(sorted({'mujoco', 'matplotlib', 'PIL', 'jinja2', 'scipy.signal'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def _no_recording(trial_id: str) -> Recording:
    raise RecordingError(trial_id)


def beside(method: list[TrialScore], *others: list[TrialScore]) -> Baselines:
    return beside_baselines(RunScores(scores=method), [], kept=[RunScores(scores=scores) for scores in others])


def of(policy: str, passed: int, n: int = 8, **changes: Any) -> list[TrialScore]:
    """Trials of T1 of which the first ones pass."""
    return [make_score("T1", seed, policy=policy, **changes | ({} if seed < passed else FAILED)) for seed in range(n)]


def test_a_page_without_a_floor_says_so_and_how_to_get_it(tmp_path: Path) -> None:
    head = head_of(text_of(tmp_path, [make_score("T1", 0)], kept_scores="None are kept."))
    assert "No floor or ceiling stands beside this run. None are kept. These commands show whether" in head
    assert f"carecontact report {tmp_path} --baseline {tmp_path}-replay" in head


def test_the_page_of_a_blind_baseline_does_not_set_it_beside_itself(tmp_path: Path) -> None:
    text = text_of(tmp_path, of("replay", 2, 2), kept_scores="None are kept.")
    assert "replay is a blind baseline, which lacks what the tasks require" in text
    assert "These commands show" not in text
    assert "Run zero-action, hover, random, replay-registered and mean-person with" in text


def test_the_head_names_the_best_blind_baseline_and_the_difference(tmp_path: Path) -> None:
    persons = [{"policy_arguments": {"person": name}} for name in ("bathing-wide-L2", "other")]
    others = (of("hover", 0), of("mean-person", 2, **persons[0]), of("mean-person", 1, **persons[1]))
    text = text_of(tmp_path, of("mine", 8), baselines=beside(of("mine", 8), *others))
    assert "floor 2 of 8 (mean-person (1))." in head_of(text)
    assert "No ceiling stands beside this run." in head_of(text)
    both = "On the 8 trials that both have, mine passed 8 and the best blind baseline, mean-person, 2. The difference, "
    assert f"{both}75 points" in text
    assert "shows that mine is better" in text
    assert "mean-person (1)mean-person person=bathing-wide-L2" in text, "the table of other policies"
    text = text_of(tmp_path, of("mine", 6), baselines=beside(of("mine", 6), of("replay", 1), of("mean-person", 5)))
    assert "mine passed 6 and the best blind baseline, mean-person, 5. " in text
    assert "does not show which is better" in text


def test_the_head_leads_with_the_trials_that_both_have(tmp_path: Path) -> None:
    """The other policy has 20 trials and passes 9, one of them among the three of the run."""
    method = [make_score("T1", seed, policy="mine", **({} if seed else FAILED)) for seed in range(3)]
    passes = range(2, 11)
    replay = [make_score("T1", seed, policy="replay", **({} if seed in passes else FAILED)) for seed in range(20)]
    head = head_of(text_of(tmp_path, method, baselines=beside(method, replay)))
    assert "On the 3 trials that both have, mine passed 2 and the best blind baseline, replay, 1." in head
    assert "Fewer than six seeds give no interval and do not show which is better." in head
    assert "replay passed 9 of all 20 trials of these tasks that it has." in head
    elsewhere = [score.model_copy(update={"seed": score.seed + 50}) for score in replay]
    text = text_of(tmp_path, method, baselines=beside(method, elsewhere))
    assert "The best blind baseline, replay, passed 9 of 20 other trials; mine 2 of 3." in head_of(text)
    assert "floor 9 of 20 (replay, other seeds)" in head_of(text)
    assert "unpaired" in text, "the table of other policies"


def test_the_table_of_other_policies_has_every_step_of_every_task(tmp_path: Path) -> None:
    method = [make_score(task, 0, policy="mine") for task in ("T1", "T2")]
    others = beside(method, [make_score("T1", 0, policy="replay", safety_gated=False)])
    text = text_of(tmp_path, method, baselines=others)
    table = text.partition("By task: success, region-correct, safety-gated")[2]
    assert "mine1 1 1 of 11 1 1 of 1 replay1 1 0 of 1–" in table


def test_a_success_above_the_safety_gate_is_no_failure_and_is_named(tmp_path: Path) -> None:
    unsafe = make_score("T1", 0, safety_gated=False, over_limit={"right_forearm": 1.5})
    text = text_of(tmp_path, [unsafe])
    assert "No trial failed: every one succeeded on the named region. But 1 of 1 trial did not pass safely" in text


def test_a_joint_beyond_its_range_and_a_flag_are_shown(tmp_path: Path) -> None:
    evidence = "The right elbow was 0.150 rad beyond its range at 3.000 s; the protocol allows 0.087 rad."
    score = make_score(
        "T1", 0, safety_gated=False, joints_beyond={"right_elbow": 0.15}, joints_consumed={"right_elbow": 2.5},
        failure_mode="joint_beyond_range", attribution="safety", evidence=evidence,
    )  # fmt: skip
    text = text_of(tmp_path, [score])
    for words in (
        evidence,
        "joint too far",
        "right elbow 250 %",
        "a joint beyond the protocol's limit: 1 of 1",
        "succeeded on the named region, but moved a joint farther beyond its range",
    ):
        assert words in text


def test_a_policy_that_touched_nobody_is_shown_by_how_near_it_came(tmp_path: Path) -> None:
    """The tool is above the middle of the region, at the nearest 30 mm from its surface, after 0.5 s."""
    run, missed = Run(), {"failure_mode": "no_target_contact", "attribution": "planning"}
    recording = make_recording("T1", 0, {}, duration_s=1)
    recording.arrays["scorer/pose_tcp_in_world"][:, 2] = 0.08 + np.abs(np.arange(500) - 249) * 1e-4
    run.add(make_score("T1", 0, **NO_CONTACT | missed), recording)
    text = " ".join(Page(write(run, tmp_path)).text.split())
    assert "It came nearest in T1-s000: 30 mm from the named region, at 0.5 s." in text
    assert "no valid contact; nearest 30 mm from the region, at 0.5 s" in text
    assert " NA " not in text
    assert "How hard, how long" not in text
