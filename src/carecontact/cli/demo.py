"""``carecontact demo``: the seven tasks once, and proof that they really happened."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from carecontact.cli.run import run
from carecontact.errors import ConfigError, RecordingError
from carecontact.protocols import DEFAULT_PROTOCOL, load_protocol
from carecontact.recording import read_recording
from carecontact.recording.reason import reason_of
from carecontact.runs import score_run
from carecontact.runs.manifest import FAILED, MANIFEST, read_manifest
from carecontact.scoring.result import TrialScore
from carecontact.trials.supervisor import check_jobs, remove_abandoned

POLICY = "state-machine"
SEED = 0


def demo(*, out: Path, jobs: int | None) -> int:
    began = time.monotonic()
    check_jobs(jobs)
    protocol = load_protocol(DEFAULT_PROTOCOL)
    trial_ids = [f"{task.id}-s{SEED:03d}" for task in protocol.tasks]
    remove_earlier_demo(out, trial_ids=trial_ids)
    run(
        policy=POLICY,
        out=out,
        tasks="all",
        seeds=str(SEED),
        protocol=DEFAULT_PROTOCOL,
        jobs=jobs,
        retry_failed=False,
        purpose="demo",
    )
    problems = check_demo(out, trial_ids=trial_ids)
    for problem in problems:
        print(f"demo: {problem}")
    print(f"demo {'failed' if problems else 'succeeded'} in {time.monotonic() - began:.0f} s")
    return 1 if problems else 0


def remove_earlier_demo(out: Path, *, trial_ids: Sequence[str]) -> None:
    """Remove what an earlier demo of the same trials wrote into ``out``, and nothing else.

    Raises ConfigError for a folder that holds anything but such a demo.
    """
    if out.exists() and not out.is_dir():
        raise ConfigError(f"--out {out}: this is a file; name a folder")
    if not out.exists() or not any(out.iterdir()):
        return
    manifest = read_manifest(out)
    # Of whatever protocol: the default of an earlier release had another id.
    mine = manifest is not None and (manifest.purpose, manifest.policy, manifest.trials) == (
        "demo", POLICY, sorted(trial_ids),
    )  # fmt: skip
    foreign = sorted(path.name for path in out.glob("*.h5") if path.stem not in trial_ids)
    if not mine or foreign:
        what = f"{foreign[0]}, which is of no demo" if mine else "something other than an earlier demo"
        raise ConfigError(f"--out {out}: holds {what}; nothing was removed: use another --out, or empty the folder")
    remove_abandoned(out)
    written = [f"{trial_id}.{ending}" for trial_id in trial_ids for ending in ("h5", "log")]
    # The manifest last: after an interruption it still says that the rest may go.
    for name in (*written, "results.json", "report.html", MANIFEST):
        (out / name).unlink(missing_ok=True)


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
            told = reason_of(header.failure) if header.failure else "no reason recorded"
            problems.append(f"{trial_id} ended as {header.ended}: {told}")
    return problems + missing_successes(score_run(out).scores)


def missing_successes(scores: Sequence[TrialScore]) -> list[str]:
    done = {score.action for score in scores if score.c3_success}
    return [f"no {action} succeeded" for action in ("touch", "push", "scrub") if action not in done]
