from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from carecontact.contract.trial import TrialSpec
from carecontact.errors import RecordingError
from carecontact.protocols import load_protocol
from carecontact.recording import read_recording, write_recording
from carecontact.recording.notes import language_use, read_notes
from carecontact.recording.schema import Recording
from carecontact.scoring import score_recording
from carecontact.trials.failed import harness_error_recording

CALLS = [{"request_sha256": "a", "completion_sha256": "b"}, {"request_sha256": "c", "completion_sha256": "d"}]


def recording(notes: dict[str, object]) -> Recording:
    spec = TrialSpec(protocol=load_protocol(), task_id="T1", seed=0, policy="x")
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
def test_what_is_no_note_is_told(notes: dict[str, object]) -> None:
    with pytest.raises(RecordingError, match="T1-s000: policy/notes/"):
        read_notes(recording(notes))
