"""A frozen protocol simulates today what it simulated when its results were made."""

from __future__ import annotations

import platform
from pathlib import Path

import pytest

from carecontact.cli import main
from carecontact.runs.stored_scores import read_scores

RESULTS = Path(__file__).resolve().parents[2] / "docs" / "results"


@pytest.mark.skipif(platform.machine().lower() not in ("x86_64", "amd64"), reason="other processors round otherwise")
@pytest.mark.parametrize(("task", "seed"), [("T3", 1003), ("T7", 1004)])
def test_a_trial_of_the_exam_comes_out_as_it_did(task: str, seed: int, tmp_path: Path) -> None:
    """Bit for bit, with a policy to which no picture is sent, so that no renderer counts."""
    kept = read_scores(RESULTS / "bathing-wide-v1-L1" / "replay.json.gz").scores
    (before,) = (score for score in kept if (score.task_id, score.seed) == (task, seed))
    assert before.valid_contact
    run = ["run", "--policy", "replay", "--protocol", "bathing-wide-v1", "--level", "L1", "--tasks", task]
    assert main([*run, "--seeds", str(seed), "--out", str(tmp_path / "run")]) == 0
    (now,) = read_scores(tmp_path / "run").scores
    assert now.recording_sha256 == before.recording_sha256
    assert now.world == before.world
