from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from carecontact.errors import RecordingError
from carecontact.interface.action import Action
from carecontact.interface.body_view import LANDMARK
from carecontact.interface.policy import CAMERAS
from carecontact.interface.regions import STANDARD_REGIONS
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording import read_recording, write_recording
from carecontact.recording.notes import JOINTS, PERCEPTION, language_use, perception_errors, read_notes
from carecontact.recording.reason import REMEDIES, alike, reason, reason_of, remedies
from carecontact.recording.schema import OPTIONAL_ARRAYS, Failure, Recording, dimensions
from carecontact.running.lost import harness_error_recording
from carecontact.scoring import score_recording
from carecontact.sensing.keypoints import LANDMARK_COUNT
from tests.policies.synthetic import synthetic_observation

CALLS = [{"request_sha256": "a", "completion_sha256": "b"}, {"request_sha256": "c", "completion_sha256": "d"}]


def recording(notes: dict[str, object]) -> Recording:
    spec = TrialSpec(protocol=load_protocol("bathing-v3"), task_id="T1", seed=0, policy="x")
    base = harness_error_recording(spec, kind="x", message="x")
    arrays = {
        f"policy/notes/{name}": np.frombuffer(json.dumps(content).encode(), "u1") for name, content in notes.items()
    }
    return Recording(header=base.header, arrays=base.arrays | arrays)


def test_what_was_written_is_read(tmp_path: Path) -> None:
    written = recording({"0003/json": {"chosen": 1}, "0000/json": {"chosen": 0}})
    written = replace(written, arrays={**written.arrays, "policy/notes/0003/map": np.eye(3, dtype="<f4")})
    first, second = read_notes(read_recording(write_recording(written, tmp_path / "T1-s000.h5")))
    assert (first.observation_index, first.content, dict(first.arrays)) == (0, {"chosen": 0}, {})
    assert (second.observation_index, second.content, list(second.arrays)) == (3, {"chosen": 1}, ["map"])


def test_the_row_tells_what_was_asked_and_answered() -> None:
    asked = recording({"0000/json": {"language": CALLS[:1]}, "0002/json": {"language": CALLS[1:]}})
    digest = language_use(asked).sha256
    assert digest is not None
    assert (
        score_recording(asked).language_sha256
        == digest
        == language_use(recording({"0000/json": {"language": CALLS}})).sha256
    )
    assert digest != language_use(recording({"0000/json": {"language": CALLS[::-1]}})).sha256
    assert score_recording(recording({"0000/json": {"chosen": 1}})).language_sha256 is None


def test_the_row_tells_who_answered() -> None:
    given = {"endpoint": "models.example", "model": "m-2", "sent": {"temperature": 0.0, "max_tokens": 9}}
    calls = [CALLS[0] | given, CALLS[1] | given | {"model": "m-1"}, {"endpoint": "models.example:1"}, CALLS[0]]
    score = score_recording(recording({"0000/json": {"language": calls}}))
    assert score.language_endpoint == "models.example, models.example:1"
    assert (score.language_served, score.language_sent) == ("m-1, m-2", "max_tokens=9 temperature=0.0")
    replayed = score_recording(recording({"0000/json": {"language": [CALLS[0] | {"model": "authored"}]}}))
    assert (replayed.language_endpoint, replayed.language_served, replayed.language_sent) == (None, None, None)


def test_a_policy_can_note_anything() -> None:
    odd = [{"endpoint": 1, "model": ["x"], "sent": "x"}, {"endpoint": "a\x1b"}, {"endpoint": "x" * 9999}, 1]
    use = language_use(recording({"0000/json": {"language": odd}}))
    assert (use.endpoint, use.served, use.sent) == ("x" * 500, None, None)
    assert language_use(recording({"0000/json": {"language": "x"}})).endpoint is None


@pytest.mark.parametrize("notes", [{"0000/json": [1]}, {"x/json": {}}, {"0000/map": {}}])
def test_what_is_no_note_is_refused(notes: dict[str, object]) -> None:
    with pytest.raises(RecordingError, match="T1-s000: policy/notes/"):
        read_notes(recording(notes))


@pytest.fixture
def old() -> Recording:
    """A recording without perception errors."""
    spec = TrialSpec(protocol=load_protocol("bathing-v3"), task_id="T1", seed=0, policy="zero-action")
    return harness_error_recording(spec, kind="x", message="x")


def rows(count: int) -> dict[str, np.ndarray]:
    sizes = {"L": count, "R": len(STANDARD_REGIONS), "12": 12, "3": 3}
    shapes = {path: [sizes[name] for name in dimensions(path)] for path in PERCEPTION}
    return {path: np.zeros(shapes[path], OPTIONAL_ARRAYS[path][0]) for path in PERCEPTION}


def test_joints_have_the_estimators_numbers() -> None:
    assert JOINTS == LANDMARK
    assert (JOINTS["left knee"], JOINTS["right ankle"]) == (25, 28)
    assert max(JOINTS.values()) < LANDMARK_COUNT


def test_a_trial_without_looks_has_none(old: Recording) -> None:
    assert perception_errors(old) is None


