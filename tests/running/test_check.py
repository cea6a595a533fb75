"""`carecontact check` on faulty policies: each names its mistake, and a good one passes."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from carecontact.cli import main
from carecontact.errors import PolicyError
from carecontact.interface.action import Action
from carecontact.interface.observation import Observation
from carecontact.interface.policy import PolicyRef
from carecontact.running.check_answers import (
    joints_of,
    look_at_gripper,
    look_at_joints,
    look_at_polarity,
    numbers_of,
    table,
)
from carecontact.running.check_server import RepeatedRequest, health, latency_findings
from carecontact.serving.client import ActReply
from carecontact.serving.conversation import PolicyConversation
from tests.policies.synthetic import SESSION, synthetic_observation

PREAMBLE = """
import time
import numpy as np
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard

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
def test_a_policy_that_clips_is_warned_by_how_much(checked) -> None:
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
    monkeypatch.setattr("carecontact.running.check.BUDGET_S", 100.0)
    status, out = checked(FAST + ANSWER + "time.sleep(0.1); return Action()\n")
    assert status == 1
    assert "error    slow answer  a trial of 30 s would take" in out


def test_a_good_policy_passes(checked) -> None:
    status, out = checked(PREAMBLE, "--task", "T7", "--seed", "3")
    assert status == 0
    assert "the first observation of T7-s003, bathing-wide-v2 L2, twice" in out
    assert [line.split()[:2] for line in out.splitlines()[1:-1]] == [["ok", "card"], ["ok", "reset"], ["ok", "answer"]]
    assert out.endswith("a run can work; --deep also tests what each input and each axis does\n")


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
def test_a_card_that_is_refused_is_one_message_with_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    head = "from carecontact.interface.policy import PolicyCard\n"
    whole = "class W:\n    card = PolicyCard(name='w', modalities=('rgbd',), cameras=('overhead',))\n"
    late = (
        "class W:\n    def reset(self, instruction): ...\n    def act(self, observation): ...\n"
        "    @property\n    def card(self): return PolicyCard(name='w', control_hz=-1)\n"
    )
    for module, topic, text, line, says in (
        ("refused_whole", "import   ", whole, 3, "PolicyCard.modalities: expected a tuple of names"),
        ("refused_late", "exception", late, 6, "PolicyCard.control_hz: expected a number from 1 to 50 [Hz], got -1"),
    ):
        (tmp_path / f"{module}.py").write_text(head + text)
        assert main(["check", f"{module}:W"]) == 1
        out = capsys.readouterr().out
        assert f"error    {topic}    {says}" in out
        assert f"{module}.py, line {line})" in out
        assert "Traceback" not in out
        assert len(out.splitlines()) == 3


def test_a_refusal_that_says_what_it_looks_like_has_no_second_hint(checked) -> None:
    _, out = checked(PREAMBLE + ANSWER + "return Action(pose_tcp_in_base=self.pose * 0)\n")
    assert "norm 1, got 0; the position [0.0, 0.0, 0.0] looks like a difference" in out
    assert "hint" not in out


# What numbers look like, from the numbers alone.

VELOCITY, POSITION = "droid_joint_velocity", "joint_position"
POSTURES = {
    "bathing-v3": np.array([0.53, -0.39, 0.36, -1.84, 0.14, 1.47, 1.14]),
    "DROID": np.array([0.0, -0.628, 0.0, -2.513, 0.0, 1.885, 0.0]),
}


def topics(joints: np.ndarray, space: str, now: np.ndarray) -> list[str]:
    return [found.topic for found in look_at_joints(joints, space=space, now=now)]


@pytest.mark.parametrize("posture", POSTURES)
def test_what_looks_right_and_what_looks_wrong(posture: str) -> None:
    now, rng = POSTURES[posture], np.random.default_rng(0)
    for size in (0.0, 0.02, 0.3, 1.0):
        velocities = rng.uniform(-size, size, (15, 7))
        targets = now + np.cumsum(velocities, axis=0) * 0.05
        assert topics(velocities, VELOCITY, now) == []
        assert topics(targets, POSITION, now) == []
        assert topics(targets, VELOCITY, now) == ["velocities"]
        assert topics(np.degrees(targets), VELOCITY, now) == ["degrees"]
        assert topics(np.degrees(targets), POSITION, now) == ["degrees"]
    assert topics(rng.uniform(-0.3, 0.3, (15, 7)), POSITION, now) == ["targets"]
    # The fastest velocities, toward the angles that the arm has: nothing looks more like targets.
    assert topics(np.tile(np.clip(now, -1, 1), (15, 1)), VELOCITY, now) == []
    assert topics(rng.uniform(-2, 2, (15, 7)), VELOCITY, now) == ["velocities"]


@pytest.mark.parametrize(
    ("commands", "level"),
    [
        *(([1, 1], None), ([0, 1], None), ([0, 0.1], "hint"), ([-0.05, 1.05], None)),
        *((wrong, "warning") for wrong in ([0, 1.3], [-1, 1], [0, 255])),
    ],
)
def test_the_gripper(commands: list[float], level: str | None) -> None:
    assert [found.level for found in look_at_gripper(np.array(commands))] == ([] if level is None else [level])


def test_polarity() -> None:
    zero, one = np.zeros(3), np.ones(3)
    assert [found.level for found in look_at_polarity(zero, one)] == ["warning"]
    assert list(look_at_polarity(one, zero)) == []
    assert list(look_at_polarity(zero, zero)) == []


