"""Part (a) tests whether every byte sent to a policy is a function of images, calibration and encoders."""

from __future__ import annotations

from pathlib import Path

from carecontact.audit.finding import Finding, Part
from carecontact.audit.fresh_process import said_by
from carecontact.audit.rederive import BOOTSTRAP
from carecontact.audit.watched import Watched

NAME, TITLE = "re-derivation", "observations recomputed without a simulator"


def audit_derivation(logs: Path, pressed: list[Watched]) -> Part:
    """Derive every logged message again and compare it with the one that was sent.

    ``logs``: folder of raw logs of trials. ``pressed``: the trials among them in which contact must occur.

    Raises CarecontactError if the process that derives the messages breaks.
    """
    said = said_by(BOOTSTRAP, logs)
    findings = [
        Finding(policy=look["policy"], place=place, told=f"at {look['time_s']:.3f} s of {look['trial']}: {told}")
        for look in said["looks"]
        for place, told in look["differences"]
    ]
    if said["simulators"]:
        told = f"the process that recomputes observations could import a simulator: {', '.join(said['simulators'])}"
        findings.append(Finding(policy="", place="re-derivation", told=told))
    return Part(
        name=NAME, title=TITLE,
        counts={
            "observations": len(said["looks"]),
            "observations in contact": sum(trial.looks_in_contact for trial in pressed),
            "bytes": sum(look["bytes"] for look in said["looks"]),
        },
        findings=tuple(findings),
    )  # fmt: skip
