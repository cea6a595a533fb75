"""The kept scores of the shipped policies stand beside every run of their protocol."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from carecontact.reports.compare import kept
from carecontact.reports.compare.baselines import Baselines, beside_baselines
from carecontact.reports.compare.kept import beside_kept, completed_from_kept
from carecontact.runs.results_file import pack_results
from carecontact.runs.run_scores import RunScores
from tests.reports.synthetic_run import FAILED, make_score

PROTOCOL = "bathing-v3-draft"
PASSED = {"replay": 3, "state-machine": 7, "voxposer": 1}
"""Policy -> seeds of seven that it passes in both of its tasks."""
STALLED = FAILED | {"failure_mode": "insufficient_progress", "attribution": "planning", "evidence": "stroke 34 mm"}


def scores_of(policy: str, **fields: Any) -> RunScores:
    return RunScores(
        scores=[
            make_score(task, seed, policy=policy, **(fields | ({} if seed < PASSED[policy] else STALLED)))
            for task in ("T1", "T3")
            for seed in range(7)
        ]
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder of kept scores. Those under another stiffness have a longer name, and belong to no run's side."""
    for policy in PASSED:
        place = tmp_path / PROTOCOL / f"{policy}.json.gz"
        place.parent.mkdir(exist_ok=True)
        pack_results(place, scores_of(policy))
    pack_results(tmp_path / PROTOCOL / "voxposer-1000.json.gz", scores_of("voxposer", overrides={"stiffness": "1000"}))
    return tmp_path


def test_kept_scores_of_the_protocol_stand_beside_a_run(folder: Path, tmp_path: Path) -> None:
    beside, why = beside_kept(scores_of("voxposer"), [], folders=[tmp_path / "nowhere", folder])
    assert beside is not None
    assert [row.policy for row in beside.baselines] == list(beside.kept) == ["replay", "state-machine"]
    assert beside.baselines[0].rates["safety_gated"].k == 6
    assert [row.role for row in beside.baselines] == ["blind", "method"]
    assert beside.floor["all"].policy == "replay", "a method is no floor, whatever it passes"
    assert why == ""


def test_a_named_run_stands_in_place_of_the_kept_one(folder: Path) -> None:
    beside, _ = beside_kept(scores_of("voxposer"), [scores_of("replay")], folders=[folder])
    assert beside is not None
    assert beside.baselines[0].policy == "replay"
    assert list(beside.kept) == ["state-machine"]


def test_kept_scores_of_another_world_do_not(folder: Path) -> None:
    beside, why = beside_kept(scores_of("voxposer", protocol_sha256="ab" * 32), [], folders=[folder])
    assert beside is None
    assert why.startswith("The kept scores of replay cannot stand beside this run: ")
    assert "same protocol" in why


def test_a_draft_says_in_one_line_that_none_are_kept(tmp_path: Path) -> None:
    beside, why = beside_kept(scores_of("voxposer"), [], folders=[tmp_path])
    assert beside is None
    assert (
        why == f"No scores of the shipped policies and of blind replay are kept for {PROTOCOL}, because it is a draft."
    )
    assert beside_kept(RunScores(scores=[]), []) == (None, "")


def test_a_named_run_of_some_tasks_keeps_the_kept_trials_of_the_others(folder: Path) -> None:
    run, replay = scores_of("voxposer"), scores_of("replay")
    part = [s.model_copy(update={"safety_gated": False}) for s in replay.scores if s.task_id == "T1"]
    beside, _ = beside_kept(run, [RunScores(scores=part)], folders=[folder])
    assert beside is not None
    row = beside.baselines[0]
    assert (beside.completed, row.policy, row.n) == (("replay",), "replay", 14)
    assert {task: rates["safety_gated"] for task, rates in row.per_task.items()} == {"T1": (0, 7), "T3": (3, 7)}


def test_a_named_run_with_every_kept_trial_or_of_other_rules_stays_as_it_is(folder: Path) -> None:
    run, replay = scores_of("voxposer"), scores_of("replay")
    assert completed_from_kept(run, replay, folders=[folder]) is replay
    named = RunScores(scores=scores_of("replay", protocol_sha256="ab" * 32).scores[:1])
    assert completed_from_kept(run, named, folders=[folder]) is named


def test_the_rates_beside_a_run_are_computed_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[int] = []

    def counted(method: RunScores, baselines: Sequence[RunScores], *, kept: Sequence[RunScores] = ()) -> Baselines:
        calls.append(len(kept))
        return beside_baselines(method, baselines, kept=kept)

    monkeypatch.setattr(kept, "beside_baselines", counted)
    beside, _ = beside_kept(scores_of("voxposer"), [scores_of("replay")], folders=[folder])
    assert beside is not None
    assert calls == [len(beside.kept)]
