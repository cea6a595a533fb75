"""Whole trials of the oracle, and who may not have its privilege."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from carecontact.cli import main
from carecontact.contract.policy_ref import PolicyRef
from carecontact.contract.protocol.alive import Alive, Breathing, Repositioning, Withdrawal
from carecontact.contract.trial import TrialSpec
from carecontact.errors import ConfigError
from carecontact.hosting.setup import PolicySetup
from carecontact.oracle.drive import drive
from carecontact.policies import registry
from carecontact.policies.registry import POLICIES, PolicyRow
from carecontact.protocols import FAST_DT_S, load_protocol, overridden
from carecontact.recording import read_header, write_recording
from carecontact.recording.schema import SEGMENTS
from carecontact.scoring import score_recording
from carecontact.trials.trial import run_trial

ALIVE = Alive(breathing=Breathing(abdomen_m=(0.015, 0.015)), repositioning=Repositioning(), withdrawal=Withdrawal())


def test_it_feels_the_force_with_the_steps_of_the_fast_mode_too() -> None:
    protocol = overridden(load_protocol(), {"physics.dt_s": FAST_DT_S})
    recording = run_trial(TrialSpec(protocol=protocol, task_id="T1", seed=0, policy="oracle"))
    assert recording.header.ended == "done"
    assert score_recording(recording).safety_gated


@pytest.mark.parametrize("task", ["T2", "T7"])
def test_it_does_the_task_on_a_person_who_breathes_and_moves(task: str, tmp_path: Path) -> None:
    moved = load_protocol("bathing-wide-v2-draft", level="L1")
    protocol = moved.model_copy(update={"person": moved.person.model_copy(update={"alive": ALIVE})})
    recording = run_trial(TrialSpec(protocol=protocol, task_id=task, seed=0, policy="oracle"))
    write_recording(recording, tmp_path / "a.h5")
    header = read_header(tmp_path / "a.h5")
    assert header.privileged is True
    assert header.ended == "done"
    score = score_recording(recording)
    assert (score.safety_gated, score.privileged) == (True, True)
    target = SEGMENTS.index({"T2": "right_forearm", "T7": "abdomen"}[task])
    force = np.linalg.norm(recording["scorer/force_human_from_robot_in_world"][:, target], axis=1)
    assert 1.0 < np.median(force[force > 0.3]) < 20.0


def test_a_recording_says_whether_there_was_privilege() -> None:
    recording = run_trial(TrialSpec(protocol=short(), task_id="T1", seed=0, policy="zero-action"))
    assert recording.header.model_dump(mode="json")["privileged"] is False
    assert not score_recording(recording).privileged


def test_only_the_shipped_oracle_is_given_the_simulation(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not another name, even if a row of this process calls itself privileged."""
    monkeypatch.setitem(POLICIES._rows, "mine", PolicyRow(target="my.own:Mine", description="x", role="privileged"))
    spec = TrialSpec(protocol=short(), task_id="T1", seed=0, policy="mine")
    with pytest.raises(ConfigError, match="policy mine: only oracle may be given the simulation"):
        run_trial(spec)
    monkeypatch.setattr(registry, "is_privileged", lambda ref: True)
    with pytest.raises(ConfigError, match="only oracle"):
        drive(None, PolicyRef.parse("my.own:Mine"))  # pyright: ignore[reportArgumentType]


def test_a_policy_file_that_imports_the_oracle_fails_behind_the_wall() -> None:
    name = "carecontact.oracle.policy:Oracle"
    spec = TrialSpec(protocol=short(), task_id="T1", seed=0, policy=name)
    recording = run_trial(spec, policy=PolicySetup.of(name))
    assert recording.header.ended == "process_failure"
    assert recording.header.failure is not None
    assert "carecontact.oracle is closed to policies" in recording.header.failure.message
    assert not recording.header.privileged


@pytest.mark.parametrize("command", [["serve", "oracle", "--port", "0"], ["check", "oracle"]])
def test_it_is_neither_served_nor_checked(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(command) == 2
    assert "policy oracle is privileged" in capsys.readouterr().err


def test_it_takes_no_arguments(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["run", "--policy", "oracle", "--policy-arg", "a=1", "--out", str(tmp_path)]
    assert main(command) == 2
    assert "leave out --policy-arg" in capsys.readouterr().err


def short():
    protocol = load_protocol()
    return protocol.model_copy(update={"phases": protocol.phases.model_copy(update={"time_limit_s": 0.1})})
