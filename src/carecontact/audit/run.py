"""The whole audit: its six parts on every region, and the file that it leaves."""

from __future__ import annotations

import json
import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from carecontact.audit import canary, derivation, frozen, handshake, readings, schema
from carecontact.audit.finding import Part
from carecontact.audit.keyframe import Keyframe
from carecontact.audit.region import RegionAudit, cards_of
from carecontact.audit.watched import Watched
from carecontact.contract.protocol import Protocol
from carecontact.contract.trial import TrialSpec
from carecontact.hosting.setup import PolicySetup
from carecontact.recording.versions import package_versions

SCHEMA = "carecontact-audit-1"
PARTS = (derivation, readings, frozen, canary, handshake, schema)
"""Modules with a NAME and a TITLE, in the order of the table."""


@dataclass(frozen=True, kw_only=True)
class Audit:
    protocol: Protocol
    policies: tuple[str, ...]
    quick: bool
    seed: int
    trials: tuple[Watched, ...]
    """The policies' own trials, without those of the witness."""
    parts: tuple[Part, ...]
    privileged: tuple[str, ...] = ()
    """Policies that were left out because they are given the whole simulation."""

    @property
    def passed(self) -> bool:
        return all(part.passed for part in self.parts)

    def as_json(self) -> dict[str, Any]:
        """Return the content of ``audit.json``. If everything passed, nothing in it depends on place, time or
        machine.
        """
        return {
            "schema": SCHEMA, "passed": self.passed, "quick": self.quick, "policies": list(self.policies),
            "privileged": list(self.privileged), "trials": [trial.as_json() for trial in self.trials],
            "protocol": {
                "id": self.protocol.name, "level": self.protocol.level, "sha256": self.protocol.sha256,
                "body": self.protocol.person.body, "seed": self.seed,
            },
            "versions": package_versions(), "parts": [part.as_json() for part in self.parts],
        }  # fmt: skip


def audit(
    protocol: Protocol,
    policies: Sequence[PolicySetup],
    *,
    quick: bool,
    tasks: Sequence[str] = (),
    seed: int | None = None,
    salt: str = "",
    privileged: Sequence[str] = (),
    on_event: Callable[[str], None] = lambda said: None,
) -> Audit:
    """Run every part on every policy.

    The quick form presses with one card that requests all that the policies request. The full form presses with each
    card, and lets the policies' own trials run to their end.

    Args:
        tasks: each policy runs a trial of each of these tasks, and the audit presses on their regions. By default the
            first task of every region of the protocol, in the quick form only the first of all.
        seed: of the person; by default the protocol's first seed.
        salt: the secret of a salted run, on whose person the audit then runs.
        privileged: names of policies that are left out; the result names them.

    Raises SceneError or SettleError where no world can be made, CarecontactError if the audit itself breaks.
    """
    if seed is None:
        seed = protocol.randomization.seeds[0] if protocol.randomization.seeds else 0
    found: dict[str, list[Part]] = defaultdict(list)
    trials: list[Watched] = []
    with tempfile.TemporaryDirectory(prefix="carecontact-audit-") as folder:
        for number, task_ids in enumerate(_by_region(protocol, tasks, quick=quick)):
            region = RegionAudit(
                spec=TrialSpec(protocol=protocol, task_id=task_ids[0], seed=seed, policy="", salt=salt), number=number,
                keyframe=Keyframe(protocol, task_id=task_ids[0], seed=seed, salt=salt), folder=Path(folder),
                quick=quick, on_event=on_event, add=lambda part: found[part.name].append(part),
            )  # fmt: skip
            with region.logs():
                trials += region.try_policies(policies, task_ids)
                cards = cards_of(trials, together=quick)
                region.press_with(cards)
                region.scramble(cards)
                region.make_again()
    parts = tuple(_merged(part.NAME, part.TITLE, found[part.NAME]) for part in PARTS)
    names = tuple(policy.ref.text for policy in policies)
    return Audit(
        protocol=protocol, policies=names, quick=quick, seed=seed, trials=tuple(trials), parts=parts,
        privileged=tuple(privileged),
    )  # fmt: skip


def write(result: Audit, folder: Path) -> Path:
    """Write ``audit.json`` into the folder and return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "audit.json"
    path.write_text(json.dumps(result.as_json(), indent=2) + "\n")
    return path


def _by_region(protocol: Protocol, tasks: Sequence[str], *, quick: bool) -> list[list[str]]:
    """Return the ids of the tasks to audit, those of one region together."""
    regions: dict[str, list[str]] = defaultdict(list)
    for task in protocol.tasks:
        if task.id in tasks or not (tasks or regions[task.region]):
            regions[task.region].append(task.id)
    named = [task_ids for task_ids in regions.values() if task_ids]
    return named[:1] if quick and not tasks else named


def _merged(name: str, title: str, parts: Sequence[Part]) -> Part:
    """Merge the results of one part over the regions; without any result the part has not passed."""
    counts: Counter[str] = Counter()
    for part in parts:
        counts.update(part.counts)
    findings = tuple(finding for part in parts for finding in part.findings)
    return Part(name=name, title=title, counts=dict(counts) or {"policies that showed a card": 0}, findings=findings)