def test_perception_that_was_written_is_read(old: Recording, tmp_path) -> None:
    index = np.array([0, 3, 0], "i4")
    new = Recording(header=old.header, arrays=old.arrays | rows(3) | {"perception/camera_index": index})
    found = perception_errors(read_recording(write_recording(new, tmp_path / "a.h5")))
    assert found is not None
    assert found.camera == [CAMERAS[0], CAMERAS[3], CAMERAS[0]]
    assert found.target_error_m.shape == (3, 3, 3)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("perception/human_iou", np.zeros(2, "f4")),
        ("perception/human_iou", np.zeros(3, "f8")),
        ("perception/target_error_m", np.zeros((3, 3), "f4")),
        ("perception/camera_index", np.full(3, 9, "i4")),
        ("perception/joint_visible", None),
    ],
)
def test_malformed_rows_are_named(old: Recording, path: str, value: np.ndarray | None) -> None:
    arrays = old.arrays | rows(3)
    arrays.pop(path)
    if value is not None:
        arrays[path] = value
    with pytest.raises(RecordingError, match=path):
        perception_errors(Recording(header=old.header, arrays=arrays))


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        (
            "could not load a:B:\nTraceback (most recent call last):\n  File x\nkeyring.Error: no key\n (exit code 0)",
            "keyring.Error: no key",
        ),
        ("policy took too long\nit printed last:\nValueError: hello", "policy took too long"),
        ("failed at act: cut off\n    x()\nValueError: boom", "ValueError: boom"),
        (
            "failed at act: Traceback (most recent call last):\n  F\nOdd: two\nlines\nit printed last:\nz",
            "Odd: two",
        ),
        (
            "Traceback (most recent call last):\n  a\nKeyError: 1\n\nDuring handling of the above exception, another "
            "exception occurred:\n\nTraceback (most recent call last):\n  b\nOSError: 2",
            "OSError: 2",
        ),
    ],
)
def test_reason_is_the_exception_under_the_traceback(message: str, expected: str) -> None:
    assert reason(message) == expected


@pytest.mark.parametrize("kind", ["program", "language", "action"])
def test_who_chooses_words_of_a_failure_does_not_choose_its_reason(kind: str) -> None:
    message = "program planner: go was stopped: ValueError: boo\nTraceback (most recent call last):\nAllFine: passed"
    failure = Failure(kind=kind, message=f"policy 'x' failed at reset: {message} (line 1)\nit printed last:\nhello")
    assert reason_of(failure) == (
        "policy 'x' failed at reset: program planner: go was stopped: ValueError: boo Traceback (most recent call "
        "last): AllFine: passed (line 1)"
    )


def test_of_an_exception_it_is_the_reason() -> None:
    message = "failed at act: Traceback (most recent call last):\n  File x\nValueError: boom\n (exit code 0)"
    assert reason_of(Failure(kind="exception", message=message)) == "ValueError: boom"


def test_failures_alike_differ_only_in_their_values() -> None:
    one, other = (f"actions[0].pose: expected finite numbers, got [nan, {x}] after {x} s" for x in (0.31, -4e-05))
    assert alike(one) == alike(other)
    assert alike(one) != alike("actions[0].pose: expected a quaternion of norm 1, got [1, 2] after 3.1 s")
    assert alike("its process ended itself, exit code 1") != alike("its process ended itself, exit code 2")


def test_a_refusal_has_its_remedy_and_other_failures_none() -> None:
    message = "policy 'x' failed at act: actions[0].pose_tcp_in_base: expected finite numbers, got [nan]"
    assert remedies(message) == ["Look for a division by 0 or an unset value in the policy's output."]
    assert remedies(f"{message}, which looks like nothing that was ever set") == []
    assert remedies("policy 'x' failed at act: its process was killed by SIGKILL without an answer") == []


@pytest.mark.parametrize(
    ("message", "may_help"),
    [
        ("KeyError: 'wrist'", "The card's cameras"),
        ("TypeError: 'NoneType' object is not subscriptable", "landmarks_in_base needs depth"),
        ("TypeError: 'Observation' object is not subscriptable", r"observation\.cameras"),
        ("TypeError: Action.__init__() got an unexpected keyword argument 'pose'", "pose_tcp_in_base"),
        ("TypeError: Mine.reset() takes 1 positional argument but 2 were given", r"def reset\(self, instruction\)"),
        ("expected an Action or a list of Actions, got coroutine <coroutine object", "not async def act"),
        ("InvalidMessage: did not receive a valid HTTP response", "no WebSocket server"),
    ],
)
def test_common_mistakes_in_a_policys_own_code_have_one(message: str, may_help: str) -> None:
    (remedy,) = remedies(f"policy 'x' failed at act: {message}")
    assert re.search(may_help, remedy)


def test_the_words_of_python_are_what_this_python_says() -> None:
    """The parts of REMEDIES are Python's own words, which another release may change."""
    observation, action, nothing = synthetic_observation(), Action, [None]
    for fault, part in (
        (lambda: observation["image"], "'Observation' object is not subscriptable"),
        (lambda: action(pose=1), "Action.__init__() got an unexpected keyword argument"),
        (lambda: nothing[0][0], "'NoneType' object is not subscriptable"),
    ):
        with pytest.raises(TypeError) as raised:
            fault()
        assert part in str(raised.value)
        assert part in REMEDIES
