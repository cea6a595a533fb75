from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from carecontact.errors import ConfigError, counted
from carecontact.recording import read_recording
from carecontact.trials.pace import ACT, BETWEEN, PACED, WARM_S, Pace, check_pace


class Clock:
    now = 100.0
    slept = 0.0

    def __call__(self) -> float:
        self.now += 1e-5
        return self.now

    def sleep(self, seconds: float) -> None:
        # As a system does: at times a little too short.
        self.now += max(seconds - 0.001, 1e-4)
        self.slept = self.now


@pytest.mark.parametrize(
    ("periods", "took_s", "leaves_s", "late"),
    [(1, 0.0, 0.5, 0), (1, 0.399, 0.5, 0), (3, 0.7, 1.5, 0), (1, 0.41, 1.0, 1), (1, 1.3, 1.5, 1), (2, 1.3, 1.5, 1)],
)
def test_an_observation_leaves_on_the_grid(periods: int, took_s: float, leaves_s: float, late: int) -> None:
    clock = Clock()
    pace = Pace(0.5, clock=clock, sleep=clock.sleep)
    pace.hold()
    assert clock.now == pytest.approx(100.0, abs=1e-3), "the first one answers nothing"
    pace.answered(periods)
    clock.now += took_s
    made: list[float] = []
    pace.hold(lambda: made.append(clock.now))
    assert clock.now == pytest.approx(100.0 + leaves_s, abs=1e-3)
    assert made == pytest.approx([100.0 + leaves_s - WARM_S], abs=1e-3)
    assert clock.slept < 100.0 + leaves_s - WARM_S + 1e-3, "it does not sleep after that"
    found = pace.arrays()
    assert found[BETWEEN] == pytest.approx([leaves_s], abs=1e-3)
    assert found[PACED].tolist() == [0.5, late]


def test_without_a_pace_nothing_waits_and_the_time_is_noted() -> None:
    clock = Clock()
    pace = Pace(None, clock=clock, sleep=clock.sleep)
    pace.hold()
    clock.now += 0.7
    pace.answered(1)
    clock.now += 0.3
    pace.hold()
    clock.now += 0.2
    pace.answered(1)
    assert {name: values.tolist() for name, values in pace.arrays().items()} == {
        BETWEEN: [pytest.approx(0.3, abs=1e-3)], ACT: [pytest.approx(t, abs=1e-3) for t in (0.7, 0.2)]
    }  # fmt: skip


@pytest.mark.parametrize("wrong", [0.1, -1.0, 5.1, float("nan")])
def test_a_pace_that_no_trial_can_keep_is_refused(wrong: float) -> None:
    with pytest.raises(ConfigError, match=r"--pace .*: must be above 0.1 s, because .* and at most 5 s"):
        check_pace(wrong)


POLICY = """
from carecontact.contract.action import Action
from carecontact.contract.policy import PolicyCard

class Still:
    card = PolicyCard(name="still")
    acts = 0
    def reset(self, instruction): pass
    def act(self, observation):
        self.acts += 1
        return [Action()] * (self.acts % 2) + [Action(done=self.acts == 4)]
"""


def test_a_run_keeps_its_pace_and_the_hash_stays(tmp_path: Path) -> None:
    def run(name: str, *options: str) -> str:
        command = [
            sys.executable, "-m", "carecontact", "run", "--policy", "still:Still", "--tasks", "T1", "--seeds", "0",
            "--fast", "--out", str(tmp_path / name), *options,
        ]  # fmt: skip
        return subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path).stdout

    (tmp_path / "still.py").write_text(POLICY)
    run("free")
    assert "not ready in time" not in run("paced", "--pace", "0.8")
    told = run("hasty", "--pace", "0.101")
    found = {name: read_recording(tmp_path / name / "T1-s000.h5") for name in ("free", "paced", "hasty")}
    assert len({recording.stored_sha256 for recording in found.values()}) == 1
    between = {name: recording[BETWEEN] for name, recording in found.items()}
    acts = len(found["free"]["policy/observation_time_s"])
    assert {len(times) for times in between.values()} == {acts - 1}
    assert acts == 4
    periods = np.bincount(found["free"]["actions/observation_index"])[: acts - 1]
    assert (between["paced"] >= 0.8 * periods).all()
    assert found["paced"][PACED].tolist() == [0.8, 0.0]
    late = int(found["hasty"][PACED][1])
    assert late > 0
    told_late = f"{counted(late, 'observation')} of 1 trial {'was' if late == 1 else 'were'} not ready in time"
    assert f"warning: --pace 0.101: {told_late}" in told
    assert (
        "0.8 s for each control period; observations came late in 0 of 1"
        in (tmp_path / "paced" / "report.html").read_text()
    )
