"""A trial whose policy is silent reports it while it runs."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

from carecontact.contract.policy_ref import PolicyRef
from carecontact.hosting.conversation import WAIT_REPORT_S
from carecontact.hosting.setup import PolicySetup
from carecontact.trials.launch import Launcher
from carecontact.trials.lost import Losses
from carecontact.trials.worker import WAITING
from carecontact.trials.workers import Workers
from tests.scoring.synthetic import touch

SPEC = touch(seed=0).header.spec


def test_the_supervisor_reads_the_line_while_it_is_fresh(tmp_path: Path) -> None:
    (tmp_path / "work").mkdir()
    setup = PolicySetup(ref=PolicyRef.parse(SPEC.policy))
    workers = Workers(
        out=tmp_path, work=tmp_path / "work", policy=setup, weights=None, pace_s=None,
        losses=Losses(setup, out=tmp_path, before=()),
        launcher=Launcher([sys.executable, "-c", "import time; time.sleep(60)"]), trial_limit_s=60,
    )  # fmt: skip
    workers.start(SPEC)
    try:
        assert workers.waiting() == {}
        note = workers.running[0].partial.with_name(WAITING)
        note.write_text("waiting for the policy: 40 of 120 s")
        assert workers.waiting() == {SPEC.trial_id: "waiting for the policy: 40 of 120 s"}
        past = time.time() - 3 * WAIT_REPORT_S
        os.utime(note, (past, past))
        assert workers.waiting() == {}, "it has answered since"
    finally:
        workers.kill_all()
