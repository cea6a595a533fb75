"""`carecontact check` on faulty policies: each names its mistake, and a good one passes."""

from __future__ import annotations

from pathlib import Path

import pytest

from carecontact.cli import main

PREAMBLE = """
import time
import numpy as np
from carecontact.contract.action import Action
from carecontact.contract.policy import PolicyCard

class P:
    card = PolicyCard(name="under test", cameras=(), control_hz=1)

    def reset(self, instruction):
        pass

    def act(self, observation):
        self.pose = observation.pose_tcp_in_base.copy()
        return self.answer()

    def answer(self):
        return Action(pose_tcp_in_base=self.pose)
"""
FAST = PREAMBLE.replace("control_hz=1", "control_hz=50")
"""Its one action lasts 0.02 s, and that of PREAMBLE longer than a call on a machine with other work."""
ANSWER = "\n    def answer(self):\n        "


@pytest.fixture
def checked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.chdir(tmp_path)

    def check(source: str, *options: str) -> tuple[int, str]:
        (tmp_path / "under_test.py").write_text(source)
        status = main(["check", "under_test:P", *options])
        return status, capsys.readouterr().out

    return check


FAULTS = {
    "import": ("import nowhere\n" + PREAMBLE, "error    import", "ModuleNotFoundError: No module named 'nowhere'"),
    "card": (PREAMBLE + "    card = {'name': 'mine'}\n", "error    card", "expected a PolicyCard, got dict"),
    "card field": (
        PREAMBLE.replace("control_hz=1", "control_hz=500"), "error    import", "a number from 1 to 50 [Hz], got 500",
    ),
    "exception": (PREAMBLE + ANSWER + "return self.nothing\n", "error    exception", "has no attribute 'nothing'"),
    "shape": (PREAMBLE + ANSWER + "return Action(pose_tcp_in_base=self.pose[:6])\n", "error    answer", "7 numbers"),
    "no action": (PREAMBLE + ANSWER + "return self.pose\n", "error    answer", "expected an Action or a list"),
    "NaN": (
        PREAMBLE + ANSWER + "return Action(pose_tcp_in_base=self.pose * np.nan)\n", "error    answer", "division by 0",
    ),
    "out of bounds": (
        PREAMBLE + ANSWER + "return Action(pose_tcp_in_base=self.pose + [9, 0, 0, 0, 0, 0, 0])\n", "error    answer",
        "out_of_bounds clip",
    ),
    "norm": (
        PREAMBLE + ANSWER + "return Action(pose_tcp_in_base=self.pose * [1, 1, 1, 2, 2, 2, 2])\n", "error    answer",
        "norm 1",
    ),
    "stiffness": (PREAMBLE + ANSWER + "return Action(stiffness=(5000, 20))\n", "error    answer", "100 to 1000 N/m"),
}  # fmt: skip


@pytest.mark.usefixtures("same_world")
@pytest.mark.parametrize("name", FAULTS)
def test_an_error_is_named_and_a_run_would_fail(checked, name: str) -> None:
    source, begins, says = FAULTS[name]
    status, out = checked(source)
    assert status == 1
    assert begins in out
    assert says in out
    assert "a run would fail" in out


SUSPECTS = {
    "slow answer": ("time.sleep(0.1); return Action()", " s for 0.02 s of motion"),
    "gripper": ("return Action(gripper=1.0)", "here 1 is open and 0 is closed"),
    "difference": ("return Action(pose_tcp_in_base=np.array([0.01, 0, 0, *self.pose[3:]]))", "send absolute poses"),
    "position": ("return Action(pose_tcp_in_base=self.pose + [0.5, 0, 0, 0, 0, 0, 0])", "0.50 m away"),
    "quaternion": ("return Action(pose_tcp_in_base=np.r_[self.pose[:3], np.roll(self.pose[3:], -1)])", "order w x y z"),
    "orientation": ("return Action(pose_tcp_in_base=np.r_[self.pose[:3], 0, 0, 0, 1])", "out of the tool"),
    "done": ("return Action(done=True)", "before the robot moves"),
}


