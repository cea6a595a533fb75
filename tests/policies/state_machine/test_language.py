"""The state machine with a language model behind a real endpoint, in a process of its own."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from carecontact.contract.observation import Observation
from carecontact.contract.session import Session
from carecontact.errors import PolicyError
from carecontact.hosting.process import PolicyProcess
from carecontact.hosting.setup import PolicySetup
from tests.policies.language.endpoint import Answer, endpoint, error, says

READ = says(json.dumps({"action": "touch", "region": "forearm", "side": "right", "manner": "none", "unclear": ""}))
CHOSE = says('{"number": 7, "reason": "in the middle"}')


@pytest.fixture
def run(
    monkeypatch: pytest.MonkeyPatch, observation: Observation, session: Callable[..., Session]
) -> Callable[..., PolicyProcess]:
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")

    def trial(language: str | None, *, url: str = "", record: str | None = None) -> dict[str, object]:
        monkeypatch.setenv("OPENAI_BASE_URL", url)
        setup = replace(PolicySetup.of("state-machine"), language=language, record=record)
        with PolicyProcess(setup, first_deadline_s=20, deadline_s=20) as process:
            card = process.start()
            process.reset("touch the right forearm", session())
            reply = process.act(observation)
        assert reply.actions[0].pose_tcp_in_base is not None
        return {**reply.notes, "backend": card.language_backend, "count": len(reply.actions)}

    return trial


def test_a_model_chooses_and_its_recording_replays(run: Callable[..., dict], tmp_path: Path) -> None:
    record = tmp_path / "said.jsonl"
    with endpoint(READ, CHOSE) as server:
        live = run("live:m-1", url=server.url, record=str(record))
    replayed = run(f"replay:{record}")
    assert live["backend"] == "live:m-1"
    assert replayed["backend"].endswith(":m-1")
    assert live["chosen"] == replayed["chosen"] == 7
    assert (live["options"], live["count"]) == (replayed["options"], replayed["count"])
    assert [c["purpose"] for c in live["language"]] == ["parse", "choose"]
    for a, b in zip(live["language"], replayed["language"], strict=True):
        assert (a["request_sha256"], a["completion_sha256"]) == (b["request_sha256"], b["completion_sha256"])


def test_options_and_choice_are_noted_under_rules_too(run: Callable[..., dict]) -> None:
    notes = run(None)
    chosen = notes["options"][notes["chosen"]]
    assert (chosen["primitive"], chosen["key_point"], chosen["approach"]) == ("touch", 0.5, "above")
    assert len(chosen["corners_px"]) == len(chosen["corners_m"]) == 1
    assert all(0 <= u < 640 and 0 <= v < 480 for o in notes["options"] for u, v in o["corners_px"])
    assert "language" not in notes


@pytest.mark.parametrize(
    ("answers", "told"),
    [((error(500, "out of memory"),), "HTTP 500: .*out of memory"), ((READ, says("{")), "does not fit its schema")],
    ids=["error", "malformed"],
)
def test_a_wrong_endpoint_is_the_methods_failure(
    run: Callable[..., dict], answers: tuple[Answer, ...], told: str
) -> None:
    with endpoint(*answers) as server, pytest.raises(PolicyError, match=rf"live:m-1: .*{told}") as caught:
        run("live:m-1", url=server.url)
    assert caught.value.kind == "language"
    assert "Traceback" not in str(caught.value)
