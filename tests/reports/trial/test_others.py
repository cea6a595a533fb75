"""What other policies did in the same trial, beside it on its page."""

from __future__ import annotations

import re
from pathlib import Path

from carecontact.cli.trial_pages import policies_beside
from carecontact.reports.trial.others import Beside, how_to_compare, other_rows
from carecontact.reports.trial.page import write_trial_page
from carecontact.runs.run_scores import RunScores
from carecontact.runs.stored_scores import read_scores
from tests.reports.strict_html import StrictReader
from tests.reports.synthetic_run import NO_CONTACT, make_score
from tests.reports.synthetic_trial import whole_trial

KEPT = Path(__file__).parents[3] / "docs" / "results" / "bathing-v3-draft"


def test_only_the_same_task_and_seed_stands_beside_with_a_link_to_its_page(tmp_path: Path) -> None:
    (tmp_path / "b" / "trial").mkdir(parents=True)
    (tmp_path / "b" / "trial" / "T1-s000.html").write_text("")
    replay = RunScores(scores=[make_score("T1", seed, policy="replay", **NO_CONTACT) for seed in (0, 1)])
    other = RunScores(scores=[make_score("T1", 1, policy="mine")])
    beside = [Beside.of(replay, tmp_path / "b"), Beside.of(other, tmp_path / "c")]
    (row,) = other_rows(make_score("T1", 0), beside, tmp_path / "a")
    assert (row.name, row.note, row.result_text, row.peak) == ("replay", "blind baseline", "failed", "NA")
    assert row.address == "../../b/trial/T1-s000.html"
    assert [found.name for found in other_rows(make_score("T1", 1), beside, tmp_path / "a")] == ["replay", "mine"]
    assert [found.address for found in other_rows(make_score("T1", 1), beside, tmp_path / "a")] == ["", ""]


def test_the_page_shows_it_or_says_how_to_get_it(tmp_path: Path) -> None:
    recording = whole_trial()
    score = make_score("T1", 0, policy="mine")
    missed = make_score("T1", 0, policy="replay", **NO_CONTACT, failure_mode="no_target_contact")
    replay = Beside.of(RunScores(scores=[missed]))
    text = write_trial_page(tmp_path, recording, score, beside=[replay]).read_text()
    section = text.partition('<section id="others">')[2].partition("</section>")[0]
    words = " ".join(re.sub(r"<[^>]+>", " ", section).split())
    assert "this trial: mine passed" in words
    assert words.endswith("replay blind baseline failed NA no target contact")
    assert StrictReader(text).faults == []
    alone = write_trial_page(tmp_path, recording, score).read_text()
    assert "carecontact run --policy replay --protocol bathing-v3-draft --tasks T1 --seeds 0 --out " in alone
    assert f"carecontact report {tmp_path} --trials --baseline {tmp_path}-replay</pre>" in alone
    assert StrictReader(alone).faults == []
    assert how_to_compare(make_score("T1", 0, policy="replay"), tmp_path) == ()


def test_the_kept_scores_stand_beside_a_run_of_their_protocol(tmp_path: Path) -> None:
    run = read_scores(KEPT / "voxposer.json.gz")
    beside = policies_beside(tmp_path, run)
    rows = other_rows(run.scores[0], beside, tmp_path)
    assert {"replay", "state-machine"} <= {row.name for row in rows}
    named = policies_beside(tmp_path, run, [KEPT / "replay.json.gz"])
    assert [row.name for row in other_rows(run.scores[0], named, tmp_path)].count("replay") == 1