@pytest.mark.usefixtures("same_world")
@pytest.mark.parametrize("topic", SUSPECTS)
def test_what_the_contract_accepts_but_is_probably_wrong_is_a_warning(checked, topic: str) -> None:
    answer, says = SUSPECTS[topic]
    status, out = checked((FAST if topic == "slow answer" else PREAMBLE) + ANSWER + answer + "\n")
    assert status == 0
    assert out.endswith("look at the 1 warning first\n"), out
    assert f"warning  {topic}" in out
    assert says in out


@pytest.mark.usefixtures("same_world")
def test_a_policy_that_clips_is_told_how_much(checked) -> None:
    clips = PREAMBLE.replace("control_hz=1", "control_hz=1, out_of_bounds='clip'")
    status, out = checked(
        clips + ANSWER + "return [Action(), Action(pose_tcp_in_base=self.pose + [0, 0, 9, 0, 0, 0, 0])]\n"
    )
    assert status == 0
    assert "warning  clipped      1 of 2 targets" in out
    assert "millimetres" not in out
    _, out = checked(clips + ANSWER + "return Action(pose_tcp_in_base=self.pose * [1e3, 1e3, 1e3, 1, 1, 1, 1])\n")
    assert "moved onto its border; the first of them looks like millimetres: send metres" in out


@pytest.mark.usefixtures("same_world")
def test_an_answer_that_uses_up_the_budget_is_an_error(checked, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("carecontact.trials.check.BUDGET_S", 100.0)
    status, out = checked(FAST + ANSWER + "time.sleep(0.1); return Action()\n")
    assert status == 1
    assert "error    slow answer  a trial of 30 s would take" in out


def test_a_good_policy_passes(checked) -> None:
    status, out = checked(PREAMBLE, "--task", "T7", "--seed", "3")
    assert status == 0
    assert "the first observation of T7-s003, bathing-v3-draft, twice" in out
    assert [line.split()[:2] for line in out.splitlines()[1:-1]] == [["ok", "card"], ["ok", "reset"], ["ok", "answer"]]
    assert out.endswith("a run can work\n")


def test_nothing_listens(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "ws://127.0.0.1:9"]) == 1
    out = capsys.readouterr().out
    assert "error    connection" in out
    assert "nothing listens at 127.0.0.1:9" in out


OWN_FRAMES = {
    "a misspelt class": ("under_test:PP", "ImportError: under_test has no 'PP'; it has P"),
    "a misspelt module": ("under_tset:P", "ModuleNotFoundError: No module named 'under_tset'"),
    "no policy": ("under_test:Action", "TypeError: under_test:Action has no method reset or act"),
}


@pytest.mark.parametrize("name", OWN_FRAMES)
def test_a_traceback_of_our_own_frames_is_not_shown(
    name: str, checked, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    checked(PREAMBLE + "    card = None\n")
    target, says = OWN_FRAMES[name]
    assert main(["check", target]) == 1
    out = capsys.readouterr().out
    assert out.splitlines()[1].startswith(f"error    import       {says}")
    assert len(out.splitlines()) == 3
    assert "Traceback" not in out


def test_a_traceback_with_a_frame_of_the_policy_is_shown(checked) -> None:
    _, out = checked(PREAMBLE + "    raise RuntimeError('no weights')\n")
    assert "Traceback" in out
    assert 'under_test.py", line' in out


@pytest.mark.usefixtures("same_world")
def test_a_refusal_that_says_what_it_looks_like_has_no_second_hint(checked) -> None:
    _, out = checked(PREAMBLE + ANSWER + "return Action(pose_tcp_in_base=self.pose * 0)\n")
    assert "norm 1, got 0; the position [0.0, 0.0, 0.0] looks like a difference" in out
    assert "hint" not in out
