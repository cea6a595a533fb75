"""``carecontact demo``: the seven tasks once, and proof that they really happened."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from carecontact.cli.run import run
from carecontact.errors import ConfigError, RecordingError
from carecontact.protocols import DEFAULT_PROTOCOL, load_protocol
from carecontact.recording import read_recording
from carecontact.scoring import score_run
from carecontact.scoring.result import TrialScore
from carecontact.trials.manifest import FAILED, MANIFEST

POLICY = "state-machine"
SEED = 0
LEFTOVERS = ("*.h5", "*.log", MANIFEST, "results.json", "report.html")
"""What an earlier demo leaves; nothing else in the folder is touched."""


def demo(*, out: Path, jobs: int | None) -> int:
    began = time.monotonic()
    if out.exists() and not out.is_dir():
        raise ConfigError(f"--out {out}: this is a file; name a folder")
    for pattern in LEFTOVERS:
        for path in out.glob(pattern):
            path.unlink()
    protocol = load_protocol(DEFAULT_PROTOCOL)
    run(
        policy=POLICY,
        out=out,
        tasks="all",
        seeds=str(SEED),
        protocol=DEFAULT_PROTOCOL,
        jobs=jobs,
        retry_failed=False,
    )
    problems = check_demo(out, trial_ids=[f"{task.id}-s{SEED:03d}" for task in protocol.tasks])
    for problem in problems:
        print(f"demo: {problem}")
    print(f"demo {'failed' if problems else 'succeeded'} in {time.monotonic() - began:.0f} s")
    return 1 if problems else 0


def check_demo(out: Path, *, trial_ids: Sequence[str]) -> list[str]:
    """Whatever keeps this folder from being a demonstration, in lines."""
    problems = []
    for trial_id in trial_ids:
        try:
            header = read_recording(out / f"{trial_id}.h5").header
        except RecordingError as error:
            problems.append(str(error))
            continue
        if header.ended in FAILED:
            told = header.failure.message.partition("\n")[0] if header.failure else "no reason recorded"
            problems.append(f"{trial_id} ended as {header.ended}: {told}")
    return problems + missing_successes(score_run(out).scores)


def missing_successes(scores: Sequence[TrialScore]) -> list[str]:
    done = {score.action for score in scores if score.c3_success}
    return [f"no {action} succeeded" for action in ("touch", "push", "scrub") if action not in done]
