"""Part (a): is every byte that a policy was sent a function of images, calibration and encoders?"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import carecontact
from carecontact.audit.finding import Finding, Part
from carecontact.audit.rederive import BOOTSTRAP
from carecontact.audit.watched import Watched
from carecontact.errors import CarecontactError

NAME, TITLE = "re-derivation", "made again without a simulator"
LONGEST_S = 1800.0


def audit_derivation(logs: Path, pressed: list[Watched]) -> Part:
    """``logs``: folder of raw logs of trials. ``pressed``: those of them in which contact is to be seen.

    Raises CarecontactError if the re-deriving process itself breaks.
    """
    root = str(Path(carecontact.__file__).resolve().parents[1])
    done = subprocess.run(
        [sys.executable, "-P", "-c", BOOTSTRAP, root, str(logs)],
        stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace", timeout=LONGEST_S, check=False,
    )  # fmt: skip
    if done.returncode != 0:
        raise CarecontactError(f"the re-deriving process ended with status {done.returncode}: {done.stderr[-2000:]}")
    said = json.loads(done.stdout.splitlines()[-1])
    findings = [
        Finding(policy=look["policy"], place=place, told=f"at {look['time_s']:.3f} s of {look['trial']}: {told}")
        for look in said["looks"]
        for place, told in look["differences"]
    ]
    if said["simulators"]:
        told = f"a simulator was within reach: {', '.join(said['simulators'])}"
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
