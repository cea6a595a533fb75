"""A policy's server that is away when a trial begins: the trial waits; if the server stays away, the run stops."""

from __future__ import annotations

import json
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest

from carecontact.hosting.isolation.namespaces import VARIABLE
from carecontact.hosting.setup import PolicySetup
from carecontact.protocols import load_protocol
from carecontact.recording import read_recording
from carecontact.runs.plan import plan_trials
from carecontact.trials.supervisor import RunSummary, TrialEvent, run_trials
from tests.hosting.served import served
from tests.trials.test_supervisor import Bench, bench, specs

__all__ = ["bench"]

POLICY = """
class P(Base):
    def act(self, observation):
        return Action(done=True)
"""
AWAY_S = 4.0
"""Longer than a trial needs to build its world, so that it finds nobody there."""
FIRST_CALL_S = 4.0
"""How long a trial looks for a server; one that is there has shown its policy's card by then."""


def run(port: int, out: Path, on_event: object, *, first_call_s: float = 120.0) -> RunSummary:
    rules = load_protocol()
    phases = rules.phases.model_copy(update={"first_call_deadline_s": first_call_s})
    physics = rules.physics.model_copy(update={"dt_s": 0.004})
    rules = rules.model_copy(update={"phases": phases, "physics": physics})
    address = f"ws://127.0.0.1:{port}"
    trials = plan_trials(protocol=rules, policy=address, tasks=["T1"], seeds=range(2))
    return run_trials(trials, out=out, policy=PolicySetup.of(address), jobs=1, on_event=on_event)  # pyright: ignore[reportArgumentType]


def test_a_server_that_restarts_between_trials_loses_none(tmp_path: Path) -> None:
    with ExitStack() as servers:
        port, first = servers.enter_context(served(POLICY, tmp_path))
        again = threading.Timer(AWAY_S, lambda: servers.enter_context(served(POLICY, tmp_path, port=port)))

        def restart(event: TrialEvent) -> None:
            if event.kind == "finished" and event.done == 1:
                first.kill()
                first.wait()
                again.start()

        summary = run(port, tmp_path / "r", restart)
        again.join()
    assert (summary.ended, summary.unreached) == ({"T1-s000": "done", "T1-s001": "done"}, None)


def test_a_server_that_stays_away_stops_the_run_and_no_trial_is_lost(tmp_path: Path) -> None:
    out = tmp_path / "r"
    with served(POLICY, tmp_path) as (port, server):

        def kill(event: TrialEvent) -> None:
            if event.kind == "finished":
                server.kill()
                server.wait()

        summary = run(port, out, kill, first_call_s=FIRST_CALL_S)
    assert (summary.ended, summary.ran) == ({"T1-s000": "done"}, ("T1-s000",))
    assert f"nothing listens at 127.0.0.1:{port}" in (summary.unreached or "")
    assert {path.name for path in out.iterdir()} == {"T1-s000.h5", "manifest.json"}
    assert json.loads((out / "manifest.json").read_text())["trials"] == ["T1-s000", "T1-s001"]
    with served(POLICY, tmp_path, port=port):
        summary = run(port, out, lambda event: None, first_call_s=FIRST_CALL_S)
    assert (summary.ran, summary.kept, summary.unreached) == (("T1-s001",), ("T1-s000",), None)


@pytest.fixture
def folders_on_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Policies run without namespaces, so that what one writes into its temporary folder is seen from outside."""
    monkeypatch.setenv(VARIABLE, "off")


def kill_in_act(number: int, folder: Path) -> tuple[str, Callable[[subprocess.Popen[str]], threading.Thread]]:
    """Source of a policy that hangs there once, and what then kills its server."""
    acts, hung = f"{folder.parent.name}-acts", folder / "hung"
    source = f"""
class P(Base):
    acts = 0
    def act(self, observation):
        self.acts += 1
        if self.acts == {number} and not os.path.exists({str(hung)!r}):
            open(os.path.join(os.environ["TMPDIR"], {acts!r}), "w")
            time.sleep(600)
        return Action(pose_tcp_in_base=observation.pose_tcp_in_base, done=self.acts > 1)
"""

    def killer(server: subprocess.Popen[str]) -> threading.Thread:
        def kill() -> None:
            while not any(Path(tempfile.gettempdir()).glob(f"carecontact-policy-*/{acts}")):
                time.sleep(0.05)
            hung.touch()
            server.kill()
            server.wait()

        thread = threading.Thread(target=kill, daemon=True)
        thread.start()
        return thread

    return source, killer


@pytest.mark.usefixtures("folders_on_disk")
def test_a_server_that_dies_in_a_trial_is_that_trials_failure(tmp_path: Path) -> None:
    """Its trial has begun: what it commanded counts."""
    source, killer = kill_in_act(2, tmp_path)
    with served(source, tmp_path) as (port, server):
        killer(server)
        summary = run(port, tmp_path / "r", lambda event: None, first_call_s=FIRST_CALL_S)
    assert summary.ended == {"T1-s000": "process_failure"}
    assert "nothing listens" in (summary.unreached or "")
    failure = read_recording(tmp_path / "r" / "T1-s000.h5").header.failure
    assert failure is not None
    assert failure.kind == "died"


@pytest.mark.usefixtures("folders_on_disk")
def test_a_server_that_dies_before_its_first_answer_loses_no_trial(tmp_path: Path) -> None:
    source, killer = kill_in_act(1, tmp_path)
    with ExitStack() as servers:
        port, server = servers.enter_context(served(source, tmp_path))

        def again() -> None:
            dead.join()
            servers.enter_context(served(source, tmp_path, port=port))

        dead = killer(server)
        restart = threading.Thread(target=again, daemon=True)
        restart.start()
        summary = run(port, tmp_path / "r", lambda event: None)
        restart.join()
    assert (summary.ended, summary.unreached) == ({"T1-s000": "done", "T1-s001": "done"}, None)


def test_trials_that_run_end_before_the_run_stops(bench: Bench) -> None:
    address = "ws://127.0.0.1:9"
    trials = specs(4, policy=address)
    summary = bench.run(trials, {"T1-s000": "slow", "T1-s001": "unreached"}, policy=PolicySetup.of(address))
    assert summary.ended == {"T1-s000": "done"}
    assert summary.unreached == "nothing listens there"
    assert bench.ran() == ["T1-s000", "T1-s001"]


def test_a_policy_of_this_machine_cannot_leave_out_a_trial(bench: Bench) -> None:
    summary = bench.run(specs(1), {"T1-s000": "unreached"})
    assert (summary.ended, summary.unreached) == ({"T1-s000": "harness_error"}, None)
