"""``carecontact run``: plan, run what is missing, score, report; ``carecontact demo`` does it once for the seven
tasks."""

from __future__ import annotations

import json
import shlex
import time
from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from carecontact.cli.console import print_answer
from carecontact.cli.groups import (
    FLAT,
    EngineGroup,
    JobsGroup,
    JsonGroup,
    PhysicsGroup,
    PolicyGroup,
    RulesGroup,
    SaltGroup,
    Switch,
    VisionGroup,
)
from carecontact.errors import ConfigError, RecordingError, counted

if TYPE_CHECKING:
    from collections.abc import Callable

    from carecontact.interface.policy import PolicyCard
    from carecontact.protocol.protocol import Protocol, TrialSpec
    from carecontact.running.scorer import Scorer
    from carecontact.running.supervisor import RunSummary, TrialEvent
    from carecontact.runs.manifest import Purpose
    from carecontact.runs.pooling import RunScores
    from carecontact.scoring.result import TrialScore
    from carecontact.serving.conversation import PolicySetup


# The lines of JSON that `carecontact run --json` prints.


def say_trial(event: TrialEvent, folder: Path, scorer: Scorer) -> None:
    """Write how a trial ended, if the event is its end.

    Args:
        scorer: was given the trials that ran.
    """
    from carecontact.cli.result_answers import TrialAnswer

    if event.kind not in ("kept", "finished") or event.ended is None:
        return
    kept = event.kind == "kept"
    # An earlier command may have kept many, and results.json has the scores of all of them in the end.
    score = None if kept else scorer.score_of(folder / f"{event.trial_id}.h5")
    print_answer(
        TrialAnswer(
            trial_id=event.trial_id,
            ended=event.ended,
            kept=kept,
            done=event.done,
            total=event.total,
            message=event.message,
            score=score,
        )
    )


def say_run(spec: TrialSpec, folder: Path, summary: RunSummary, *, status: int) -> None:
    """Write the summary of the run.

    Args:
        spec: any trial of the run.
    """
    from carecontact.cli.result_answers import RunAnswer, RunProtocol
    from carecontact.cli.score import RESULTS

    try:
        results = json.loads((folder / RESULTS).read_bytes())
    except FileNotFoundError:
        results = {"overall": None, "skipped": {}}
    protocol = spec.protocol
    print_answer(
        RunAnswer(
            folder=str(folder),
            policy=spec.policy,
            protocol=RunProtocol(id=protocol.name, sha256=protocol.sha256, overrides=protocol.overrides),
            ended=summary.ended,
            ran=list(summary.ran),
            kept=list(summary.kept),
            late=summary.late,
            skipped=results["skipped"],
            overall=results["overall"],
            status=status,
        )
    )


# ``carecontact run``: plan, run what is missing, score, report.


