"""The results in docs/ are what the scores kept beside them say."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from carecontact.protocols import load_protocol
from carecontact.runs.stored_scores import read_scores

RESULTS = Path(__file__).resolve().parents[2] / "docs" / "results"
KEPT = sorted(RESULTS.glob("*/*.json.gz"))
PAGE = (RESULTS / "README.md").read_text()


@pytest.mark.parametrize("scores", KEPT, ids=lambda path: f"{path.parent.name} {path.name}")
def test_every_kept_run_is_whole_and_of_the_shipped_protocol(scores: Path) -> None:
    run = read_scores(scores)
    name, _, level = run.scores[0].protocol_id.partition(" ")
    protocol = load_protocol(name, level=level or None)
    assert scores.parent.name == protocol.title.replace(" ", "-")
    assert {score.protocol_sha256 for score in run.scores} == {protocol.sha256}
    assert not any(score.ended == "harness_error" for score in run.scores), "a void trial says nothing"
    seeds = {score.seed for score in run.scores}
    assert {(s.task_id, s.seed) for s in run.scores} == {(task.id, seed) for task in protocol.tasks for seed in seeds}


@pytest.mark.parametrize("scores", KEPT, ids=lambda path: f"{path.parent.name} {path.name}")
def test_the_page_has_the_rate_of_every_kept_run(scores: Path) -> None:
    """In a row that begins with the policy's name in backticks, as ``12 (19 %)``."""
    run = read_scores(scores)
    passed, policy = sum(score.safety_gated for score in run.scores), run.scores[0].policy
    rows = re.findall(rf"^\| `{re.escape(policy)}`.*$", PAGE, re.MULTILINE)
    assert any(f"| {passed} ({100 * passed / len(run.scores):.0f} %) |" in row for row in rows)
