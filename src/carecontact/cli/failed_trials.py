"""What ``carecontact run`` prints of the trials that failed before their end, and the exit status that they give."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from carecontact.cli.excerpt import excerpt
from carecontact.errors import RecordingError, counted

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from carecontact.recording.schema import EndReason, Failure

HARNESS_FAILED, POLICY_CRASHED = 1, 3
"""Exit status if the harness failed in a trial, and if only policies crashed."""
SHOWN, LOGS = 3, 3
"""Number of different failures that are printed with their tracebacks, and number of logs named for each."""


def print_failed(ended: Mapping[str, EndReason], *, out: Path) -> None:
    """Name what failed and where its logs are; of crashes also the end of the traceback and output.

    Args:
        ended: trial -> how it ended.
        out: folder of the run.
    """
    crashed, harness = _of(ended, "process_failure"), _of(ended, "harness_error")
    if crashed:
        share = f"{len(crashed)} of {counted(len(ended), 'trial')}"
        print(f"the policy crashed in {share}; logs and report.html are in {out}")
        _print_groups(crashed, out, whole=True)
    if harness:
        print(f"{counted(len(harness), 'trial')} failed in the harness; logs are in {out}")
        _print_groups(harness, out, whole=False)
        print("the same command runs them again")
    if crashed:
        print("to run crashed trials again: --restart after a change of the policy, --retry-failed if the cause lay "
              "outside it")  # fmt: skip


def failed_status(ended: Mapping[str, EndReason], *, allow_failures: bool) -> int:
    """Return the exit status. Failures of the harness take precedence, because they leave trials without a result."""
    if _of(ended, "harness_error"):
        return HARNESS_FAILED
    return POLICY_CRASHED if _of(ended, "process_failure") and not allow_failures else 0


def _of(ended: Mapping[str, EndReason], end: EndReason) -> list[str]:
    return [trial_id for trial_id, how in ended.items() if how == end]


def _print_groups(trials: Sequence[str], out: Path, *, whole: bool) -> None:
    """Print equal failures together.

    Args:
        whole: whether to print more of a failure than its reason.
    """
    from carecontact.recording.reason import alike, reason_of
    from carecontact.recording.remedies import remedies

    groups: dict[str, list[tuple[str, Failure]]] = {}
    for trial_id in sorted(trials):
        failure = _failure(out / f"{trial_id}.h5")
        groups.setdefault(alike(reason_of(failure)), []).append((trial_id, failure))
    for number, group in enumerate(sorted(groups.values(), key=len, reverse=True)):
        first = group[0][1]
        logs = _logs([trial_id for trial_id, _ in group], out)
        print(f"{counted(len(group), 'trial')}: {reason_of(first)}; see {logs}")
        for line in excerpt(first.message) if whole and number < SHOWN else ():
            print(line)
        for remedy in remedies(first.message) if whole else ():
            print(f"  hint: {remedy}")


def _logs(trials: Sequence[str], out: Path) -> str:
    more = len(trials) - LOGS
    names = ", ".join(str(out / f"{trial_id}.log") for trial_id in trials[:LOGS])
    return names + (f" and {more} more" if more > 0 else "")


def _failure(recording: Path) -> Failure:
    from carecontact.recording import read_header
    from carecontact.recording.schema import Failure

    try:
        found = read_header(recording).failure
    except RecordingError as error:
        return Failure(kind="unread", message=str(error))
    return found or Failure(kind="unknown", message="no reason recorded")