@dataclass(frozen=True, kw_only=True)
class Run:
    """Run trials of one policy, score them and write the report. The same command, given again, runs only the trials
    that are missing."""

    policy: str
    """One of: a name from `carecontact list policies`; a module:Class that can be imported from the current folder; or
    ws://HOST:PORT, the address of a policy's server (see docs/wire.md; docs/dialects.md for other projects'
    servers)."""
    given: Annotated[PolicyGroup, FLAT] = field(default_factory=PolicyGroup)
    out: Path
    """Folder for recordings, results.json and report.html."""
    tasks: str = "all"
    """Tasks to run: a list (T1,T2), a range (T1-T7), or all."""
    seeds: str = "all"
    """Seeds to run: one (3), a list (0,4,7), a range (0-19), or all."""
    rules: Annotated[RulesGroup, FLAT] = field(default_factory=RulesGroup)
    physics: Annotated[PhysicsGroup, FLAT] = field(default_factory=PhysicsGroup)
    stiffness: float | None = None
    """Translational stiffness of the robot's impedance control [N/m], in place of the protocol's; every output names
    this change. If the policy commands a stiffness itself, that one applies."""
    vision: Annotated[VisionGroup, FLAT] = field(default_factory=VisionGroup)
    latency_ms: float | None = None
    """Simulated time between an observation and the first action that answers it [ms], in place of the protocol's (0:
    the world stands still while the policy computes). The last target holds meanwhile; every output names this
    change."""
    pace: float | None = None
    """Wall time for each control period [s], as the policy sees it: the next observation leaves when it has passed,
    however soon it is ready, so that the time reveals no contact (see docs/threat-model.md). It must be longer than the
    simulation of a period and the rendering take."""
    unfrozen: Switch = False
    """Run a frozen protocol even if it differs from its lock (see `carecontact protocol verify`). Every output then
    names the difference."""
    parallel: Annotated[EngineGroup, FLAT] = field(default_factory=EngineGroup)
    shard: str | None = None
    """Run one part of the trials: 2/4 is the second of four parts. Give each part a folder of its own; `carecontact
    merge` makes one run of them."""
    noise_salt: str | None = None
    """Secret from which the sensor noise of a protocol is drawn: 32 hexadecimal digits. The parts of one run need the
    same; default: a fresh one."""
    salted: Annotated[SaltGroup, FLAT] = field(default_factory=SaltGroup)
    retry_failed: Switch = False
    """Run again the trials in which the policy crashed (process_failure) or the harness failed (harness_error). The
    harness is the benchmark's own process that runs a trial."""
    restart: Switch = False
    """Begin the folder anew: carecontact moves an earlier run in --out to a folder beside it, and deletes nothing."""
    allow_failures: Switch = False
    """Exit with status 0 even if the policy crashed in a trial. Without this option, the status is then 3. If the
    harness failed, the status is 1 in either case."""

    output: Annotated[JsonGroup, FLAT] = field(default_factory=JsonGroup)

    after_interrupt: ClassVar[str] = "; finished trials are kept; give the same command again to continue"

    def __call__(self) -> int:
        return self.execute(purpose="run")

    def execute(self, *, purpose: Purpose) -> int:
        """Return 1 if the harness failed in any trial or a recording was skipped, else 3 if the policy crashed in one.

        A policy that fails its tasks is a result. Raises ConfigError if the policy's server stays out of reach."""
        from carecontact.cli.policy import check_policy, policy_setup
        from carecontact.running.pace import check_pace
        from carecontact.running.supervisor import check_engine, check_jobs
        from carecontact.runs.lock import folder_lock
        from carecontact.runs.manifest import runs_beside, with_salt
        from carecontact.runs.plan import Shard, parse_seeds, parse_tasks, plan_trials, with_noise_salt

        check_jobs(self.parallel.jobs)
        check_pace(self.pace)
        shard = None if self.shard is None else Shard.parse(self.shard)
        if self.restart and self.retry_failed:
            raise ConfigError("--restart runs every trial again, and --retry-failed only some; give one of them")
        salt, setup = self.salted.salt, policy_setup(self.policy, self.given)
        setup = replace(setup, closed=(*setup.closed, *self.salted.closed))
        if told := check_engine(self.parallel.engine, setup, gpus=self.parallel.gpus):
            print(f"warning: {told}")
        rules = self._protocol()
        tasks, seeds = parse_tasks(self.tasks, protocol=rules), parse_seeds(self.seeds, protocol=rules)
        with ExitStack() as held:
            held.enter_context(folder_lock(self.out, make=True))
            closed = replace(setup, closed=(*setup.closed, *runs_beside(self.out)))
            card = check_policy(closed, deadline_s=rules.phases.first_call_deadline_s)
            planned = plan_trials(
                protocol=rules,
                policy=setup.ref.text,
                tasks=tasks,
                seeds=seeds,
                arguments=setup.arguments,
                environment=setup.environment,
            )
            planned = with_noise_salt(with_salt(planned, salt), self.noise_salt, one_of_several=shard is not None)
            specs = planned if shard is None else shard.of(planned)
            if self.restart and restart(self.out):
                held.enter_context(folder_lock(self.out, make=True))
            whole = [spec.trial_id for spec in planned]
            return self._run(specs, setup, card=card, purpose=purpose, whole=whole)

    def _run(
        self, specs: list[TrialSpec], setup: PolicySetup, *, card: PolicyCard | None, purpose: Purpose, whole: list[str]
    ) -> int:
        from carecontact.cli.policy import arguments_text
        from carecontact.running.scorer import Scorer
        from carecontact.running.workers import available_cores
        from carecontact.runs import write_scores

        title = specs[0].protocol.title
        part = f", part {self.shard}," if self.shard else ""
        trials = f"{counted(len(specs), 'trial')} of {title}{part}"
        print(f"{setup.ref}{arguments_text(setup)}: {trials} into {self.out}", flush=True)
        if specs[0].commitment:
            print(f"salted: sha256 {specs[0].commitment}", flush=True)
        cores = min(available_cores(), self.parallel.jobs or available_cores())
        with closing(Scorer(cores, trials=len(specs))) as scorer:
            more = {"card": card, "purpose": purpose, "whole": whole}
            summary = self._trials(specs, setup, scorer, retry_failed=self.retry_failed, **more)
            scores = self._scores(summary, scorer)
            # Scoring alone reads every array; the run then repeats the trials of what scoring skipped as damaged.
            if scores and (damaged := [trial for trial in summary.kept if f"{trial}.h5" in scores.skipped]):
                print(f"damaged recordings, whose trials run again: {', '.join(damaged)}", flush=True)
                if scores.scores:
                    write_scores(self.out, scores)  # The trials that run again may be stopped.
                again = [spec for spec in specs if spec.trial_id in damaged]
                summary = summary.followed_by(self._trials(again, setup, scorer, suspects=damaged, **more))
                scores = self._scores(summary, scorer)
            status = self._finish(summary, scores) if scores else 0
        if self.output.json and summary.unreached is None:
            say_run(specs[0], self.out, summary, status=status)
        if summary.unreached is not None:
            again = "the same command again" + (" without --restart" if self.restart else "")
            why = summary.unreached.removeprefix(f"policy {setup.ref.text!r} failed at start: ")
            raise ConfigError(
                f"the run stops with {len(summary.ended)} of {counted(len(specs), 'trial')} done: {why}; then give "
                f"{again} to continue"
            )
        return status

    def _trials(self, specs: list[TrialSpec], setup: PolicySetup, scorer: Scorer, **more: Any) -> RunSummary:
        from carecontact.cli.progress import progress
        from carecontact.running.supervisor import run_trials

        with progress(self.out, scorer) as on_event:
            return run_trials(
                specs,
                out=self.out,
                jobs=self.parallel.jobs,
                engine=self.parallel.engine,
                gpus=self.parallel.gpus,
                policy=setup,
                weights=self.vision.weights and self.vision.weights.resolve(),
                pace_s=self.pace,
                on_event=lambda event: self._show(event, on_event, scorer),
                **more,
            )

    def _show(self, event: TrialEvent, on_event: Callable[[TrialEvent], None], scorer: Scorer) -> None:
        on_event(event)
        if event.kind == "warned":
            print(f"warning: the first answer of {event.trial_id}, {event.message}", flush=True)
        if self.output.json:
            say_trial(event, self.out, scorer)

    def _scores(self, summary: RunSummary, scorer: Scorer) -> RunScores | None:
        """Score the recordings; None if no trial has ended."""
        from carecontact.cli.score import scores_of

        return scores_of(self.out, scored=scorer.take) if summary.ended else None

    def _finish(self, summary: RunSummary, scores: RunScores) -> int:
        """Write results.json and the report, print the table, and return the exit status."""
        from carecontact.cli.progress import failed_status, print_failed
        from carecontact.cli.score import publish
        from carecontact.report.words import clipped_text

        # New trials change the summary as they should; only a run that had nothing to do can show an unexpected change.
        publish(self.out, scores, compare=not summary.ran, page=True)
        print(f"a page for each trial: carecontact report {shlex.quote(str(self.out))} --trials")
        print_failed(summary.ended, out=self.out)
        if summary.ran:
            print(throughput(len(summary.ran), summary.wall_s, summary.most_at_once))
        if summary.late:
            late, verb = sum(summary.late.values()), "was" if sum(summary.late.values()) == 1 else "were"
            print(
                f"warning: --pace {self.pace:g}: {counted(late, 'observation')} of "
                f"{counted(len(summary.late), 'trial')} {verb} not ready in time, which may reveal contact; give a "
                "longer --pace, or fewer --jobs"
            )
        if clipped := clipped_text(scores.scores):
            print(f"warning: {clipped}")
        return failed_status(summary.ended, allow_failures=self.allow_failures) if not scores.skipped else 1

    def _protocol(self) -> Protocol:
        """Return the protocol of the run.

        Raises ConfigError for a protocol that cannot run or be scored, and UnknownNameError for a name that no protocol
        has.
        """
        from carecontact.cli.policy import with_vision
        from carecontact.protocol.load import load_protocol
        from carecontact.runs.identity import check_frozen
        from carecontact.runs.plan import check_protocol, check_rows

        name = self.rules.protocol
        loaded = check_frozen(name, load_protocol(name, level=self.rules.level), unfrozen=self.unfrozen)
        stiffness = {} if self.stiffness is None else {"impedance.translational_n_m": self.stiffness}
        latency = {} if self.latency_ms is None else {"phases.latency_s": self.latency_ms / 1000}
        changed = self.rules.changed(
            loaded, **self.physics.changes(loaded), stiffness=stiffness, **{"latency-ms": latency}
        )
        rules = with_vision(changed, self.vision)
        check_protocol(rules)
        check_rows(rules)
        return rules


