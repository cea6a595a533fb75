"""Real runs against endpoints that repeat the key: it is in nothing that a run prints or writes."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from carecontact.cli import main
from carecontact.recording import Recording, read_recording
from carecontact.recording.notes import read_notes
from tests.policies.language.endpoint import Answer, body, echo, endpoint, says

KEY = "sk-live-0123456789-SECRET"
BEARER = f"Bearer {KEY}"
READ = json.dumps({"action": "touch", "region": "forearm", "side": "right", "manner": "none", "unclear": ""})

Run = Callable[..., list[dict[str, Any]]]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Run:
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.setenv("OPENAI_API_KEY", KEY)

    def made(*answers: Answer, seeds: str) -> list[dict[str, Any]]:
        """Rows of the results, in the order of the trials."""
        out, record = tmp_path / "run", tmp_path / "said.jsonl"
        command = ["run", "--policy", "state-machine", "--language", "live:m-1", "--tasks", "T1", "--seeds", seeds]
        with endpoint(*answers) as server:
            monkeypatch.setenv("OPENAI_BASE_URL", server.url)
            assert main([*command, "--allow-failures", "--jobs", "1", "--out", str(out), "--record", str(record)]) == 0
        assert {asked["key"] for asked in server.asked} == {BEARER}
        _check_all_of_it(tmp_path, capfd.readouterr())
        rows = json.loads((out / "results.json").read_text())["trials"]
        assert {row["language_endpoint"] for row in rows} == {server.url.split("/")[2]}
        return rows

    return made


def _check_all_of_it(folder: Path, printed: Any) -> None:
    files = [path for path in folder.rglob("*") if path.is_file()]
    assert {"results.json", "report.html", "T1-s000.h5", "said.jsonl"} <= {path.name for path in files}
    kept = [path.read_bytes() for path in files] + [text.encode() for text in printed]
    for path in (path for path in files if path.suffix == ".h5"):
        recording = read_recording(path)
        kept += [array.tobytes() for array in recording.arrays.values()] + [recording.header.model_dump_json().encode()]
    assert any(b"[secret removed]" in content for content in kept)
    assert not any(KEY[3:].encode() in content for content in kept)


def _calls(recording: Recording) -> list[dict[str, Any]]:
    return [call for note in read_notes(recording) for call in note.content["language"]]


def test_in_one_trial(run: Run, tmp_path: Path) -> None:
    (row,) = run(says(READ, model=f"m of {BEARER}"), echo(401), seeds="0")
    assert (row["ended"], row["language_served"]) == ("process_failure", "m of Bearer [secret removed]")
    assert "HTTP 401: Incorrect API key provided: Bearer [secret removed]" in row["failure_message"]
    assert row["language_sent"] == "max_tokens=1024 temperature=0.0"
    read, chose = _calls(read_recording(tmp_path / "run" / "T1-s000.h5"))
    assert (read["purpose"], chose["purpose"], chose["completion_sha256"]) == ("parse", "choose", None)
    assert "Language model served" in (tmp_path / "run" / "report.html").read_text()


@pytest.mark.slow
def test_in_each_way_that_an_answer_can_be_none(run: Run, tmp_path: Path) -> None:
    rows = run(
        echo(401), body(f"<p>{BEARER} is busy</p>".encode()), says(None, refusal=f"not with {BEARER}"),
        says(READ), says(f"no number, but {BEARER}", model="m" * 500_000), seeds="0-3",
    )  # fmt: skip
    told = ["HTTP 401: Incorrect", "not a chat completion", "is a refusal: not with", "does not fit its schema"]
    for row, expected in zip(rows, told, strict=True):
        assert row["ended"] == "process_failure"
        assert expected in row["failure_message"]
    assert rows[0]["language_served"] is None
    calls = _calls(read_recording(tmp_path / "run" / "T1-s003.h5"))
    assert [len(call["model"]) for call in calls] == [8, 200, 200]
