"""Before a run: ``check`` tries a policy on one observation, ``doctor`` says whether this machine can run trials."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import tyro

from carecontact.cli.console import print_answer
from carecontact.cli.groups import JsonGroup, PolicyGroup, RulesGroup, Switch, VisionGroup, chosen_trial
from carecontact.errors import ConfigError, counted

if TYPE_CHECKING:
    from carecontact.running.check_answers import CheckFinding


@dataclass(frozen=True, kw_only=True)
class Check:
    """Try a policy on one real observation: start, card, answer, limits and latency. No trial is recorded.

    For a policy's server, or with --deep, it also prints what the server says of itself, what it is sent and what each
    column of its answer holds, writes the pictures that it is sent into a file, and asks again with each input blanked,
    to name those that have no effect."""

    policy: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="POLICY")]
    """One of: a name from `carecontact list policies`; a module:Class that can be imported from the current folder; or
    ws://HOST:PORT, the address of a policy's server (see docs/your-policy.md; docs/vla.md for other projects'
    servers)."""
    given: PolicyGroup = field(default_factory=PolicyGroup)
    task: str | None = None
    """Task whose instruction and first observation the policy is given; default: the protocol's first."""
    seed: int | None = None
    """Seed of the protocol; default: its first."""
    deep: Switch = False
    """Check a policy that starts here as deeply as a policy's server."""
    quick: Switch = False
    """Check a policy's server no deeper than a policy that starts here."""
    pictures: Path = Path("check-pictures.png")
    """PNG file for the pictures that are sent, of the deep check."""
    rules: RulesGroup = field(default_factory=RulesGroup)
    vision: VisionGroup = field(default_factory=VisionGroup)

    after_interrupt: ClassVar[str] = "; the policy ends, too"

    def __call__(self) -> int:
        from carecontact.cli.policy import policy_setup, suggestion, with_vision
        from carecontact.protocol.load import load_protocol
        from carecontact.running.check_messages import check_sheet_path
        from carecontact.running.machine import check_ready
        from carecontact.runs.identity import check_frozen
        from carecontact.runs.plan import check_protocol, plan_trials

        setup = policy_setup(self.policy, self.given)
        # The world of another release cannot be trusted to be built, let alone to be that of a run.
        loaded = load_protocol(self.rules.protocol, level=self.rules.level)
        check_frozen(self.rules.protocol, loaded, unfrozen=False)
        rules = with_vision(self.rules.load(), self.vision)
        check_protocol(rules)
        task, seed = chosen_trial(rules, task=self.task, seed=self.seed)
        if self.deep and self.quick:
            raise ConfigError("--deep and --quick exclude each other; give one of them")
        deep = self.deep or (setup.ref.kind == "remote" and not self.quick)
        pictures = check_sheet_path(self.pictures) if deep else None
        check_ready()
        from carecontact.running.check import Check as Checked  # Not before, since MuJoCo comes with it.

        given = {"arguments": setup.arguments, "environment": setup.environment}
        (spec, *_) = plan_trials(protocol=rules, policy=setup.ref.text, tasks=[task], seeds=[seed], **given)
        often = "again and again, with one input blanked in turn" if deep else "twice"
        print(f"{setup.ref}: the first observation of {spec.trial_id}, {rules.title}, {often}", flush=True)
        check = Checked(spec=spec, policy=setup, weights=self.vision.weights, pictures=pictures, on_finding=_show)
        works = check.run()
        if not works:
            print(f"a run would fail in every trial{suggestion(self.policy, Path.cwd())}")
        elif check.warnings:
            print(f"a run can start, but look at the {counted(check.warnings, 'warning')} first")
        else:
            print("a run can work" if deep else "a run can work; --deep also tests what each input and each axis does")
        return 0 if works else 1


def _show(finding: CheckFinding) -> None:
    first, *more = finding.text.splitlines()
    print(f"{finding.level:8} {finding.topic:12} {first}", flush=True)
    for line in more:
        print(f"{'':22}{line}", flush=True)


@dataclass(frozen=True, kw_only=True)
class Doctor:
    """Check that this machine can run trials. If something is missing, print the command that installs it."""

    output: JsonGroup = field(default_factory=JsonGroup)

    def __call__(self) -> int:
        from carecontact.running.machine import Finding, findings

        failed = 0
        found: list[Finding] = []
        for finding in findings():
            found.append(finding)
            failed += not finding.fine
            state = "FAIL" if not finding.fine else "warn" if finding.warning else "ok  "
            print(f"{state} {finding.name:10} {finding.detail}", flush=True)
            if finding.fix:
                print(f"     install it with: {finding.fix}", flush=True)
        print("this machine can run trials" if not failed else f"{counted(failed, 'thing')} to fix", flush=True)
        if self.output.json:
            from carecontact.cli.answers import DoctorAnswer

            print_answer(DoctorAnswer(fine=not failed, findings=found))
        return 1 if failed else 0
