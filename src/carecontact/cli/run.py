"""``carecontact run``: plan, run what is missing, score, report; with ``--demo`` three tasks of the exam, once."""

from __future__ import annotations

import json
import re
import shlex
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from carecontact.cli.console import print_answer, same_command, without_secret
from carecontact.cli.groups import (
    DEVELOPMENT_SEEDS,
    EXAM,
    EngineGroup,
    PhysicsGroup,
    PolicyGroup,
    RulesGroup,
    SaltGroup,
    Switch,
    VerboseGroup,
    VisionGroup,
    check_folder,
    read_run,
)
from carecontact.cli.parsing import UsageError, given_options
from carecontact.errors import ConfigError, RecordingError, counted

if TYPE_CHECKING:
    from collections.abc import Callable

    from carecontact.interface.policy import PolicyCard
    from carecontact.protocol.protocol import Protocol, TrialSpec
    from carecontact.running.supervisor import RunSummary, TrialEvent
    from carecontact.runs.manifest import Purpose
    from carecontact.runs.pooling import RunScores
    from carecontact.runs.scorer import Scorer
    from carecontact.scoring.result import TrialScore
    from carecontact.serving.conversation import PolicySetup

DEMO_POLICY, DEMO_SEED, DEMO_OUT = "state-machine", 0, Path("runs/demo")
DEMO_LEVEL, DEMO_TASKS = "L2", ("T1", "T2", "T3")
"""The exam, with one task of each action."""
DEMO_NOISE = 32 * "0"
"""The demo's sensor noise is the same each time."""
DEMO_OPTIONS = ("--demo", "--out", "--jobs", "--verbose", "--video")
RESULTS = "results.json"


