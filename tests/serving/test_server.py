"""The wire in the documentation against the code: bytes of messages, names in tables, limits."""

from __future__ import annotations

import dataclasses
import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import msgpack
import numpy as np
import pytest

from carecontact.errors import PolicyError
from carecontact.interface.action import MAX_CHUNK, Action
from carecontact.interface.body_view import LANDMARK
from carecontact.interface.observation import CameraView, LastViews, Observation
from carecontact.interface.policy import PolicyCard
from carecontact.protocol.load import load_protocol
from carecontact.serving import codec, server
from carecontact.serving.codec import act_message
from carecontact.serving.conversation import BUDGET_S
from carecontact.serving.packing import (
    DTYPES,
    MAX_DEPTH,
    MAX_ITEMS,
    MAX_MESSAGE_BYTES,
    MAX_REPLY_BYTES,
    MAX_TEXT_BYTES,
    unpack,
)
from carecontact.serving.process import PolicyProcess
from carecontact.serving.server import TRACEBACK_CHARS, traceback_text
from tests.policies.synthetic import SESSION, synthetic_observation, synthetic_view
from tests.serving.conftest import Launch

ROOT = Path(__file__).parents[2]
OBSERVED = np.array([0.25, 0.375, 0.5, 0.0, 1.0, 0.0, 0.0])
BYTES = (ROOT / "docs" / "evidence" / "wire-bytes.md").read_text(encoding="utf-8")
PAGE = (ROOT / "docs" / "your-policy.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    spec = importlib.util.spec_from_file_location("wire_page", ROOT / "tools" / "wire_page.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def test_the_bytes_on_the_page_are_those_of_the_code(tool: ModuleType) -> None:
    assert tool.filled(BYTES) == BYTES, "run tools/wire_page.py"
    assert set(re.findall(r"<!-- message: (\w+) -->", BYTES)) == set(tool.messages())


def test_the_dumps_can_be_read_back(tool: ModuleType) -> None:
    for name, dump in re.findall(r"<!-- message: (\w+) -->.*?```text\n(.*?)\n```", BYTES, re.DOTALL):
        data = b"".join(bytes.fromhex(line[6:39]) for line in dump.splitlines())
        assert data == tool.messages()[name]
        assert unpack(data)["type"] == name.removesuffix("_list")


def test_a_plain_list_is_the_same_action(tool: ModuleType) -> None:
    array, plain = (
        codec.decode_actions(unpack(tool.messages()[name])["actions"]) for name in ("actions", "actions_list")
    )
    np.testing.assert_array_equal(array[0].pose_tcp_in_base, plain[0].pose_tcp_in_base)


def test_an_ordinary_msgpack_library_reads_and_writes_them(tool: ModuleType) -> None:
    for data in tool.messages().values():
        assert msgpack.packb(msgpack.unpackb(data)) == data


@pytest.mark.parametrize(
    ("heading", "kinds", "own"),
    [
        ("The card", (PolicyCard,), set()),
        ("The observation", (Observation, CameraView), set()),
        ("The action", (Action,), set()),
    ],
)
def test_every_field_stands_in_its_table(heading: str, kinds: tuple[type, ...], own: set[str]) -> None:
    section = re.split(r"^## ", PAGE, flags=re.MULTILINE)
    (text,) = [part for part in section if part.startswith(f"{heading}\n")]
    rows = {name for row in re.findall(r"^\| (`.*?) \|", text, re.MULTILINE) for name in re.findall(r"`(\w+)`", row)}
    fields = {field.name for kind in kinds for field in dataclasses.fields(kind)}
    assert rows == fields - own


def test_the_page_s_python_reads_and_writes_messages(tool: ModuleType) -> None:
    (block,) = re.findall(r"```python\n(def decode_array.*?)```", PAGE, re.DOTALL)
    answer = {"type": "actions", "actions": [{"pose_tcp_in_base": OBSERVED, "done": np.bool_(True)}]}
    scope = {"np": np, "msgpack": msgpack, "frame": tool.messages()["act"], "answer": answer}
    exec(block, scope)
    np.testing.assert_array_equal(scope["message"]["observation"]["cameras"]["overhead"]["rgb"].ravel(), np.arange(6))
    (action,) = codec.decode_actions(unpack(scope["frame"])["actions"])
    np.testing.assert_array_equal(action.pose_tcp_in_base, OBSERVED)
    assert action.done


def test_the_limits_are_those_of_the_code() -> None:
    phases = load_protocol("bathing-v3").phases
    for stated in (
        f"{phases.first_call_deadline_s:g} s each",
        f"{phases.call_deadline_s:g} s (`phases.call_deadline_s`)",
        f"{BUDGET_S / 3600:g} hour",
        f"{MAX_MESSAGE_BYTES >> 20} MiB; {MAX_REPLY_BYTES >> 20} MiB",
        f"{MAX_ITEMS:,} entries",
        f"{MAX_TEXT_BYTES >> 10} KiB",
        f"{MAX_DEPTH} levels",
        f"1 to {MAX_CHUNK:,} actions",
        *DTYPES,
    ):
        assert stated in PAGE, stated


def test_the_instructions_and_the_landmarks_are_those_of_the_code() -> None:
    text = " ".join(PAGE.split())
    exam = load_protocol("bathing-wide-v2", level="L2")
    assert all(f'"{exam.task(task.id).prompt}"' in text for task in exam.tasks)
    left = [LANDMARK[f"left {joint}"] for joint in ("shoulder", "elbow", "wrist", "hip")]
    right = [LANDMARK[f"right {joint}"] for joint in ("shoulder", "elbow", "wrist", "hip")]
    assert f"{left[0]}, {left[1]}, {left[2]} and {left[3]} are the person's left shoulder, elbow, wrist and hip" in text
    assert f"and {right[0]}, {right[1]}, {right[2]} and {right[3]} the right ones" in text


@pytest.mark.parametrize(("message", "kept"), [("short", "\nValueError: short\n"), ("x" * 5000, "xxx [...]")])
def test_of_a_long_traceback_the_end_of_the_stack_and_the_start_of_the_message_are_kept(
    message: str, kept: str
) -> None:
    error: BaseException = ValueError(message)
    error.__cause__ = RuntimeError("earlier\n" * 1000 + "last frame")
    text = traceback_text(error)
    assert len(text) == TRACEBACK_CHARS
    assert text.endswith(kept)
    assert text.index("last frame") < text.index("ValueError: ") >= TRACEBACK_CHARS / 2 - len(kept)


# What a policy wants to be kept travels with its actions, and with its failure.


def act(process: PolicyProcess):
    process.start()
    process.reset("touch", SESSION)
    return process.act(synthetic_observation())


def test_notes_come_with_the_actions(launch: Launch) -> None:
    process = launch(
        """
        class P(Base):
            def take_notes(self):
                return {"chosen": 3, "map": np.eye(3, dtype=np.float32), "options": [{"depth_m": 0.012}]}
        """
    )
    notes = act(process).notes
    assert (notes["chosen"], notes["options"]) == (3, [{"depth_m": 0.012}])
    np.testing.assert_array_equal(notes["map"], np.eye(3, dtype=np.float32))


def test_a_policy_without_notes_has_none(launch: Launch) -> None:
    assert act(launch("class P(Base): pass")).notes == {}


@pytest.mark.parametrize(("error", "kind"), [("LanguageError", "language"), ("ProgramError", "program")])
def test_a_failure_of_language_is_reported_without_traceback_and_with_notes(
    launch: Launch, error: str, kind: str
) -> None:
    process = launch(
        f"""
        from carecontact.errors import {error}
        class P(Base):
            def act(self, observation):
                raise {error}("the endpoint sleeps")
            def take_notes(self):
                return {{"asked": 1}}
        """
    )
    with pytest.raises(PolicyError, match="failed at act: the endpoint sleeps") as caught:
        act(process)
    assert caught.value.kind == kind
    assert "Traceback" not in str(caught.value)
    assert caught.value.notes == {"asked": 1}


@pytest.mark.parametrize("notes", ["1 / 0", "{'a': object()}", "{'a': np.zeros(5_000_000)}"])
def test_notes_that_fail_do_not_hide_the_failure(launch: Launch, notes: str) -> None:
    process = launch(
        f"""
        from carecontact.errors import LanguageError
        class P(Base):
            def act(self, observation):
                raise LanguageError("the endpoint sleeps")
            def take_notes(self):
                return {notes}
        """
    )
    with pytest.raises(PolicyError, match="the endpoint sleeps") as caught:
        act(process)
    assert (caught.value.kind, caught.value.notes) == ("language", {})


@pytest.mark.parametrize(
    ("notes", "kind"),
    [
        ("{'a': object()}", "exception"),
        ("{'../up': 1}", "garbage"),
        ("[1]", "garbage"),
        ("{'a': np.zeros(5_000_000)}", "oversize"),
    ],
)
def test_bad_notes_are_the_policys_failure(launch: Launch, notes: str, kind: str) -> None:
    process = launch(f"class P(Base):\n            def take_notes(self):\n                return {notes}")
    with pytest.raises(PolicyError) as caught:
        act(process)
    assert caught.value.kind == kind


def test_a_policy_is_given_the_last_view_of_each_camera_and_a_new_trial_begins_without_any() -> None:
    shown: list[Observation] = []

    class Holds:
        card = PolicyCard(name="holds")

        def reset(self, instruction: str) -> None: ...

        def act(self, observation: Observation) -> Action:
            shown.append(observation)
            return Action(look=("wrist",))

    policy, views = Holds(), LastViews()
    looks = [(0.0, ("overhead", "wrist")), (0.1, ()), (0.2, ("wrist",))]
    for time_s, cameras in looks:
        taken = {name: synthetic_view() for name in cameras}
        message = act_message(synthetic_observation(cameras=taken, sim_time_s=time_s))
        reply = server._answer(policy, message, views)
        assert reply is not None
        assert codec.decode_actions(reply["actions"])[0].look == ("wrist",)
    assert [seen.new for seen in shown] == [cameras for _, cameras in looks]
    assert [{n: v.sim_time_s for n, v in seen.cameras.items()} for seen in shown] == [
        {"overhead": 0.0, "wrist": 0.0},
        {"overhead": 0.0, "wrist": 0.0},
        {"overhead": 0.0, "wrist": 0.2},
    ]
    server._answer(policy, codec.reset_message("touch", SESSION), views)
    server._answer(policy, act_message(synthetic_observation(cameras={})), views)
    assert shown[-1].cameras == {}
