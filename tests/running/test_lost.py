"""Trials that a signal ended are repeated, and a policy that sent it has nothing of that."""

from __future__ import annotations

import errno
import gc
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from carecontact.errors import ExhaustedError
from carecontact.interface.action import Action
from carecontact.recording import Recording, read_recording
from carecontact.running import lost
from carecontact.running.engine import TrialRequest
from carecontact.running.lost import OTHER_ANSWERS, digest_of
from carecontact.running.workers import Launcher, Process
from tests.running.test_supervisor import Bench, specs

FIRST, SECOND = "T1-s000", "T1-s001"


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def kind(recording: Recording) -> tuple[str, str | None]:
    failure = recording.header.failure
    return recording.header.ended, None if failure is None else failure.kind


DONE, KILLED, OTHER = ("done", None), ("process_failure", "killed"), ("process_failure", OTHER_ANSWERS)
REPETITIONS: dict[str, tuple[str | list[str], tuple[str, str | None]]] = {
    "T1-s000": (["policy_killed:ab", "good:abc"], DONE),
    "T1-s001": (["policy_killed:ab", "policy_killed:a"], KILLED),
    "T1-s002": (["policy_killed:ab", "good:ax"], OTHER),
    "T1-s003": (["policy_killed:ab", "policy:ax"], OTHER),
    "T1-s004": (["policy_killed:ab", "policy_killed:ax"], OTHER),
    "T1-s005": (["policy_killed:ab", "good:"], DONE),
    "T1-s006": (["lack_with_policy:ab", "lack_with_policy:ab"], KILLED),
    "T1-s007": (["lack_with_policy:ab", "good"], DONE),
    "T1-s008": ("lost_once", DONE),
    "T1-s009": ("kill", ("harness_error", "signal")),
    "T1-s010": (["policy_killed:a", "policy_killed:abc"], KILLED),
    "T1-s011": ("exit", ("harness_error", "exit")),
}
"""Trial -> what its attempts do, and how it ends. Without a bond to its first answers, a policy that kills itself or
leaves its trial without a thread could try others, and could take a bad trial out of the count."""


def test_a_trial_is_repeated_once_and_bound_to_its_first_answers(bench: Bench) -> None:
    trials = specs(len(REPETITIONS))

    def kinds() -> dict[str, tuple[str, str | None]]:
        return {trial: kind(bench.recording(trial)) for trial in REPETITIONS}

    bench.run(trials, {trial: does for trial, (does, _) in REPETITIONS.items()}, jobs=3)
    assert bench.ran() == sorted([*REPETITIONS, *REPETITIONS][:-1])
    first = {trial: expected for trial, (_, expected) in REPETITIONS.items()}
    assert kinds() == first
    why = {event.trial_id: event.message for event in bench.events if event.kind == "redo"}
    assert why["T1-s000"] == "policy 'x' failed at act: its process was killed by SIGKILL"
    assert why["T1-s008"] == "the trial's process died of signal 9 (Killed) while the policy was running"
    failure = bench.recording("T1-s006").header.failure
    assert failure is not None
    assert failure.message.startswith("no thread is left while the policy was running, in both attempts\n")

    # The same command repeats what a signal or the machine ended, and nothing that had its repetition.
    second = {
        "T1-s001": "good:abc",
        "T1-s006": ["lack_with_policy:ab", "good:xy"],
        "T1-s009": "kill",
        "T1-s010": ["policy_killed:ab", "good:abx"],
    }
    bench.run(trials, second, jobs=3)
    assert bench.ran() == sorted([*second, "T1-s006", "T1-s009", "T1-s010", "T1-s011"])
    later = {"T1-s001": DONE, "T1-s006": OTHER, "T1-s010": OTHER, "T1-s011": DONE}
    assert kinds() == first | later
    bench.run(trials)
    assert bench.ran() == ["T1-s009"]
    bench.run(trials, {"T1-s010": "good:abx"}, retry_failed=True)
    assert set(kinds().values()) == {DONE}


def test_a_trial_that_cannot_begin_waits_for_the_others(bench: Bench) -> None:
    summary = bench.run(specs(2), {FIRST: "slow", SECOND: ["lack", "lack", "good"]})
    assert set(summary.ended.values()) == {"done"}
    assert bench.ran() == [FIRST, *[SECOND] * 3]
    reasons = {event.message for event in bench.events if event.kind == "waiting"}
    assert reasons == {"cannot begin yet: no thread is left"}