def throughput(trials: int, wall_s: float, most_at_once: int) -> str:
    """Return one line about how fast the trials ran.

    Args:
        wall_s: time that they took [s].
    """
    rate = f"{60 * trials / wall_s:.1f} a minute"
    return f"{counted(trials, 'trial')} in {wall_s:.0f} s, at most {most_at_once} at once: {rate}"


def restart(out: Path) -> bool:
    """Move an earlier run aside and print its new place. Return whether there was an earlier run.

    Raises ConfigError for a folder that is not a run."""
    from carecontact.running.supervisor import move_aside

    moved = move_aside(out)
    if moved is not None:
        print(f"--restart: the earlier run in {out} is now {moved}")
    return moved is not None


# ``carecontact demo``: runs the seven tasks once and checks that the robot really touched, pushed and scrubbed.

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
        from carecontact.protocol.load import load_protocol
        from carecontact.running.supervisor import check_jobs
        from carecontact.runs.lock import folder_lock

        began = time.monotonic()
        check_jobs(self.parallel.jobs)
        run = Run(policy=POLICY, out=self.out, seeds=str(SEED), parallel=EngineGroup(jobs=self.parallel.jobs))
        trial_ids = [
            f"{task.id}-s{SEED:03d}" for task in load_protocol(run.rules.protocol, level=run.rules.level).tasks
        ]
        with folder_lock(self.out, make=True):
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
    from carecontact.running.supervisor import remove_abandoned
    from carecontact.runs.lock import LOCK
    from carecontact.runs.manifest import MANIFEST, read_manifest

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
    from carecontact.protocol.load import load_protocol

    done = {score.action for score in scores if score.c3_success}
    wanted = dict.fromkeys(task.action for task in load_protocol().tasks)
    return [f"no {action} task succeeded" for action in wanted if action not in done]
