"""A policy's server that is away when a trial begins: the trial waits; if the server stays away, the run stops."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest

from carecontact.episode.perception import Peak
from carecontact.episode.randomization import World
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording import read_recording, write_recording
from carecontact.recording.notes import read_notes
from carecontact.running.supervisor import RunSummary, TrialEvent, run_trials
from carecontact.running.trial import run_trial
from carecontact.runs.plan import plan_trials
from carecontact.scoring import score_recording
from carecontact.serving.conversation import PolicySetup
from carecontact.serving.namespaces import VARIABLE
from carecontact.serving.packing import pack
from tests.running.test_supervisor import Bench, bench, specs
from tests.serving.fuzz import replies
from tests.serving.served import served

__all__ = ["bench"]

POLICY = """
class P(Base):
    def act(self, observation):
        return Action(done=True)
"""
AWAY_S = 4.0
"""Longer than a trial needs to build its world, so that it finds no server there."""
FIRST_CALL_S = 4.0
"""How long a trial looks for a server; one that is there has shown its policy's card by then."""


def run(port: int, out: Path, on_event: object, *, first_call_s: float = 120.0) -> RunSummary:
    rules = load_protocol("bathing-v3")
    phases = rules.phases.model_copy(update={"first_call_deadline_s": first_call_s})
    physics = rules.physics.model_copy(update={"dt_s": 0.004})
    rules = rules.model_copy(update={"phases": phases, "physics": physics})
    address = f"ws://127.0.0.1:{port}"
    trials = plan_trials(protocol=rules, policy=address, tasks=["T1"], seeds=range(2))
    return run_trials(trials, out=out, policy=PolicySetup.of(address), jobs=1, on_event=on_event)  # pyright: ignore[reportArgumentType]


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
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


# A policy whose answer is spoilt on its way: the trial ends as its process failure, and the recording says why.

# Runs in the policy's process: its second answer is the bytes in spoilt.bin, as a message or as they are.
SPOILT_ANSWER_POLICY = """
from pathlib import Path
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard
from carecontact.serving import server

class P:
    card = PolicyCard(name="spoilt", control_hz=10)
    def reset(self, instruction): ...
    def act(self, observation):
        if observation.sim_time_s > 0:
            here = Path(__file__).parent
            data = (here / "spoilt.bin").read_bytes()
            if (here / "raw").exists():
                server.ServerConnection.send = lambda self, message: self.socket.sendall(data)
            else:
                server.pack = lambda message: data
        return Action()
"""
SPOILT = {
    "transport": (b"\x82\x85masked bytes from a server", "garbage", "the reply is not WebSocket"),
    "msgpack": (b"\xc1" + pack(replies()["actions"]), "garbage", "actions message: expected msgpack"),
    "schema": (pack({"type": "actions", "actions": [{"torque": 1.0}]}), "action", "unknown key torque"),
    "dtype": (pack({"type": "actions", "actions": [{"done": 1}]}), "action", "done: expected True or False, got int 1"),
    "shape": (pack({"type": "actions", "actions": []}), "action", "expected 1 to 2000 actions, got 0"),
    "value": (
        pack({"type": "actions", "actions": [{"gripper": float("nan")}]}),
        "action",
        r"opening in \[0, 1\], got nan",
    ),
}


@pytest.mark.parametrize("layer", SPOILT)
def test_the_trial_ends_as_the_policys_process_failure(
    layer: str, again: Callable[..., World], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data, kind, says = SPOILT[layer]
    (tmp_path / "spoilt_policy.py").write_text(SPOILT_ANSWER_POLICY)
    (tmp_path / "spoilt.bin").write_bytes(data)
    if layer == "transport":
        (tmp_path / "raw").touch()
    # The report's two pictures are not what is tested here.
    monkeypatch.setattr(Peak, "pictures", lambda self, renderer, region: {})
    spec = TrialSpec(protocol=load_protocol("bathing-v3"), task_id="T1", seed=0, policy="spoilt_policy:P")
    recording = run_trial(spec, policy=PolicySetup.of(spec.policy, search_path=[str(tmp_path)]), prepare=again)
    kept = read_recording(write_recording(recording, tmp_path / "trial.h5"))
    assert kept.header.ended == "process_failure"
    assert kept.header.failure is not None
    assert kept.header.failure.kind == kind
    assert re.search(says, kept.header.failure.message), kept.header.failure.message
    assert len(kept["scorer/time_s"]) == 50, "what ran before is kept"
    assert score_recording(kept).failure_mode == "process_failure"


FAILS = """
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard

class P:
    card = PolicyCard(name="fails", control_hz=10, modalities=("rgb",))
    steps = 0
    def reset(self, instruction): ...
    def act(self, observation):
        self.steps += 1
        if self.steps == LAST:
            raise ValueError("no grip")
        return Action()
    def take_notes(self):
        return {"step": self.steps}
"""


@pytest.mark.parametrize("last", [1, 2])
def test_a_step_that_fails_keeps_its_picture_and_notes_beside_those_before(
    last: int, again: Callable[..., World], tmp_path: Path
) -> None:
    name = f"fails_at_{last}"
    (tmp_path / f"{name}.py").write_text(FAILS.replace("LAST", str(last)))
    spec = TrialSpec(protocol=load_protocol("bathing-v3"), task_id="T1", seed=0, policy=f"{name}:P")
    recording = run_trial(spec, policy=PolicySetup.of(spec.policy, search_path=[str(tmp_path)]), prepare=again)
    assert recording.header.ended == "process_failure"
    assert len(recording["policy/observation_time_s"]) == last - 1
    notes = [(note.observation_index, note.content["step"]) for note in read_notes(recording)]
    assert notes == [(k, k + 1) for k in range(last)]
    frames = sorted(path for path in recording.arrays if path.startswith("policy/frames/"))
    assert frames == [f"policy/frames/{k:04d}/overhead/rgb" for k in range(last)]


# A server that answers several trials in one call gets several trials at once.

SERVER = Path(__file__).parents[2] / "examples" / "batching_server.py"
PATIENT = "WAIT_S = 5.0"
"""Long enough for the observation of the other trial, so that the size of a batch does not depend on the machine."""


def test_two_trials_share_the_batches_of_a_server(tmp_path: Path) -> None:
    script = tmp_path / "server.py"
    script.write_text(re.sub(r"^WAIT_S = .*$", PATIENT, SERVER.read_text(), flags=re.MULTILINE))
    command = [sys.executable, str(script), "--port", "0", "--most", "2"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            address = f"ws://127.0.0.1:{server.stdout.readline().split()[-1]}"
            rules = overridden(load_protocol("bathing-v3"), {"phases.time_limit_s": 1, "physics.dt_s": 0.004})
            specs = plan_trials(protocol=rules, policy=address, tasks=["T1"], seeds=range(2))
            found = run_trials(specs, out=tmp_path / "r", policy=PolicySetup.of(address), jobs=2)
            assert found.ended == {"T1-s000": "time_limit", "T1-s001": "time_limit"}
            assert found.most_at_once == 2
            batches, mean = re.findall(r"[\d.]+", server.stdout.readline())[:2]
            assert float(mean) > 1.2, f"{batches} batches"
        finally:
            server.terminate()
