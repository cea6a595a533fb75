"""A server that answers several trials in one call gets several trials at once."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from carecontact.hosting.setup import PolicySetup
from carecontact.protocols import load_protocol, overridden
from carecontact.runs.plan import plan_trials
from carecontact.trials.supervisor import run_trials

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
            rules = overridden(load_protocol(), {"phases.time_limit_s": 1, "physics.dt_s": 0.004})
            specs = plan_trials(protocol=rules, policy=address, tasks=["T1"], seeds=range(2))
            found = run_trials(specs, out=tmp_path / "r", policy=PolicySetup.of(address), jobs=2)
            assert found.ended == {"T1-s000": "time_limit", "T1-s001": "time_limit"}
            assert found.most_at_once == 2
            batches, mean = re.findall(r"[\d.]+", server.stdout.readline())[:2]
            assert float(mean) > 1.2, f"{batches} batches"
        finally:
            server.terminate()
