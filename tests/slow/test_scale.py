"""Real trials: four parts that are one run, and a sweep that is killed twice."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import pytest

from carecontact.recording import stored_sha256
from carecontact.runs import score_run
from carecontact.runs.manifest import MANIFEST

pytestmark = pytest.mark.slow
COMMAND = (sys.executable, "-m", "carecontact")
RUN = ("run", "--policy", "zero-action", "--tasks", "T1", "--seeds", "0-3", "--set", "phases.time_limit_s=1")
PLAN = """
tasks = "T1"
seeds = "0-2"
rank_by = "success"

[[policies]]
policy = "state-machine"

[[policies]]
policy = "zero-action"

[axes]
body = ["man-adult", "woman-old-light", "man-old-heavy"]
tissue = ["human-published", "manikin-like"]

[set]
"phases.time_limit_s" = 9
"""


def carecontact(arguments: Sequence[str], folder: Path) -> None:
    subprocess.run([*COMMAND, *arguments], cwd=folder, check=True, stdout=subprocess.DEVNULL)


def test_four_parts_of_real_trials_are_one_run_bit_for_bit(tmp_path: Path) -> None:
    carecontact([*RUN, "--out", "whole"], tmp_path)
    for k in range(1, 5):
        carecontact([*RUN, "--shard", f"{k}/4", "--out", f"part-{k}"], tmp_path)
    carecontact(["merge", "merged", *(f"part-{k}" for k in range(1, 5))], tmp_path)
    whole, merged = ({path.name: path for path in (tmp_path / name).iterdir()} for name in ("whole", "merged"))
    assert whole.keys() == merged.keys()
    for name in ("results.json", "results.parquet", "manifest.json"):
        assert whole[name].read_bytes() == merged[name].read_bytes(), name
    recordings = sorted(name for name in whole if name.endswith(".h5"))
    assert len(recordings) == 4
    # The files also hold wall times, which no hash covers.
    assert [stored_sha256(whole[name]) for name in recordings] == [stored_sha256(merged[name]) for name in recordings]


def test_a_sweep_that_is_killed_twice_resumes_and_its_table_is_right(tmp_path: Path) -> None:
    (tmp_path / "p.toml").write_text(PLAN)
    command = [*COMMAND, "sweep", "p.toml", "--out", "s"]
    made: dict[Path, int] = {}
    for stored in (7, 20):
        running = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL, start_new_session=True)
        until = time.monotonic() + 600
        while len(list(tmp_path.glob("s/cells/*/*.h5"))) < stored and time.monotonic() < until:
            assert running.poll() is None
            time.sleep(0.05)
        os.kill(running.pid, signal.SIGKILL)
        running.wait()
        earlier = {path: path.stat().st_mtime_ns for path in tmp_path.glob("s/cells/*/*.h5")}
        assert made.items() <= earlier.items(), "no finished trial ran again"
        made = earlier
        assert not (tmp_path / "s/sweep.csv").exists()
    subprocess.run(command, cwd=tmp_path, check=True, stdout=subprocess.DEVNULL)
    now = {path: path.stat().st_mtime_ns for path in tmp_path.glob("s/cells/*/*.h5")}
    assert made.items() <= now.items()
    assert len(now) == 36

    with (tmp_path / "s/sweep.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 12
    for row in rows:
        cell = tmp_path / "s" / row["folder"]
        manifest = json.loads((cell / MANIFEST).read_text())
        overrides = manifest["protocol"]["overrides"]
        assert manifest["policy"] == row["policy"]
        assert overrides.get("person.body", "man-adult") == row["body"]
        assert overrides.get("person.tissue_set", "human-published") == row["tissue"]
        scores = score_run(cell).scores
        assert [score.trial_id for score in scores] == ["T1-s000", "T1-s001", "T1-s002"]
        assert int(row["success"]) == sum(score.c3_success for score in scores)
        assert int(row["trials"]) == 3
    won = {row["policy"]: 0 for row in rows}
    for row in rows:
        won[row["policy"]] += int(row["success"])
    assert won["zero-action"] == 0
    assert won["state-machine"] > 9
    first = next(
        line for line in (tmp_path / "s/sweep.md").read_text().splitlines() if line.startswith("state-machine (")
    )
    assert first.startswith(f"state-machine ({100 * won['state-machine'] / 18:.0f}")
