"""A frozen protocol simulates today what it simulated when its results were made."""

from __future__ import annotations

import platform
from pathlib import Path

import pytest

from carecontact.cli import main
from carecontact.recording.provenance import arithmetic
from carecontact.runs.stored_scores import read_scores

RESULTS = Path(__file__).resolve().parents[2] / "docs" / "results"

POLICY = {"L1": "replay", "L3": "oracle"}
"""On L3 the person breathes and moves, and the oracle touches it all the same."""
NOISE_SALT = "9f9ae38b0a8a17b62e2254fde0d0fa2a"
"""That of the results of L2 and L3."""
THERE = "openblas 0.3.31.188.0 SkylakeX on x86_64 with glibc 2.36"
"""What rounded the numbers of the results. Another library changes the last bits of the model, and contact amplifies
them: the peak force by up to 0.2 % with kernels for processors without AVX-512."""
NEAR = 0.1
JUDGED = ("valid_contact", "region_correct", "c3_success", "safety_gated")
MEASURED = ("c1_peak_force_n", "c4_motion_activity", "c5_force_sd_n", "contact_s", "stroke_m", "impulse_ns")


@pytest.mark.skipif(platform.machine().lower() not in ("x86_64", "amd64"), reason="other processors round otherwise")
@pytest.mark.parametrize(("level", "task", "seed"), [("L1", "T3", 1003), ("L3", "T3", 1008)])
def test_a_trial_of_the_exam_comes_out_as_it_did(level: str, task: str, seed: int, tmp_path: Path) -> None:
    """To the last digit where numbers are rounded as they were there. The policy is sent no picture, so no renderer
    counts."""
    kept = read_scores(RESULTS / f"bathing-wide-v1-{level}" / f"{POLICY[level]}.json.gz").scores
    (before,) = (score for score in kept if (score.task_id, score.seed) == (task, seed))
    assert before.valid_contact
    run = ["run", "--policy", POLICY[level], "--protocol", "bathing-wide-v1", "--level", level, "--tasks", task]
    run += [] if level == "L1" else ["--noise-salt", NOISE_SALT]
    assert main([*run, "--seeds", str(seed), "--out", str(tmp_path / "run")]) == 0
    (now,) = read_scores(tmp_path / "run").scores
    assert {name: getattr(now, name) for name in JUDGED} == {name: getattr(before, name) for name in JUDGED}
    for name in MEASURED:
        assert getattr(now, name) == pytest.approx(getattr(before, name), rel=NEAR), name
    assert {**now.world, **before.world} == now.world
    if arithmetic() == THERE:
        assert {name: getattr(now, name) for name in MEASURED} == {name: getattr(before, name) for name in MEASURED}
        assert now.provenance["model"] == before.provenance["model"]
