"""``carecontact audit``: can a policy know what it must not?"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from carecontact.cli.policy_name import check_policy, public_name
from carecontact.errors import ConfigError
from carecontact.protocols import adapted, load_protocol
from carecontact.runs.preflight import check_protocol

if TYPE_CHECKING:
    from carecontact.audit.finding import Finding, Part

SHOWN = 8
"""Findings of one part that are printed; all are in the file."""


def audit(*, policies: tuple[str, ...], quick: bool, body: str | None, protocol: str, out: Path) -> int:
    """Exit status 1 if a part found a leak, or could not look. Raises ConfigError for what cannot be audited."""
    if out.exists() and not out.is_dir():
        raise ConfigError(f"--out {out}: this is a file; name a folder")
    twice = sorted({name for name in policies if policies.count(name) > 1})
    if twice:
        raise ConfigError(f"--policy: {', '.join(twice)} is named twice")
    rules = adapted(load_protocol(protocol), body=body)
    check_protocol(rules)
    if rules.vision.segmenter != "mediapipe":
        raise ConfigError(f"--protocol {protocol}: only the segmenter mediapipe can be audited, this one names another")
    from carecontact.policies.registry import POLICIES

    folder = Path.cwd()
    names = tuple(public_name(name) for name in policies) or tuple(POLICIES)
    for name in names:
        check_policy(name, search_path=folder, deadline_s=rules.phases.first_call_deadline_s)
    from carecontact.audit.run import audit as run_audit
    from carecontact.audit.run import write

    # Now, not after minutes of work.
    out.mkdir(parents=True, exist_ok=True)
    print(f"{rules.title}, {rules.person.body}{', quick' if quick else ''}: {', '.join(names)}", flush=True)
    result = run_audit(
        rules, names, quick=quick, search_path=[str(folder)], on_event=lambda said: print(f"  {said}", flush=True)
    )
    width = max(len(part.title) for part in result.parts)
    for part in result.parts:
        print(f"{'pass' if part.passed else 'FAIL'}  {part.name:14} {part.title:{width}}  {_looked_at(part)}")
        for finding in part.findings[:SHOWN]:
            print(f"        {_line(finding)}")
        if len(part.findings) > SHOWN:
            print(f"        and {len(part.findings) - SHOWN} more in audit.json")
        for missing in part.missing:
            print(f"        no {missing}: nothing was shown")
    print(f"{'passed' if result.passed else 'FAILED'}: {write(result, out)}")
    return 0 if result.passed else 1


def _looked_at(part: Part) -> str:
    return ", ".join(f"{count:,} {_one(what) if count == 1 else what}" for what, count in part.counts.items())


def _one(what: str) -> str:
    """``policies`` -> ``policy``, ``observations in contact`` -> ``observation in contact``."""
    first, space, rest = what.partition(" ")
    return (f"{first[:-3]}y" if first.endswith("ies") else first.removesuffix("s")) + space + rest


def _line(finding: Finding) -> str:
    whose = f"{finding.policy}: " if finding.policy else ""
    return f"{whose}{finding.place}: {' '.join(finding.told.split())}"
