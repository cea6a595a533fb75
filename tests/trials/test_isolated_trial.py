"""What isolates a policy changes nothing of its trial."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from carecontact.hosting.isolation.fence import available
from carecontact.hosting.isolation.namespaces import VARIABLE
from carecontact.protocols import load_protocol, overridden
from carecontact.recording import read_recording
from carecontact.runs.plan import plan_trials
from carecontact.trials.request import setup_of
from carecontact.trials.supervisor import run_trials


def test_the_hash_is_the_same_with_and_without_isolation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    protocol = overridden(load_protocol(), {"physics.dt_s": 0.004, "phases.time_limit_s": 2.0})
    (spec,) = plan_trials(protocol=protocol, policy="state-machine", tasks=["T1"], seeds=[0])
    found, levels = {}, {}
    for kind in ("namespaces", "no namespaces", "none"):
        isolated, out = kind != "none", tmp_path / kind
        monkeypatch.setenv(VARIABLE, "off" if kind == "no namespaces" else "")
        run_trials([spec], out=out, jobs=1, policy=replace(setup_of(spec), isolated=isolated))
        found[kind] = read_recording(out / f"{spec.trial_id}.h5")
        assert found[kind].header.failure is None
        levels[kind] = (found[kind]["wall/isolation"].tobytes().decode(), available())
    assert levels.pop("none")[0] == "none: switched off"
    assert all(recorded == given for recorded, given in levels.values())
    assert len({recording.stored_sha256 for recording in found.values()}) == 1
