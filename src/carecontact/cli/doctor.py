"""``carecontact doctor``: can this machine run trials, and if not, which command installs what is missing."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, ClassVar

from carecontact.cli.groups import FLAT, JsonGroup
from carecontact.errors import counted


@dataclass(frozen=True, kw_only=True)
class Doctor:
    """Check that this machine can run trials. If something is missing, print the command that installs it."""

    output: Annotated[JsonGroup, FLAT] = field(default_factory=JsonGroup)

    after_interrupt: ClassVar[str] = ""

    def __call__(self) -> int:
        """Return 1 if something that a trial needs failed."""
        from carecontact.trials.machine import Finding, findings

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
            from carecontact.cli.answers.doctor import DoctorAnswer
            from carecontact.cli.json_lines import say

            say(DoctorAnswer(fine=not failed, findings=found))
        return 1 if failed else 0
