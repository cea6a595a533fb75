"""Before a run: ``check`` tries a policy on one observation, ``look`` draws what it sees, ``doctor`` says whether this
machine can run trials."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import tyro

from carecontact.cli.groups import FLAT, JsonGroup, PolicyGroup, RulesGroup, SaltGroup, Switch, VisionGroup
from carecontact.errors import counted

if TYPE_CHECKING:
    from carecontact.running.trial import CheckFinding


# ``carecontact check``: try a policy on one observation before a run.


@dataclass(frozen=True, kw_only=True)
class Check:
    """Try a policy on one real observation: start, card, answer, limits and latency. No trial is recorded.

    For a policy's server, or with --deep, it also prints what the server says of itself, what it is sent and what each
    column of its answer holds, writes the pictures that it is sent into a file, and asks again with each input blanked,
    to name those that have no effect."""

    policy: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="POLICY")]
    """One of: a name from `carecontact list policies`; a module:Class that can be imported from the current folder; or
    ws://HOST:PORT, the address of a policy's server (see docs/wire.md; docs/dialects.md for other projects'
    servers)."""
    given: Annotated[PolicyGroup, FLAT] = field(default_factory=PolicyGroup)
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
    rules: Annotated[RulesGroup, FLAT] = field(default_factory=RulesGroup)
    vision: Annotated[VisionGroup, FLAT] = field(default_factory=VisionGroup)

    after_interrupt: ClassVar[str] = "; the policy ends, too"

    def __call__(self) -> int:
        """Return 1 if a run cannot work. Raises ConfigError for what does not exist."""
        from carecontact.cli.groups import check_trial
        from carecontact.cli.policy import policy_setup, suggestion, with_vision
        from carecontact.errors import ConfigError
        from carecontact.protocol.load import load_protocol
        from carecontact.running.check_answers import check_sheet_path
        from carecontact.running.machine import check_ready
        from carecontact.runs.identity import check_frozen
        from carecontact.runs.plan import check_protocol, plan_trials

        setup = policy_setup(self.policy, self.given)
        # The world of another release cannot be trusted to be built, let alone to be that of a run.
        loaded = load_protocol(self.rules.protocol, level=self.rules.level)
        check_frozen(self.rules.protocol, loaded, unfrozen=False)
        rules = with_vision(self.rules.load(), self.vision)
        check_protocol(rules)
        task = self.task or rules.tasks[0].id
        seed = rules.randomization.seeds[0] if self.seed is None else self.seed
        check_trial(rules, task=task, seed=seed)
        if self.deep and self.quick:
            raise ConfigError("--deep and --quick exclude each other; give one of them")
        deep = self.deep or (setup.ref.kind == "remote" and not self.quick)
        pictures = check_sheet_path(self.pictures) if deep else None
        check_ready()
        from carecontact.running.check import Check as Checked  # Not before, since MuJoCo comes with it.

        (spec, *_) = plan_trials(
            protocol=rules, policy=setup.ref.text, tasks=[task], seeds=[seed], arguments=setup.arguments,
            environment=setup.environment,
        )  # fmt: skip
        often = "again and again, with one input blanked in turn" if deep else "twice"
        print(f"{setup.ref}: the first observation of {spec.trial_id}, {rules.title}, {often}", flush=True)
        check = Checked(spec=spec, policy=setup, weights=self.vision.weights, pictures=pictures, on_finding=_show)
        works = check.run()
        if not works:
            print(f"a run would fail in every trial{suggestion(self.policy, Path.cwd())}")
        elif check.warnings:
            print(f"a run can start, but look at the {counted(check.warnings, 'warning')} first")
        else:
            print("a run can work")
        return 0 if works else 1


def _show(finding: CheckFinding) -> None:
    first, *more = finding.text.splitlines()
    print(f"{finding.level:8} {finding.topic:12} {first}", flush=True)
    for line in more:
        print(f"{'':22}{line}", flush=True)


# ``carecontact look``: a picture sheet of what a policy sees when a trial begins.

if TYPE_CHECKING:
    pass


@dataclass(frozen=True, kw_only=True)
class Look:
    """Draw on one sheet everything that a policy can receive when a trial begins: every camera and every modality."""

    task: str
    """Task of the protocol, such as T1."""
    seed: int = 0
    """Seed of the protocol."""
    rules: Annotated[RulesGroup, FLAT] = field(default_factory=RulesGroup)
    tool: str | None = None
    """What the robot's hand wears in place of the protocol's: rigid `caps` over the fingertips, or a soft wash `mitt`.
    The sheet names this change."""
    vision: Annotated[VisionGroup, FLAT] = field(default_factory=VisionGroup)
    salted: Annotated[SaltGroup, FLAT] = field(default_factory=SaltGroup)
    out: Path | None = None
    """Picture to write, .png, .jpg or .pdf; default: look-TASK-sSEED.png in the current folder."""

    after_interrupt: ClassVar[str] = "; nothing was written"

    def __call__(self) -> int:
        """Raises ConfigError for a task or seed that the protocol does not have."""
        from carecontact.cli.groups import check_trial
        from carecontact.cli.policy import with_vision
        from carecontact.interface.observation import MODALITIES
        from carecontact.interface.policy import CAMERAS, PolicyCard
        from carecontact.protocol.load import load_protocol
        from carecontact.report.look_sheet import check_sheet_path, save_sheet
        from carecontact.running.machine import check_ready
        from carecontact.runs.plan import check_protocol

        loaded = load_protocol(self.rules.protocol, level=self.rules.level)
        rules = self.rules.changed(loaded, tool={} if self.tool is None else {"scene.tool": self.tool})
        rules = with_vision(rules, self.vision)
        check_trial(rules, task=self.task, seed=self.seed)
        trial = f"{self.task}-s{self.seed:03d}"
        path = check_sheet_path(self.out or Path(f"look-{trial}.png"))
        check_protocol(rules)
        check_ready()
        from carecontact.episode.episode import first_look  # Not before, since MuJoCo comes with it.

        card = PolicyCard(name="look", modalities=MODALITIES, cameras=CAMERAS)
        observation = first_look(
            rules, task_id=self.task, seed=self.seed, card=card, weights=self.vision.weights, salt=self.salted.salt
        )
        name = rules.task(self.task).name
        title = f"{self.task} {name}, seed {self.seed}, {rules.title} (the policy does not receive this line)"
        save_sheet(observation, path, title=title)
        print(f"{path}: {self.task} seed {self.seed}, {len(CAMERAS)} cameras")
        return 0


# ``carecontact doctor``: can this machine run trials, and if not, which command installs what is missing.


@dataclass(frozen=True, kw_only=True)
class Doctor:
    """Check that this machine can run trials. If something is missing, print the command that installs it."""

    output: Annotated[JsonGroup, FLAT] = field(default_factory=JsonGroup)

    after_interrupt: ClassVar[str] = ""

    def __call__(self) -> int:
        """Return 1 if something that a trial needs failed."""
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
            from carecontact.cli.console import print_answer

            print_answer(DoctorAnswer(fine=not failed, findings=found))
        return 1 if failed else 0
