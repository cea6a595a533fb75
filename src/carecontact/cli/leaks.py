"""``carecontact verify leaks``: checks that no policy receives what it must not know."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import tyro

from carecontact.cli.groups import (
    ArgumentsGroup,
    PolicyGroup,
    RulesGroup,
    SaltGroup,
    Switch,
    check_folder,
    chosen_trial,
    need_recordings,
)
from carecontact.cli.parsing import given_options
from carecontact.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from carecontact.audit.finding import Finding, Part


SHOWN = 8
"""Largest number of findings of one part that are printed. The file has all of them."""


@dataclass(frozen=True, kw_only=True)
class Leaks:
    """Check that the benchmark leaks nothing to a policy: no message may depend on what the policy must not know."""

    policy: tuple[str, ...] = ()
    """Policies to audit: names from `carecontact list policies`, module:Class, or addresses of
    servers; default: every registered one."""
    given: ArgumentsGroup = field(default_factory=ArgumentsGroup)
    quick: Switch = False
    """Audit a single region with short trials. The full audit takes minutes."""
    tasks: str = ""
    """Each policy runs a trial of each of these tasks (list or range), and the audit presses on their regions; default:
    the first task of every region, and with --quick only the first task."""
    seed: int | None = None
    """Seed of the person; default: the protocol's first."""
    run: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Examine nothing but the recordings of this run: does the wall time between two acts tell contact? Only a run with
    --pace fails if it does. A run in which no trial has acts both with and without contact has nothing to examine."""
    rules: RulesGroup = field(default_factory=RulesGroup)
    salted: SaltGroup = field(default_factory=SaltGroup)
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("runs/audit")
    """Folder for audit.json."""

    after_interrupt: ClassVar[str] = "; nothing was written"

    def __call__(self) -> int:
        from carecontact.audit.run import audit, write
        from carecontact.cli.policy import arguments_text, check_policy, policy_setup
        from carecontact.policies.registry import POLICIES, is_privileged
        from carecontact.runs.plan import check_protocol, parse_tasks
        from carecontact.world.draws import body_of

        if self.run is not None:
            return self._audit_time(self.run)
        check_folder(self.out)
        twice = sorted({name for name in self.policy if self.policy.count(name) > 1})
        if twice:
            raise ConfigError(f"--policy: {', '.join(twice)} is named twice; name each policy once")
        if (self.given.policy_arg or self.given.policy_env) and len(self.policy) != 1:
            raise ConfigError("--policy-arg and --policy-env apply to a single policy; name exactly one with --policy")
        rules = self.rules.load()
        check_protocol(rules)
        if rules.vision.segmenter != "mediapipe":
            raise ConfigError(
                f"--protocol {self.rules.protocol}: the audit supports only the segmenter mediapipe, but this protocol "
                f"names {rules.vision.segmenter}"
            )
        given = PolicyGroup(**vars(self.given))
        setups = [policy_setup(name, given) for name in self.policy or POLICIES]
        privileged = [setup.ref.text for setup in setups if is_privileged(setup.ref)]
        if self.policy and privileged:
            raise ConfigError(
                f"--policy {privileged[0]}: this policy is privileged: it is given the whole simulation, as every "
                "recording of it says, so there is nothing to audit"
            )
        setups = [setup for setup in setups if setup.ref.text not in privileged]
        tasks = parse_tasks(self.tasks, protocol=rules) if self.tasks else []
        _, seed = chosen_trial(rules, seed=self.seed)
        for setup in setups:
            check_policy(setup, deadline_s=rules.phases.first_call_deadline_s)
        # Now, not after minutes of work.
        self.out.mkdir(parents=True, exist_ok=True)
        names = ", ".join(f"{setup.ref}{arguments_text(setup)}" for setup in setups)
        body = body_of(rules, seed, self.salted.salt)
        print(f"{rules.title}, seed {seed}, {body}{', quick' if self.quick else ''}: {names}", flush=True)
        for name in privileged:
            print(f"{name}: privileged, so not audited: it is given the whole simulation", flush=True)
        result = audit(
            rules,
            setups,
            privileged=privileged,
            quick=self.quick,
            tasks=tasks,
            seed=seed,
            salt=self.salted.salt,
            on_event=lambda event: print(f"  {event}", flush=True),
        )
        _print(result.parts)
        print(f"{'passed' if result.passed else 'FAILED'}: {write(result, self.out)}")
        return 0 if result.passed else 1

    def _audit_time(self, run: Path) -> int:
        from carecontact.audit.wall_time import audit_time
        from carecontact.recording import read_recording

        if other := [option for option in given_options(self) if option != "--run"]:
            raise ConfigError(f"--run examines only recordings; leave out {', '.join(other)}")
        need_recordings(run)
        part = audit_time(read_recording(path) for path in sorted(run.glob("*.h5")))
        _print([part])
        return 0 if part.passed else 1


def _print(parts: Sequence[Part]) -> None:
    width = max(len(part.title) for part in parts)
    for part in parts:
        verdict = "none" if part.nothing_to_examine else "pass"
        examined = ", ".join(f"{what}: {count:,}" for what, count in part.counts.items())
        print(f"{verdict if part.passed else 'FAIL'}  {part.name:14} {part.title:{width}}  {examined}")
        for note in part.notes:
            print(f"        {note}")
        for finding in part.findings[:SHOWN]:
            print(f"        {_line(finding)}")
        if len(part.findings) > SHOWN:
            print(f"        and {len(part.findings) - SHOWN} more in audit.json")
        for missing in part.missing:
            print(f"        the audit examined no {missing}, so this part fails")


def _line(finding: Finding) -> str:
    whose = f"{finding.policy}: " if finding.policy else ""
    return f"{whose}{finding.place}: {' '.join(finding.detail.split())}"
