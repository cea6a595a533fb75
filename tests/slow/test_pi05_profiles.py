"""Both profiles of pi0.5 on every task of both protocols, with a server that answers harmless chunks."""

from __future__ import annotations

import pytest

from carecontact.contract.trial import TrialSpec
from carecontact.protocols import load_protocol
from carecontact.trials.trial import run_trial
from tests.hosting.dialects.fakes import Fake, Openpi, OpenpiPositions

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("protocol", ["bathing-v3-draft", "bathing-droid-draft"])
@pytest.mark.parametrize(
    ("profile", "server"), [("pi05-droid", Openpi(steps=15)), ("pi05-droid-jointpos", OpenpiPositions(steps=15))]
)
@pytest.mark.parametrize("task", [f"T{number}" for number in range(1, 8)])
def test_a_trial_completes(protocol: str, profile: str, server: Fake, task: str) -> None:
    with server.running() as port:
        address = f"openpi://127.0.0.1:{port}?profile={profile}"
        recording = run_trial(TrialSpec(protocol=load_protocol(protocol), task_id=task, seed=0, policy=address))
    assert recording.header.ended == "time_limit", recording.header.failure
    assert len(recording["actions/joint"]) == 450
