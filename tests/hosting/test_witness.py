from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest

from carecontact.errors import ContractError
from carecontact.hosting import child
from carecontact.hosting.wire import codec
from carecontact.hosting.witness import TASK, TOLD, Witness
from tests.policies.synthetic import SESSION, synthetic_observation

POSES = [[0.4, 0.0, 0.4 - 0.01 * k, 0.0, 1.0, 0.0, 0.0] for k in range(5)]


@pytest.fixture
def made(tmp_path: Path) -> Witness:
    card = {"name": "other", "modalities": ["rgb"], "cameras": ["wrist"], "control_hz": 1.0}
    task = {"card": card, "control_hz": 20.0, "poses": POSES, "actions_per_look": 2}
    (tmp_path / TASK).write_text(json.dumps(task))
    return Witness(tmp_path)


def test_it_asks_for_what_the_other_asks_for_and_plays_its_poses(made: Witness) -> None:
    assert (made.card.name, made.card.modalities, made.card.cameras, made.card.control_hz) == (
        "other", ("rgb",), ("wrist",), 20.0,
    )  # fmt: skip
    made.reset("touch")
    chunks = [made.act(synthetic_observation()) for _ in range(3)]
    assert [[a.pose_tcp_in_base.tolist() for a in chunk if a.pose_tcp_in_base is not None] for chunk in chunks] == [
        POSES[:2], POSES[2:4], POSES[4:],
    ]  # fmt: skip
    assert [a.done for chunk in chunks for a in chunk] == [False, False, False, False, True]
    with pytest.raises(ContractError, match="after the last of 5 poses"):
        made.act(synthetic_observation())


def test_it_writes_down_what_it_was_told(made: Witness, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CARECONTACT_SEED", "3")
    monkeypatch.setattr(sys, "orig_argv", ["python", "-c", "code"])
    for name, value in {
        "target": "a:B",
        "arguments": {"seed": "3"},
        "report_fd": 7,
        "lifeline_fd": 8,
        "harness_port": 9,
        "stack_fd": 9,
    }.items():
        monkeypatch.setitem(child.RECEIVED, name, value)
    made.configure(SESSION)
    with (tmp_path / "held").open("w"):
        made.reset("touch")
        told = json.loads((tmp_path / TOLD).read_text())
        if Path("/proc/self/fd").is_dir():
            assert str(tmp_path / "held") in told["open_files"]
    assert told["instruction"] == "touch"
    assert told["session"] == json.loads(json.dumps(codec.encode_session(SESSION)))
    assert told["environment"]["CARECONTACT_SEED"] == "3"
    assert told["command_line"] == ["python", "-c", "code"]
    assert told["options"] == {"target": "a:B", "arguments": {"seed": "3"}}
    assert told["folder"] == os.getcwd()
