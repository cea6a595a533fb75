"""A policy whose answer is spoilt on its way: the trial ends as its process failure, and the recording says why."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from carecontact.contract.trial import TrialSpec
from carecontact.episode.peak import Peak
from carecontact.episode.prepare import settled_world
from carecontact.hosting.setup import PolicySetup
from carecontact.hosting.wire.packing import pack
from carecontact.protocols import load_protocol
from carecontact.recording import read_recording, write_recording
from carecontact.recording.notes import read_notes
from carecontact.scoring import score_recording
from carecontact.sim.simulation import Settled, Simulation
from carecontact.trials.trial import run_trial
from tests.hosting.wire.fuzz import replies

# Runs in the policy's process: its second answer is the bytes in spoilt.bin, as a message or as they are.
POLICY = """
from pathlib import Path
from carecontact.contract.action import Action
from carecontact.contract.policy import PolicyCard
from carecontact.hosting.wire import server

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
World = tuple[Simulation, Settled, str]


@pytest.fixture(scope="module")
def begin() -> Callable[[TrialSpec], World]:
    """One settled world, given again to every trial."""
    protocol = load_protocol()
    simulation, settled, sha256 = settled_world(protocol, task_id="T1", seed=0)
    state = simulation.integration_state()

    def again(spec: TrialSpec) -> World:
        fresh = Simulation(simulation.scene)
        fresh.restore(state, comfort_arm_deg=settled.comfort_arm_deg)
        return fresh, settled, sha256

    return again


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
    layer: str, begin: Callable[[TrialSpec], World], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data, kind, says = SPOILT[layer]
    (tmp_path / "spoilt_policy.py").write_text(POLICY)
    (tmp_path / "spoilt.bin").write_bytes(data)
    if layer == "transport":
        (tmp_path / "raw").touch()
    # The report's two pictures are not what is tested here.
    monkeypatch.setattr(Peak, "pictures", lambda self, renderer, region: {})
    spec = TrialSpec(protocol=load_protocol(), task_id="T1", seed=0, policy="spoilt_policy:P")
    recording = run_trial(spec, policy=PolicySetup.of(spec.policy, search_path=[str(tmp_path)]), prepare=begin)
    kept = read_recording(write_recording(recording, tmp_path / "trial.h5"))
    assert kept.header.ended == "process_failure"
    assert kept.header.failure is not None
    assert kept.header.failure.kind == kind
    assert re.search(says, kept.header.failure.message), kept.header.failure.message
    assert len(kept["scorer/time_s"]) == 50, "what ran before is kept"
    assert score_recording(kept).failure_mode == "process_failure"


FAILS = """
from carecontact.contract.action import Action
from carecontact.contract.policy import PolicyCard

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
    last: int, begin: Callable[[TrialSpec], World], tmp_path: Path
) -> None:
    name = f"fails_at_{last}"
    (tmp_path / f"{name}.py").write_text(FAILS.replace("LAST", str(last)))
    spec = TrialSpec(protocol=load_protocol(), task_id="T1", seed=0, policy=f"{name}:P")
    recording = run_trial(spec, policy=PolicySetup.of(spec.policy, search_path=[str(tmp_path)]), prepare=begin)
    assert recording.header.ended == "process_failure"
    assert len(recording["policy/observation_time_s"]) == last - 1
    notes = [(note.observation_index, note.content["step"]) for note in read_notes(recording)]
    assert notes == [(k, k + 1) for k in range(last)]
    frames = sorted(path for path in recording.arrays if path.startswith("policy/frames/"))
    assert frames == [f"policy/frames/{k:04d}/overhead/rgb" for k in range(last)]
