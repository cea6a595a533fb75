"""What a node does with one trial, without a cluster."""

from __future__ import annotations

import json
import pickle
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from carecontact import __version__
from carecontact.contract.policy_ref import PolicyRef
from carecontact.hosting.setup import PolicySetup
from carecontact.protocols import load_protocol
from carecontact.recording import read_recording
from carecontact.runs.identity import identity_of
from carecontact.runs.plan import plan_trials
from carecontact.trials import node_task
from carecontact.trials.machine import check_ready
from carecontact.trials.node_task import NodeDone, NodeTask, carry_out
from carecontact.trials.workers import Workers

FAKE = (sys.executable, str(Path(__file__).with_name("fake_worker.py")))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("FAKE_LOG", str(tmp_path / "ran.txt"))
    monkeypatch.setenv("FAKE_PLAN", "{}")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def task(policy: str = "hover", *, search_path: tuple[str, ...] = (), **changes: Any) -> NodeTask:
    spec = plan_trials(protocol=load_protocol(), policy=policy, tasks=["T1"], seeds=[0])[0]
    made = NodeTask(
        spec=spec, policy=PolicySetup(ref=PolicyRef.parse(policy), search_path=search_path), shipped=False,
        identity=identity_of(spec, search_path=search_path), weights=None, pace_s=None, trial_limit_s=60.0,
        command=FAKE, earlier=None,
    )  # fmt: skip
    return replace(made, **changes)


def done(made: NodeTask, *, release: str = __version__) -> NodeDone:
    return carry_out(release, pickle.dumps(made))


def test_a_trial_comes_back_as_bytes_and_leaves_nothing(folder: Path) -> None:
    found = done(task())
    assert found.recording is not None
    (folder / "back.h5").write_bytes(found.recording)
    assert read_recording(folder / "back.h5").header.spec == task().spec
    assert (found.log, found.lost, found.refused) == (None, None, None)
    assert [path.name for path in folder.iterdir() if path.is_dir()] == []
    request = json.loads((folder / "requests.jsonl").read_text())
    closed = tuple(request["policy"]["closed"])
    assert request["out"].startswith(closed), "the folder of the recording is closed to the policy"


def test_what_a_signal_killed_runs_once_more_there_and_a_failure_brings_its_log(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAKE_PLAN", json.dumps({"T1-s000": ["kill", "policy"]}))
    found = done(task())
    assert (folder / "ran.txt").read_text().count("T1-s000") == 2
    assert found.log is not None
    assert b"NoGrip: nothing there" in found.log


def test_an_attempt_that_an_earlier_command_lost_binds_the_repetition(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The policy was killed after the answers a b; elsewhere it answers a c, which does not count."""
    monkeypatch.setenv("FAKE_PLAN", json.dumps({"T1-s000": "policy_killed:ab"}))
    lost = done(task())
    monkeypatch.setenv("FAKE_PLAN", json.dumps({"T1-s000": "good:ac"}))
    found = done(task(earlier=lost.recording))
    assert found.recording is not None
    (folder / "back.h5").write_bytes(found.recording)
    failure = read_recording(folder / "back.h5").header.failure
    assert failure is not None
    assert failure.kind == "other_answers"


def test_a_node_without_space_gives_the_trial_back(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FAKE_PLAN", json.dumps({"T1-s000": "full"}))
    found = done(task())
    assert found.recording is None
    assert "No space left on device" in (found.lost or "")


def test_a_node_of_another_release_or_with_other_files_is_refused(folder: Path) -> None:
    assert done(task(), release="0.0.0").refused == f"it has carecontact {__version__}, and the command has 0.0.0"
    identity = task().identity
    other = identity.model_copy(update={"versions": {**identity.versions, "mujoco": "9.9.9"}})
    assert done(task(identity=other)).refused == "mujoco was 9.9.9, is 4.0.0"
    assert not (folder / "ran.txt").exists()

    module = folder / "mine.py"
    module.write_text("class P: pass\n")
    made = task("mine:P", search_path=(str(folder),))
    assert done(made).refused is None
    module.write_text("class P: x = 1\n")
    assert done(made).refused == "the file of mine:P differs"
    module.unlink()
    assert done(made).refused == "the file of mine:P is not there"


def test_a_node_that_cannot_render_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    check_ready.cache_clear()
    monkeypatch.setenv("MUJOCO_GL", "nonsense")
    refused = done(task()).refused
    assert refused is not None
    assert refused.startswith("this machine cannot run trials: OpenGL: MUJOCO_GL=nonsense")
    assert not (folder / "ran.txt").exists()


def test_a_policy_that_was_shipped_lies_where_the_task_runs(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "there").mkdir()
    (folder / "there/mine.py").write_text("class P: pass\n")
    made = replace(task("mine:P", search_path=(str(folder / "there"),)), shipped=True)
    made = replace(made, policy=replace(made.policy, search_path=("/the/command's/folder",)))
    assert done(made).refused == "the file of mine:P is not there"
    monkeypatch.chdir(folder / "there")
    assert done(made).refused is None
    request = json.loads((folder / "requests.jsonl").read_text())
    assert request["policy"]["search_path"] == [str(folder / "there")]


def test_no_process_is_left_where_a_task_is_interrupted(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FAKE_PLAN", json.dumps({"T1-s000": "hang"}))
    killed: list[int] = []
    kill_all = Workers.kill_all

    def watched(workers: Workers) -> None:
        killed.append(len(workers.running))
        kill_all(workers)

    def interrupted(seconds: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Workers, "kill_all", watched)
    monkeypatch.setattr(node_task.time, "sleep", interrupted)
    with pytest.raises(KeyboardInterrupt):
        done(task())
    assert killed == [1]
