"""Recordings that stand keep their scores: in another process to the last bit, in another release to nine digits."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

import carecontact
from carecontact.recording import read_recording
from carecontact.runs import score_run
from tests.golden.make import FOLDER, SCORES, golden

RELATIVE = 1e-9
"""Another processor may add in another order; a definition that changed does not hide in nine digits."""
REHASHED = {"protocol_sha256"}
"""Changes when a later release gives the protocol a field with a default, and no number with it."""

CHILD = """
import hashlib, sys
from carecontact.runs import score_run
run = score_run(sys.argv[1])
assert not run.skipped, run.skipped
for score in run.scores:
    print(score.trial_id, hashlib.sha256(score.model_dump_json().encode()).hexdigest())
"""


def hashes_of_a_fresh_process() -> dict[str, str]:
    done = subprocess.run(
        [sys.executable, "-c", CHILD, str(FOLDER)],
        env={**os.environ, "PYTHONPATH": str(Path(carecontact.__file__).parents[1])},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return dict(line.split() for line in done.stdout.splitlines())


def test_a_fresh_process_agrees_to_the_last_bit() -> None:
    fresh = hashes_of_a_fresh_process()
    here = {s.trial_id: hashlib.sha256(s.model_dump_json().encode()).hexdigest() for s in score_run(FOLDER).scores}
    assert len(fresh) == 7
    assert fresh == here


def test_scores_are_as_they_were() -> None:
    expected: dict[str, dict[str, Any]] = json.loads(SCORES.read_text())
    found = {s.trial_id: s.model_dump(mode="json") for s in score_run(FOLDER).scores}
    assert found.keys() == expected.keys()
    moved = {
        f"{trial}.{field}": (value, found[trial][field])
        for trial, row in expected.items()
        for field, value in row.items()
        if field not in REHASHED and not same(value, found[trial][field])
    }
    assert moved == {}


def same(before: Any, now: Any) -> bool:
    if isinstance(before, dict) and isinstance(now, dict):
        return all(key in now and same(value, now[key]) for key, value in before.items())
    if isinstance(before, float) and isinstance(now, float):
        return abs(before - now) <= RELATIVE * max(abs(before), 1e-6)
    return type(before) is type(now) and before == now


def test_the_files_are_small_and_what_their_maker_makes() -> None:
    """To what float32 holds: a sine need not have the same last bit everywhere."""
    made = {r.header.spec.trial_id: r for r in golden()}
    assert {path.stem for path in FOLDER.glob("*.h5")} == made.keys()
    for path in FOLDER.glob("*.h5"):
        assert path.stat().st_size < 100_000
        stored = read_recording(path)
        assert stored.arrays.keys() == made[path.stem].arrays.keys()
        for name, array in stored.arrays.items():
            np.testing.assert_allclose(array, made[path.stem][name], rtol=1e-5, atol=1e-6, err_msg=f"{path}: {name}")


def test_they_cover_the_funnel() -> None:
    scores = json.loads(SCORES.read_text()).values()
    assert {s["safety_gated"] + s["region_correct"] + s["c3_success"] for s in scores} >= {0, 1, 2, 3}
    assert {s["anatomy"] for s in scores} >= {"target", "none", "process_failure"}


def test_a_score_that_moved_is_seen() -> None:
    assert same({"a": 1.0}, {"a": 1.0 + 1e-12, "b": 2})
    assert not same({"a": 1.0}, {"a": 1.0 + 1e-6})
    assert not same(1.0, None)
    assert not same(0, 0.0)
