"""A stranger's action, region, metric, policy with an argument, and protocol, all in one real run."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import carecontact

FOLDER = Path(__file__).parent / "extending"


def test_they_run_are_scored_and_stand_in_the_report(tmp_path: Path) -> None:
    paths = (str(Path(carecontact.__file__).parents[1]), str(FOLDER))
    run = ["run", "--policy", "outside_press:Press", "--policy-arg", "press_mm=0", "--protocol", "holding-v1.toml"]
    done = subprocess.run(
        [sys.executable, "-P", "-m", "carecontact.cli", *run, "--seeds", "0", "--out", str(tmp_path)],
        cwd=FOLDER, env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)}, capture_output=True, text=True,
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
