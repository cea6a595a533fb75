"""The kept scores of the shipped policies stand beside every run of their protocol."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

import pytest

from carecontact.reports.compare import kept
from carecontact.reports.compare.baselines import Baselines, beside_baselines
from carecontact.reports.compare.kept import FOLDERS, beside_kept, completed_from_kept
from carecontact.runs.run_scores import RunScores
from carecontact.runs.stored_scores import read_scores
from tests.reports.synthetic_run import make_score

KEPT = Path(__file__).parents[3] / "docs" / "results"


def test_kept_scores_of_the_protocol_stand_beside_a_run(tmp_path: Path) -> None:
    (tmp_path / "bathing-v1").mkdir()
    for name in ("replay", "voxposer", "voxposer-1000", "state-machine"):
        shutil.copy(KEPT / "bathing-v1" / f"{name}.json.gz", tmp_path / "bathing-v1")
    run = read_scores(KEPT / "bathing-v1" / "voxposer.json.gz")
    beside, why = beside_kept(run, [], folders=[tmp_path / "nowhere", tmp_path])
    assert beside is not None
    assert [row.policy for row in beside.baselines] == list(beside.kept) == ["replay", "state-machine"]
    assert beside.baselines[0].rates["safety_gated"].k == 123
    assert [row.role for row in beside.baselines] == ["blind", "method"]
    assert beside.floor["all"].policy == "replay", "a method is no floor, whatever it passes"
    assert why == ""


def test_a_named_run_stands_in_place_of_the_kept_one() -> None:
    run, named = (read_scores(KEPT / "bathing-v1" / f"{name}.json.gz") for name in ("voxposer", "replay"))
    beside, _ = beside_kept(run, [named], folders=[KEPT])
    assert beside is not None
    assert beside.baselines[0].policy == "replay"
    assert "replay" not in beside.kept
    assert "zero-action" in beside.kept


def test_kept_scores_of_another_world_do_not(tmp_path: Path) -> None:
    run = read_scores(KEPT / "bathing-v1" / "voxposer.json.gz")
    other = [score.model_copy(update={"protocol_sha256": "ab" * 32}) for score in run.scores]
    beside, why = beside_kept(RunScores(scores=other), [], folders=[KEPT])
    assert beside is None
    assert why.startswith("The kept scores of hover cannot stand beside this run: ")
    assert "same protocol" in why


def test_a_draft_says_in_one_line_that_none_are_kept() -> None:
    protocol = "bathing-droid-draft"
    score = make_score("T1", 0).model_copy(update={"protocol_id": protocol})
    beside, why = beside_kept(RunScores(scores=[score]), [], folders=FOLDERS)
    assert beside is None
    assert (
        why == f"No scores of the shipped policies and of blind replay are kept for {protocol}, because it is a draft."
    )
    assert beside_kept(RunScores(scores=[]), []) == (None, "")


def test_a_named_run_of_some_tasks_keeps_the_kept_trials_of_the_others() -> None:
    run, replay = (read_scores(KEPT / "bathing-v1" / f"{name}.json.gz") for name in ("voxposer", "replay"))
    part = [s.model_copy(update={"safety_gated": False}) for s in replay.scores if s.task_id == "T1"]
    beside, _ = beside_kept(run, [RunScores(scores=part)], folders=[KEPT])
    whole, _ = beside_kept(run, [], folders=[KEPT])
    assert beside is not None
    assert whole is not None
    kept = next(row for row in whole.baselines if row.policy == "replay")
    row = beside.baselines[0]
    assert (beside.completed, row.policy, row.n) == (("replay",), "replay", kept.n)
    assert row.per_task["T1"]["safety_gated"][0] == 0
    assert {task: row.per_task[task] for task in row.per_task if task != "T1"} == {
        task: kept.per_task[task] for task in kept.per_task if task != "T1"
    }


def test_a_named_run_with_every_kept_trial_or_of_other_rules_stays_as_it_is() -> None:
    run, replay = (read_scores(KEPT / "bathing-v1" / f"{name}.json.gz") for name in ("voxposer", "replay"))
    assert completed_from_kept(run, replay, folders=[KEPT]) is replay
    other = [s.model_copy(update={"protocol_sha256": "ab" * 32}) for s in replay.scores[:1]]
    named = RunScores(scores=other)
    assert completed_from_kept(run, named, folders=[KEPT]) is named


def test_the_rates_beside_a_run_are_computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    run, named = (read_scores(KEPT / "bathing-v1" / f"{name}.json.gz") for name in ("voxposer", "replay"))
    calls: list[int] = []

    def counted(method: RunScores, baselines: Sequence[RunScores], *, kept: Sequence[RunScores] = ()) -> Baselines:
        calls.append(len(kept))
        return beside_baselines(method, baselines, kept=kept)

    monkeypatch.setattr(kept, "beside_baselines", counted)
    beside, _ = beside_kept(run, [named], folders=[KEPT])
    assert beside is not None
    assert calls == [len(beside.kept)]