def test_a_run_whose_trials_cannot_begin_for_long_stops(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("carecontact.running.supervisor.LACKING_ALONE_S", 0.5)
    monkeypatch.setattr("carecontact.running.supervisor.START_PAUSE_S", 0.1)
    message = r"the run stops with 1 of 2 trials done: a trial could not begin: no thread is left; end other programs"
    with pytest.raises(ExhaustedError, match=message):
        bench.run(specs(2), {SECOND: "lack"}, jobs=1)
    assert not (bench.out / f"{SECOND}.h5").exists()
    assert set(bench.run(specs(2)).ended.values()) == {"done"}


def test_a_trial_that_runs_may_end_before_a_run_stops_that_cannot_go_on(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its policy may be the cause, and would else run again without condition."""
    monkeypatch.setattr("carecontact.running.supervisor.LACKING_S", 0.0)
    monkeypatch.setattr("carecontact.running.supervisor.START_PAUSE_S", 0.1)
    with pytest.raises(ExhaustedError, match="with 1 of 3 trials done: a trial could not begin: no thread is left"):
        bench.run(specs(3), {FIRST: "outlasts", SECOND: "lack"})
    assert kind(bench.recording(FIRST)) == ("done", None)


def test_patience_begins_again_after_a_trial_that_could_begin(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("carecontact.running.supervisor.LACKING_ALONE_S", 1.0)
    monkeypatch.setattr("carecontact.running.supervisor.START_PAUSE_S", 0.1)
    assert bench.run(specs(1), {FIRST: ["lack", "slow_lost", "lack", "good"]}).ended == {FIRST: "done"}


def test_a_process_that_cannot_be_started_is_tried_again(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("carecontact.running.supervisor.START_PAUSE_S", 0.1)
    whole, tried = Launcher.start, list[str]()

    def start(self: Launcher, request: TrialRequest, *, log: Path) -> Process:
        tried.append(request.spec.trial_id)
        if len(tried) < 4:
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        return whole(self, request, log=log)

    monkeypatch.setattr(Launcher, "start", start)
    gc.collect()  # what earlier tests of this process left open
    held = len(os.listdir("/proc/self/fd"))
    assert bench.run(specs(1)).ended == {FIRST: "done"}
    assert tried == [FIRST] * 4
    assert len(os.listdir("/proc/self/fd")) == held


@pytest.mark.parametrize(("closed", "ends"), [(True, "done"), (False, "process_failure")])
def test_a_worker_that_the_policy_may_have_killed_binds_it_too(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, closed: bool, ends: str
) -> None:
    """An honest policy with random numbers is spared where it cannot signal."""
    monkeypatch.setattr(lost, "closes_signals", lambda: closed)
    summary = bench.run(specs(2), {FIRST: ["lost:ab", "good:xyz"], SECOND: ["lost:ab", "good:abc"]})
    assert summary.ended == {FIRST: ends, SECOND: "done"}


def test_a_policy_that_starves_its_trial_until_the_time_is_over_has_failed(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For that it needs the processors and no signal; a trial without an end would leave the count."""
    monkeypatch.setattr(lost, "closes_signals", lambda: True)
    summary = bench.run(specs(2), {FIRST: "starve:ab", SECOND: ["starve:ab", "good:xyz"]}, trial_limit_s=4.0)
    assert summary.ended == {FIRST: "process_failure", SECOND: "process_failure"}
    assert bench.ran() == [FIRST, FIRST, SECOND, SECOND]
    assert kind(bench.recording(FIRST)) == ("process_failure", "killed")
    assert kind(bench.recording(SECOND)) == ("process_failure", OTHER_ANSWERS)


def test_a_digest_stands_for_every_bit_of_an_answer() -> None:
    pose = np.array([0.4, 0.0, 0.4, 0.0, 1.0, 0.0, 0.0])
    near = pose.copy()
    near[0] = np.nextafter(0.4, 1.0)
    answers = [[Action(pose_tcp_in_base=p, done=d)] for p in (pose, near) for d in (False, True)]
    digests = [digest_of(answer) for answer in [*answers, [*answers[0], *answers[0]]]]
    assert len(set(digests)) == 5
    assert {len(digest) for digest in digests} == {32}


POLICY = """
import os, signal
from pathlib import Path
import numpy as np
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard

class Own:
    card = PolicyCard(name="own", modalities=(), cameras=())
    acts = 0
    def __init__(self, *, dies: str, moves: float = 0.0):
        self.died, self.dies, self.moves = Path("died"), dies, moves
    def reset(self, instruction): pass
    def act(self, observation):
        self.acts += 1
        again = self.died.exists()
        if self.acts == 3 and (self.dies == "always" or not again):
            self.died.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        pose = observation.pose_tcp_in_base.copy()
        pose[2] += 0.01 + (self.moves if again else 0.0)
        return Action(pose_tcp_in_base=pose, done=self.acts == 5)
"""


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "carecontact", "run", "--policy", "own:Own", "--tasks", "T1", "--seeds", "0"]
    given = [part for argument in arguments for part in ("--policy-arg", argument)]
    command += ["--policy-write", ".", "--fast", *given, "--out", "r"]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_a_real_policy_that_dies_and_comes_back(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(POLICY)
    file = tmp_path / "r" / "T1-s000.h5"
    assert (tmp_path / "died").write_text("") == 0
    assert run(tmp_path, "dies=once").returncode == 0
    undisturbed = read_recording(file).stored_sha256
    for name in ("died", "r/T1-s000.h5"):
        (tmp_path / name).unlink()
    done = run(tmp_path, "dies=once")
    assert (done.returncode, read_recording(file).stored_sha256) == (0, undisturbed), done.stdout
    assert f"killed by {signal.SIGKILL.name}" in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "kind"), [(("dies=always",), "killed"), (("dies=once", "moves=0.001"), "other_answers")]
)
def test_a_real_policy_gains_nothing(tmp_path: Path, arguments: tuple[str, ...], kind: str) -> None:
    (tmp_path / "own.py").write_text(POLICY)
    done = run(tmp_path, *arguments)
    assert done.returncode == 3, done.stdout
    recording = read_recording(tmp_path / "r" / "T1-s000.h5")
    assert recording.header.failure is not None
    assert recording.header.failure.kind == kind
    assert len(recording["actions/time_s"]) == 2, "what it did before it died counts"
