"""``carecontact demonstrate``: a run of a demonstrator on persons to train on."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from carecontact.cli.groups import EXAM, EngineGroup, PolicyGroup, RulesGroup, Switch, VerboseGroup
from carecontact.cli.run import Run
from carecontact.errors import ConfigError
from carecontact.interface.policy import VARIANT

ORACLE = "oracle"


@dataclass(frozen=True, kw_only=True)
class TrainingRules(RulesGroup):
    heading: ClassVar = "protocol"
    protocol: str = EXAM
    """Id of a shipped protocol (see `carecontact list protocols`) or a .toml file."""
    level: str | None = "L1"
    """Level of the protocol, where it has any: the exam has L0, L1, L2 and L3."""


@dataclass(frozen=True, kw_only=True)
class Demonstrate:
    """Record demonstrations of persons to train on: a public salt draws them, so that none of them is a person of a
    protocol's seeds. The same command, given again, runs only the trials that are missing. No comparison and no ranked
    table accepts such trials; `carecontact export lerobot` makes a dataset of them."""

    policy: str = ORACLE
    """The demonstrator: a name from `carecontact list policies` or a module:Class, as of `carecontact run`. The oracle
    is privileged, and recordings and datasets say so."""
    given: PolicyGroup = field(default_factory=PolicyGroup)
    out: Path
    """Folder for recordings, results.json and report.html."""
    tasks: str = "all"
    """Tasks to demonstrate: a list (T1,T2), a range (T1-T7), or all."""
    persons: int = 200
    """Number of persons. More persons, given later, keep those that are there."""
    rules: TrainingRules = field(default_factory=TrainingRules)
    noise: str | None = None
    """Disturb every target by noise of this standard deviation, such as 8mm, which the demonstrator corrects. The
    recordings hold both targets, and the dataset's action is the undisturbed one."""
    dagger: Switch = False
    """Let --policy act, and label each of its actions with the target that the oracle would choose from there (DAgger);
    the dataset's action is the label."""
    parallel: EngineGroup = field(default_factory=EngineGroup)
    restart: Switch = False
    """Run every trial again: carecontact moves an earlier run in --out to a folder beside it, and deletes nothing."""
    output: VerboseGroup = field(default_factory=VerboseGroup)

    after_interrupt: ClassVar[str] = "; finished trials are kept; give the same command again to continue"

    def __call__(self) -> int:
        if self.persons < 1:
            raise ConfigError(f"--persons {self.persons}: must be at least 1")
        run = Run(
            policy=self.policy,
            given=self.given,
            out=self.out,
            tasks=self.tasks,
            rules=self.rules,
            parallel=self.parallel,
            restart=self.restart,
            output=self.output,
        )
        return run.execute(self.policy, purpose="run", variant=self._variant(), persons=self.persons)

    def _variant(self) -> str:
        if self.dagger:
            if self.noise is not None or self.policy == ORACLE:
                raise ConfigError("--dagger: give another --policy, whose actions the oracle labels, and no --noise")
            return "dagger"
        if self.noise is None:
            return ""
        if VARIANT.search(f"+noise-{self.noise}") is None or not re.fullmatch(r"\d+mm", self.noise):
            raise ConfigError(f"--noise {self.noise}: expected 1mm to 99mm, for example 8mm")
        return f"noise-{self.noise}"
