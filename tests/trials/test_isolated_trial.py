"""What isolates a policy changes nothing of its trial."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from carecontact.hosting.isolation.fence import available
from carecontact.protocols import load_protocol, overridden
from carecontact.recording.reader import read_verified
from carecontact.runs.plan import plan_trials
from carecontact.trials.request import setup_of
from carecontact.trials.supervisor import run_trials


def test_the_hash_is_the_same_with_and_without_isolation(tmp_path: Path) -> None:
    protocol = overridden(load_protocol(), {"physics.dt_s": 0.004, "phases.time_limit_s": 2.0})
    (spec,) = plan_trials(protocol=protocol, policy="state-machine", tasks=["T1"], seeds=[0])
    found = {}
    for isolated in (True, False):
        out = tmp_path / str(isolated)
        run_trials([spec], out=out, jobs=1, policy=replace(setup_of(spec), isolated=isolated))
        found[isolated] = read_verified(out / f"{spec.trial_id}.h5")
        assert found[isolated].recording.header.failure is None
    levels = {isolated: verified.recording["wall/isolation"].tobytes().decode() for isolated, verified in found.items()}
    assert levels == {True: available(), False: "none: switched off"}
    assert found[True].sha256 == found[False].sha256
