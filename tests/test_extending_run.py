"""A stranger's action, region, metric, policy with an argument, and protocol, all in one real run."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

import carecontact
from carecontact.recording import read_recording

FOLDER = Path(__file__).parent / "extending"


def carecontact_outside(*command: str) -> subprocess.CompletedProcess[str]:
    paths = (str(Path(carecontact.__file__).parents[1]), str(FOLDER))
    return subprocess.run(
        [sys.executable, "-P", "-m", "carecontact", *command],
        cwd=FOLDER, env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)}, capture_output=True, text=True,
    )  # fmt: skip


def test_they_run_are_scored_and_stand_in_the_report(tmp_path: Path) -> None:
    done = carecontact_outside(
        "run", "--policy", "outside_press:Press", "--policy-arg", "press_mm=0", "--protocol", "holding-v1.toml",
        "--seeds", "0", "--out", str(tmp_path),
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    results = json.loads((tmp_path / "results.json").read_text())
    (trial,) = results["trials"]
    assert (trial["action"], trial["region"], trial["ended"]) == ("hold", "right_hand", "done")
    assert trial["c3_success"], trial["evidence"]
    assert trial["reported_segment"] == "right_hand"
    assert trial["policy_arguments"] == {"press_mm": "0"}
    assert 2.0 < trial["additional"]["mean_force@1"] < trial["c1_peak_force_n"]
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    for words in ("Hold right hand", "holding-v1", "Mean force of the touch", "outside_press:Press press_mm=0"):
        assert words in page, words


def test_an_action_space_and_a_control_run_and_stand_in_the_recording(tmp_path: Path) -> None:
    done = carecontact_outside(
        "run", "--policy", "outside_step:Step", "--tasks", "T1", "--seeds", "0", "--out", str(tmp_path)
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (file,) = tmp_path.glob("*.h5")
    recording = read_recording(file)
    assert recording.header.control == "soft-joints"
    steps = recording["actions/joint"]
    np.testing.assert_array_equal(steps[:9], np.tile([0, 0, 0, 0, 0, 0, 0.02], (9, 1)))
    # The hand turned about its axis, so the tool stayed where it was.
    pose = recording["scorer/pose_tcp_in_world"]
    assert np.abs(pose[-1, 3:] - pose[0, 3:]).max() > 0.02
    assert np.abs(pose[-1, :3] - pose[0, :3]).max() < 0.01