def test_the_table() -> None:
    values = np.zeros((4, 9))
    values[1, 2] = np.nan
    values[:, 3] = np.nan
    lines = table(values, now=np.arange(7.0), kind="joints")
    assert " ".join(lines[2].split()) == "joint 3 0.000 to 0.000; the angle is 2.000 rad; 1 of 4 are not finite"
    assert "no number" in lines[3]
    assert lines[7].startswith("gripper")
    assert lines[8].startswith("column 9, unknown")


def test_numbers_of_actions() -> None:
    joint = np.arange(7.0)
    assert joints_of([Action(joint=joint), Action()]) is None
    assert (joints_of([Action(joint=joint)]) == joint).all()
    numbers = numbers_of([Action(joint=joint, gripper=0.5), Action(done=True)])
    assert numbers.shape[0] == 2
    assert 0.5 in numbers[0]
    assert numbers[1].sum() == 1


# Requests one after another, with policies that take one reset for each connection or refuse a request.


@dataclass
class Conversation:
    """In place of a PolicyConversation."""

    resets: int = 0
    most_resets: int = 99
    calls: list[str] = field(default_factory=list)

    def start(self) -> None:
        self.calls.append("start")

    def reset(self, instruction: str, session: Any) -> None:
        self.resets += 1
        if self.resets > self.most_resets:
            raise PolicyError("garbage", "one reset is enough")

    def act(self, observation: Observation) -> ActReply:
        if observation.instruction == "refuse":
            raise PolicyError("exception", "no")
        return ActReply(actions=[Action(gripper=0.5)], sent=b"", sent_sha256=b"")

    def close(self) -> None:
        self.calls.append("close")


def asking(*conversations: Conversation) -> tuple[RepeatedRequest, list[Any]]:
    listened: list[Any] = []
    first, *others = conversations
    left = iter(others)
    made = RepeatedRequest(
        cast(PolicyConversation, first),
        SESSION,
        check=lambda action: None,
        listen=listened.append,
        reopen=lambda: cast(PolicyConversation, next(left)),
    )
    return made, listened


def test_a_policy_that_takes_one_reset_is_connected_again() -> None:
    conversations = [Conversation(most_resets=1) for _ in range(3)]
    made, listened = asking(*conversations)
    with closing(made):
        for _ in range(3):
            assert made.ask(synthetic_observation(), may_refuse=False) is not None
    assert listened == conversations[1:]
    # The caller closes the first one, which is its own.
    assert [c.calls for c in conversations] == [[], ["start", "close"], ["start", "close"]]
    assert len(made.took_s) == 3


def test_a_refusal_connects_again_and_one_that_may_not_be_is_raised() -> None:
    refused = replace(synthetic_observation(), instruction="refuse")
    made, listened = asking(Conversation(), Conversation())
    with closing(made):
        assert made.ask(refused, may_refuse=True) is None
        assert len(listened) == 1
        assert made.ask(synthetic_observation(), may_refuse=True) is not None
        with pytest.raises(PolicyError, match="no"):
            made.ask(refused, may_refuse=False)
    assert len(made.took_s) == 1


# What a server says of its health, and what is no mistake.


@contextmanager
def answering(pages: dict[str, tuple[int, bytes]]) -> Iterator[int]:
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            status, text = pages.get(self.path, (404, b"nothing here"))
            self.send_response(status)
            self.end_headers()
            self.wfile.write(text)

        def log_message(self, *args: object) -> None:
            pass

    server = HTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield server.server_port
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@pytest.mark.parametrize(
    ("scheme", "path"),
    [("openpi", "/healthz"), ("roboarena", "/healthz"), ("roboarena", "/health"), ("vla-eval", "/health")],
)
def test_a_healthy_server(scheme: str, path: str) -> None:
    with answering({path: (200, b"OK\n")}) as port:
        found = health(PolicyRef.parse(f"{scheme}://127.0.0.1:{port}"))
    assert found is not None
    assert (found.level, found.text) == ("ok", f"{path} answers OK")


def test_a_sick_server() -> None:
    with answering({"/healthz": (503, b"loading \x1b[31m")}) as port:
        found = health(PolicyRef.parse(f"openpi://127.0.0.1:{port}"))
    assert found is not None
    assert (found.level, found.text) == ("warning", "/healthz answers HTTP 503 loading \\x1b[31m")


def test_no_such_address_and_no_server_are_no_mistake() -> None:
    with answering({}) as port:
        assert health(PolicyRef.parse(f"vla-eval://127.0.0.1:{port}")) is None
    assert health(PolicyRef.parse("openpi://127.0.0.1:9")) is None
    assert health(PolicyRef.parse("ws://127.0.0.1:9")) is None
    assert health(PolicyRef.parse("hover")) is None


# Findings about the time that calls take.


def test_percentiles_and_what_a_trial_waits() -> None:
    (found,) = latency_findings([0.1] * 9 + [0.4], seconds=0.5, limit_s=30)
    assert found.text.startswith("p50 100 ms, p95 265 ms over 10 calls; each gives 0.50 s of motion")
    assert found.text.endswith("a trial of 30 s makes 60 of them and waits 6 s")


def test_some_slow_calls() -> None:
    assert [found.level for found in latency_findings([0.1] * 8 + [2, 2], seconds=0.5, limit_s=30)] == ["ok", "hint"]
