"""A policy that crashes, hangs, is killed or answers NaN, through real trials: status, headline, traceback."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import carecontact

SOURCES = str(Path(carecontact.__file__).parents[1])
POLICY = """
import os, signal, time
import numpy as np
from carecontact.contract.action import Action
from carecontact.contract.policy import PolicyCard

class Faulty:
    card = PolicyCard(name="faulty", modalities=("rgb",), cameras=("wrist",))
    def reset(self, instruction): print("these were", "its last words", flush=True)
    def act(self, observation):
        {act}
"""
FAULTS = {
    "crashing": ("raise ValueError('no grip here')", "ValueError: no grip here"),
    "hanging": ("time.sleep(600)", "no actions message within 6 s"),
    "killed": ("os.kill(os.getpid(), signal.SIGKILL)", "killed by SIGKILL"),
    "NaN": ("return [Action(pose_tcp_in_base=np.full(7, np.nan))]", "nan"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_policy_that_fails_ends_with_status_3_and_its_traceback(tmp_path: Path, fault: str) -> None:
    act, told = FAULTS[fault]
    (tmp_path / "my.py").write_text(POLICY.replace("{act}", act))
    done = subprocess.run(
        [
            sys.executable, "-m", "carecontact.cli", "run", "--policy", "my:Faulty", "--tasks", "T1", "--seeds", "0",
            "--out", "r", "--fast", "--set", "phases.first_call_deadline_s=6",
        ],
        cwd=tmp_path, env={**os.environ, "PYTHONPATH": SOURCES}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 3, done.stderr
    assert "the policy crashed in 1 of 1 trial(s); see r/T1-s000.log" in done.stdout
    assert "  | these were its last words" in done.stdout
    assert told in done.stdout
    assert "safe failure: 0; unsafe success: 0; unsafe failure: 0; crashed: 1" in done.stdout
    page = (tmp_path / "r" / "report.html").read_text()
    assert re.search(r"<h1>my:Faulty crashed in its only trial", page)
    (shown,) = re.findall(r"<details>.*?<pre>(.*?)</pre></details>", page, re.DOTALL)
    assert told in shown
    assert "these were its last words" in shown
    assert ("Traceback" in shown) == (fault == "crashing")