@dataclass(frozen=True, kw_only=True)
class Run:
    """Run trials of one policy, score them and write the report. The same command, given again, runs only the trials
    that are missing."""

    policy: str | None = None
    """One of: a name from `carecontact list policies`; a module:Class that can be imported from the current folder; or
    ws://HOST:PORT, the address of a policy's server (see docs/your-policy.md; docs/vla.md for other projects'
    servers)."""
    demo: Switch = False
    """Without --policy: run three tasks of the exam once with state-machine into runs/demo, in place of an earlier
    demo, show the result between floor and ceiling, and fail unless the robot really touched, pushed and scrubbed.
    Only --out, --jobs, --verbose and --video go with it."""
    given: PolicyGroup = field(default_factory=PolicyGroup)
    out: Path | None = None
    """Folder for recordings, results.json and report.html; default: runs/POLICY-TIME."""
    tasks: str = "all"
    """Tasks to run: a list (T1,T2), a range (T1-T7), or all."""
    seeds: str = DEVELOPMENT_SEEDS
    """Seeds to run: one (3), a list (0,4,7), a range (0-19), or all. Results of the exam are those of 1000-1026."""
    rules: RulesGroup = field(default_factory=RulesGroup)
    physics: PhysicsGroup = field(default_factory=PhysicsGroup)
    stiffness: float | None = None
    """Translational stiffness of the robot's impedance control [N/m], in place of the protocol's; every output names
    this change. If the policy commands a stiffness itself, that one applies."""
    vision: VisionGroup = field(default_factory=VisionGroup)
    latency_ms: float | None = None
    """Simulated time between an observation and the first action that answers it [ms], in place of the protocol's (0:
    the world stands still while the policy computes). The last target holds meanwhile; every output names this
    change."""
    pace: float | None = None
    """Wall time for each control period [s], as the policy sees it: the next observation leaves when it has passed,
    however soon it is ready, so that the time reveals no contact (see docs/trust.md). It must be longer than the
    simulation of a period and the rendering take."""
    unfrozen: Switch = False
    """Run a frozen protocol even if it differs from its lock (see `carecontact protocol verify`). Every output then
    names the difference."""
    control: Literal["shuffled-look", "frozen-look", "no-touch"] | None = None
    """Run the policy with altered observations, as POLICY+CONTROL, to show what its rate is owed to: `shuffled-look`
    (pictures of another person), `frozen-look` (the first picture all the time) or `no-touch` (the arm always reads as
    being at its target). The run goes into the folder of that name inside --out, whose report shows it beside."""
    parallel: EngineGroup = field(default_factory=EngineGroup)
    shard: str | None = None
    """Run one part of the trials: 2/4 is the second of four parts. Give each part a folder of its own; `carecontact
    merge` makes one run of them."""
    noise_salt: str | None = None
    """Secret from which the sensor noise of a protocol is drawn: 32 hexadecimal digits. The parts of one run need the
    same; default: a fresh one."""
    salted: SaltGroup = field(default_factory=SaltGroup)
    retry_failed: Switch = False
    """Run again the trials in which the policy crashed (process_failure) or the harness failed (harness_error). The
    harness is the benchmark's own process that runs a trial."""
    restart: Switch = False
    """Run every trial again: carecontact moves an earlier run in --out to a folder beside it, and deletes nothing."""
    allow_failures: Switch = False
    """Exit with status 0 even if the policy crashed in a trial. Without this option, the status is then 3. If the
    harness failed, the status is 1 in either case."""
    video: Switch = False
    """Link in the report a draft video of the first failure of each cause, of three causes at most. Needs the extra viz
    and about 20 s of processor time for each."""
    output: VerboseGroup = field(default_factory=VerboseGroup)

    @cached_property
    def place(self) -> Path:
        if self.out is not None:
            return self.out / self.control if self.control else self.out
        name = re.sub(r"[^A-Za-z0-9._-]+", "-", without_secret(self.policy or "")).strip("-.")
        return DEMO_OUT if self.demo else Path("runs") / f"{name[-60:]}-{time.strftime('%Y%m%d-%H%M%S')}"

    @property
    def after_interrupt(self) -> str:
        if self.demo:
            return "; finished trials stay in the folder until the next demo there replaces them"
        return f"; finished trials are kept; to continue: {same_command(self.place)}"

    def __call__(self) -> int:
        if self.video:
            from carecontact.replay.film import pyav

            pyav()
        if self.demo:
            return self._demonstrate()
        if self.policy is None:
            raise UsageError("run: name a policy with --policy (`carecontact list policies`), or give --demo")
        status = self.execute(self.policy, purpose="run", variant=self.control or "")
        if self.control and self.out is not None and (self.out / RESULTS).is_file():
            from carecontact.cli.publish import write_page

            lines, _ = write_page(self.out, read_run(self.out))
            print(f"the control beside the policy without it: {lines[-1]}")
        return status

    def _demonstrate(self) -> int:
        from carecontact.running.supervisor import check_jobs
        from carecontact.runs.lock import folder_lock

        if wrong := [option for option in given_options(self) if option not in DEMO_OPTIONS]:
            raise ConfigError(f"{wrong[0]} does not go with --demo, which takes only {', '.join(DEMO_OPTIONS[1:])}")
        began = time.monotonic()
        check_jobs(self.parallel.jobs)
        trials = [f"{task}-s{DEMO_SEED:03d}" for task in DEMO_TASKS]
        with folder_lock(self.place, make=True):
            remove_earlier_demo(self.place, trial_ids=trials)
            rules = replace(self.rules, protocol=EXAM, level=DEMO_LEVEL)
            plan = {"tasks": ",".join(DEMO_TASKS), "seeds": str(DEMO_SEED), "noise_salt": DEMO_NOISE}
            replace(self, rules=rules, out=self.place, **plan).execute(DEMO_POLICY, purpose="demo")
        problems = check_demo(self.place, trial_ids=trials)
        for problem in problems:
            print(f"demo: {problem}")
        print(f"demo {'failed' if problems else 'succeeded'} in {time.monotonic() - began:.0f} s")
        return 1 if problems else 0

    def execute(self, policy: str, *, purpose: Purpose, variant: str = "", persons: int = 0) -> int:
        """Return 1 if the harness failed in any trial or a recording was skipped, else 3 if the policy crashed in one.
        A policy that fails its tasks is a result. ``persons``: how many persons to train on take the place of the
        seeds."""
        from carecontact.cli.policy import check_policy, policy_setup
        from carecontact.protocol.protocol import TRAINING_SALT
        from carecontact.running.pace import check_pace
        from carecontact.running.supervisor import check_engine, check_jobs, move_aside
        from carecontact.runs import plan
        from carecontact.runs.lock import folder_lock
        from carecontact.runs.manifest import runs_beside, with_salt

        check_jobs(self.parallel.jobs)
        check_pace(self.pace)
        shard = None if self.shard is None else plan.Shard.parse(self.shard)
        if self.restart and self.retry_failed:
            raise ConfigError("--restart runs every trial again, and --retry-failed only some; give one of them")
        salt, setup = TRAINING_SALT if persons else self.salted.salt, policy_setup(policy, self.given, variant)
        setup = replace(setup, closed=(*setup.closed, *self.salted.closed))
        if warning := check_engine(self.parallel.engine, setup, gpus=self.parallel.gpus):
            print(f"warning: {warning}")
        rules = self._protocol()
        tasks = plan.parse_tasks(self.tasks, protocol=rules)
        seeds = range(persons) if persons else plan.parse_seeds(self.seeds, protocol=rules)
        with ExitStack() as held:
            held.enter_context(folder_lock(self.place, make=True))
            closed = replace(setup, closed=(*setup.closed, *runs_beside(self.place)))
            card = check_policy(closed, deadline_s=rules.phases.first_call_deadline_s)
            planned = plan.plan_trials(
                protocol=rules,
                policy=setup.ref.text,
                tasks=tasks,
                seeds=seeds,
                arguments=setup.arguments,
                environment=setup.environment,
            )
            if card is not None:
                plan.check_not_trained_on(card.trained_on, with_salt(planned, salt))
            planned = plan.with_noise_salt(with_salt(planned, salt), self.noise_salt, one_of_several=shard is not None)
            specs = planned if shard is None else shard.of(planned)
            if self.restart and (moved := move_aside(self.place)) is not None:
                print(f"--restart: the earlier run in {self.place} is now {moved}")
                held.enter_context(folder_lock(self.place, make=True))
            whole = [spec.trial_id for spec in planned]
            return self._run(specs, setup, card=card, purpose=purpose, whole=whole)

    def _run(
        self, specs: list[TrialSpec], setup: PolicySetup, *, card: PolicyCard | None, purpose: Purpose, whole: list[str]
    ) -> int:
        from carecontact.cli.policy import arguments_text
        from carecontact.running.workers import available_cores
        from carecontact.runs import write_scores
        from carecontact.runs.scorer import Scorer

        title = specs[0].protocol.title
        part = f", part {self.shard}," if self.shard else ""
        trials = f"{counted(len(specs), 'trial')} of {title}{part}"
        print(f"{setup.ref}{arguments_text(setup)}: {trials} into {self.place}", flush=True)
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
                    write_scores(self.place, scores)  # The trials that run again may be stopped.
                again = [spec for spec in specs if spec.trial_id in damaged]
                summary = summary.followed_by(self._trials(again, setup, scorer, suspects=damaged, **more))
                scores = self._scores(summary, scorer)
            status = self._finish(summary, scores) if scores else 0
        if self.output.json and summary.unreached is None:
            self._answer_run(specs[0], summary, status=status)
        if summary.unreached is not None:
            why = summary.unreached.removeprefix(f"policy {setup.ref.text!r} failed at start: ")
            raise ConfigError(
                f"the run stops with {len(summary.ended)} of {counted(len(specs), 'trial')} done: {why}; then continue "
                f"with: {same_command(self.place)}"
            )
        return status

    def _trials(self, specs: list[TrialSpec], setup: PolicySetup, scorer: Scorer, **more: Any) -> RunSummary:
        from carecontact.cli.progress import progress
        from carecontact.running.supervisor import run_trials

        with progress(self.place, scorer) as on_event:
            return run_trials(
                specs,
                out=self.place,
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
            self._answer_trial(event, scorer)

    def _scores(self, summary: RunSummary, scorer: Scorer) -> RunScores | None:
        from carecontact.cli.publish import scores_of

        return scores_of(self.place, scored=scorer.take) if summary.ended else None

    def _finish(self, summary: RunSummary, scores: RunScores) -> int:
        from carecontact.cli.progress import print_failed, status_of, throughput
        from carecontact.cli.publish import publish
        from carecontact.report.words import clipped_text

        if self.video:
            from carecontact.cli.view import film_failures

            film_failures(self.place, (score for score in scores.scores if score.trial_id in summary.ran))
        # New trials change the summary as they should; only a run that had nothing to do can show an unexpected change.
        publish(self.place, scores, compare=not summary.ran, verbose=self.output.verbose)
        if self.output.verbose:
            print(f"a page for each trial: carecontact report {shlex.quote(str(self.place))} --trials")
            if summary.ran:
                print(throughput(len(summary.ran), summary.wall_s, summary.most_at_once))
        print_failed(summary.ended, out=self.place, again=same_command(self.place))
        if summary.late:
            late, trials = counted(sum(summary.late.values()), "observation"), counted(len(summary.late), "trial")
            print(
                f"warning: --pace {self.pace:g}: {late} of {trials} came too late, which may reveal contact; give a "
                "longer --pace, or fewer --jobs"
            )
        if clipped := clipped_text(scores.scores):
            print(f"warning: {clipped}")
        return 1 if scores.skipped else status_of(Counter(summary.ended.values()), allow_failures=self.allow_failures)

    def _answer_trial(self, event: TrialEvent, scorer: Scorer) -> None:
        """Print how a trial ended as JSON, if the event is its end. ``scorer`` was given the trials that ran."""
        from carecontact.cli.result_answers import TrialAnswer

        if event.kind not in ("kept", "finished") or event.ended is None:
            return
        kept = event.kind == "kept"
        print_answer(
            TrialAnswer(
                trial_id=event.trial_id,
                ended=event.ended,
                kept=kept,
                done=event.done,
                total=event.total,
                message=event.message,
                # Earlier commands may have kept many, and results.json has the scores of all of them in the end.
                score=None if kept else scorer.score_of(self.place / f"{event.trial_id}.h5"),
            )
        )

    def _answer_run(self, spec: TrialSpec, summary: RunSummary, *, status: int) -> None:
        from carecontact.cli.result_answers import RunAnswer, RunProtocol
        from carecontact.runs.results_file import RESULTS_NAME

        try:
            results = json.loads((self.place / RESULTS_NAME).read_bytes())
        except FileNotFoundError:
            results = {"overall": None, "skipped": {}}
        protocol = spec.protocol
        print_answer(
            RunAnswer(
                folder=str(self.place),
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

    def _protocol(self) -> Protocol:
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


def remove_earlier_demo(out: Path, *, trial_ids: Sequence[str]) -> None:
    """Remove what an earlier demo of the same trials wrote into ``out``, and nothing else."""
    from carecontact.running.supervisor import remove_abandoned
    from carecontact.runs.lock import LOCK
    from carecontact.runs.manifest import MANIFEST, read_manifest

    check_folder(out)
    if not out.exists() or all(path.name == LOCK for path in out.iterdir()):
        return
    manifest = read_manifest(out)
    # Of whatever protocol: the default of an earlier release had another id.
    demo = ("demo", DEMO_POLICY, sorted(trial_ids))
    mine = manifest is not None and (manifest.purpose, manifest.policy, manifest.trials) == demo
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
            why = reason_of(header.failure) if header.failure else "no reason recorded"
            problems.append(f"{trial_id} {ended_text(header.ended)}: {why}")
    return problems + missing_successes(score_run(out).scores)


def missing_successes(scores: Sequence[TrialScore]) -> list[str]:
    from carecontact.protocol.load import load_protocol

    done = {score.action for score in scores if score.c3_success}
    rules = load_protocol(EXAM, level=DEMO_LEVEL)
    wanted = dict.fromkeys(rules.task(task).action for task in DEMO_TASKS)
    return [f"no {action} task succeeded" for action in wanted if action not in done]
