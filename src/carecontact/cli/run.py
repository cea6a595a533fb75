"""``carecontact run``: plan, run what is missing, score, report."""

from __future__ import annotations

import shlex
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from carecontact.cli.groups import (
    FLAT,
    EngineGroup,
    JsonGroup,
    PhysicsGroup,
    PolicyGroup,
    RulesGroup,
    SaltGroup,
    Switch,
    VisionGroup,
)
from carecontact.cli.run_lines import say_run, say_trial
from carecontact.errors import ConfigError, counted

if TYPE_CHECKING:
    from collections.abc import Callable

    from carecontact.contract.policy import PolicyCard
    from carecontact.contract.protocol import Protocol
    from carecontact.contract.trial import TrialSpec
    from carecontact.hosting.setup import PolicySetup
    from carecontact.runs.manifest import Purpose
    from carecontact.runs.run_scores import RunScores
    from carecontact.trials.scorer import Scorer
    from carecontact.trials.supervisor import RunSummary, TrialEvent


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
        from carecontact.runs.alone import alone
        from carecontact.runs.manifest import runs_beside
        from carecontact.runs.plan import parse_seeds, parse_tasks, plan_trials, with_noise_salt
        from carecontact.runs.salt import with_salt
        from carecontact.runs.shard import Shard
        from carecontact.trials.engines import check_engine
        from carecontact.trials.pace import check_pace
        from carecontact.trials.supervisor import check_jobs

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
            held.enter_context(alone(self.out, make=True))
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
                held.enter_context(alone(self.out, make=True))
            whole = [spec.trial_id for spec in planned]
            return self._run(specs, setup, card=card, purpose=purpose, whole=whole)

    def _run(
        self, specs: list[TrialSpec], setup: PolicySetup, *, card: PolicyCard | None, purpose: Purpose, whole: list[str]
    ) -> int:
        from carecontact.cli.policy import arguments_text
        from carecontact.runs import write_scores
        from carecontact.trials.scorer import Scorer
        from carecontact.trials.workers import available_cores

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
        from carecontact.trials.supervisor import run_trials

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
        from carecontact.cli.rescoring import scores_of

        return scores_of(self.out, scored=scorer.take) if summary.ended else None

    def _finish(self, summary: RunSummary, scores: RunScores) -> int:
        """Write results.json and the report, print the table, and return the exit status."""
        from carecontact.cli.failed_trials import failed_status, print_failed
        from carecontact.cli.rescoring import publish
        from carecontact.reports.text import clipped_text

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
        from carecontact.cli.vision import with_vision
        from carecontact.protocols import load_protocol
        from carecontact.runs.freeze import check_frozen
        from carecontact.runs.preflight import check_protocol, check_rows

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
    from carecontact.trials.restart import move_aside

    moved = move_aside(out)
    if moved is not None:
        print(f"--restart: the earlier run in {out} is now {moved}")
    return moved is not None
