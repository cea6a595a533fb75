"""``carecontact demo``: runs the seven tasks once and checks that the robot really touched, pushed and scrubbed."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from carecontact.cli.groups import FLAT, EngineGroup, JobsGroup
from carecontact.errors import ConfigError, RecordingError

if TYPE_CHECKING:
    from carecontact.scoring.result import TrialScore

POLICY = "state-machine"
SEED = 0


@dataclass(frozen=True, kw_only=True)
class Demo:
    """Run the seven tasks once with the state machine. The command fails unless the robot really touched, pushed and
    scrubbed."""

    out: Path = Path("runs/demo")
    """Folder for the demo. The command replaces an earlier demo in it, and refuses a folder that holds anything
    else."""
    parallel: Annotated[JobsGroup, FLAT] = field(default_factory=JobsGroup)

    after_interrupt: ClassVar[str] = "; finished trials stay in the folder until the next demo there replaces them"

    def __call__(self) -> int:
        from carecontact.cli.run import Run
        from carecontact.protocols import load_protocol
        from carecontact.runs.alone import alone
        from carecontact.trials.supervisor import check_jobs

        began = time.monotonic()
        check_jobs(self.parallel.jobs)
        run = Run(policy=POLICY, out=self.out, seeds=str(SEED), parallel=EngineGroup(jobs=self.parallel.jobs))
        trial_ids = [
            f"{task.id}-s{SEED:03d}" for task in load_protocol(run.rules.protocol, level=run.rules.level).tasks
        ]
        with alone(self.out, make=True):
            remove_earlier_demo(self.out, trial_ids=trial_ids)
            run.execute(purpose="demo")
        problems = check_demo(self.out, trial_ids=trial_ids)
        for problem in problems:
            print(f"demo: {problem}")
        print(f"demo {'failed' if problems else 'succeeded'} in {time.monotonic() - began:.0f} s")
        return 1 if problems else 0


def remove_earlier_demo(out: Path, *, trial_ids: Sequence[str]) -> None:
    """Remove what an earlier demo of the same trials wrote into ``out``, and nothing else.

    Raises ConfigError for a folder that holds anything but such a demo.
    """
    from carecontact.runs.alone import LOCK
    from carecontact.runs.manifest import MANIFEST, read_manifest
    from carecontact.trials.work_folder import remove_abandoned

    if out.exists() and not out.is_dir():
        raise ConfigError(f"--out {out}: this is a file; name a folder")
    if not out.exists() or all(path.name == LOCK for path in out.iterdir()):
        return
    manifest = read_manifest(out)
    # Of whatever protocol: the default of an earlier release had another id.
    mine = manifest is not None and (manifest.purpose, manifest.policy, manifest.trials) == (
        "demo", POLICY, sorted(trial_ids),
    )  # fmt: skip
    foreign = sorted(path.name for path in out.glob("*.h5") if path.stem not in trial_ids)
    if not mine or foreign:
        what = f"{foreign[0]}, which no demo wrote" if mine else "something other than an earlier demo"
        raise ConfigError(f"--out {out}: holds {what}; nothing was removed: use another --out, or empty the folder")
    remove_abandoned(out)
    written = [f"{trial_id}.{ending}" for trial_id in trial_ids for ending in ("h5", "log")]
    # The manifest last: after an interruption it still says that the rest may go.
    for name in (*written, "results.json", "report.html", MANIFEST):
        (out / name).unlink(missing_ok=True)


def check_demo(out: Path, *, trial_ids: Sequence[str]) -> list[str]:
    """Return one line for each thing that keeps this folder from being a demonstration."""
    from carecontact.recording import read_header
    from carecontact.recording.reason import ended_text, reason_of
    from carecontact.recording.schema import FAILED
    from carecontact.runs import score_run

    problems = []
    for trial_id in trial_ids:
        try:
            header = read_header(out / f"{trial_id}.h5")
        except RecordingError as error:
            problems.append(str(error))
            continue
        if header.ended in FAILED:
            told = reason_of(header.failure) if header.failure else "no reason recorded"
            problems.append(f"{trial_id} {ended_text(header.ended)}: {told}")
    return problems + missing_successes(score_run(out).scores)


def missing_successes(scores: Sequence[TrialScore]) -> list[str]:
    """Return one line for each action of the demo's protocol in which no trial succeeded."""
    from carecontact.protocols import load_protocol

    done = {score.action for score in scores if score.c3_success}
    wanted = dict.fromkeys(task.action for task in load_protocol().tasks)
    return [f"no {action} task succeeded" for action in wanted if action not in done]
