"""What ``carecontact run`` prints of the trials that failed before their end, and the exit status that they give."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from carecontact.errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from carecontact.recording.schema import EndReason

HARNESS_FAILED, POLICY_CRASHED = 1, 3
"""Exit status."""
TRACE_LINES, PRINTED_LINES = 6, 4
"""Last lines of a traceback and of what the policy printed that a terminal shows; the report has all of them."""


def print_failed(ended: Mapping[str, EndReason], *, out: Path) -> None:
    """Name what failed, with the end of the first crash's traceback and output.

    Args:
        ended: trial -> how it ended.
        out: folder of the run.
    """
    crashed, harness = _of(ended, "process_failure"), _of(ended, "harness_error")
    if crashed:
        print(f"the policy crashed in {len(crashed)} of {len(ended)} trial(s){_log(crashed, out)}")
        for line in _excerpt(out / f"{crashed[0]}.h5"):
            print(f"  | {line}")
        print(f"the whole traceback and output: {out / 'report.html'}")
    if harness:
        print(f"{len(harness)} trial(s) failed in the harness{_log(harness, out)}")
    if crashed or harness:
        print("to run them again: --restart after a change of the policy, --retry-failed if the cause lay outside it")


def failed_status(ended: Mapping[str, EndReason], *, allow_failures: bool) -> int:
    """The harness's failures count first, because they leave trials without a result."""
    if _of(ended, "harness_error"):
        return HARNESS_FAILED
    return POLICY_CRASHED if _of(ended, "process_failure") and not allow_failures else 0


def _of(ended: Mapping[str, EndReason], end: EndReason) -> list[str]:
    return [trial_id for trial_id, how in ended.items() if how == end]


def _log(trials: list[str], out: Path) -> str:
    found = next((log for trial_id in trials if (log := out / f"{trial_id}.log").is_file()), None)
    return f"; see {found}" if found else ""


def _excerpt(recording: Path) -> list[str]:
    from carecontact.hosting.conversation import readable
    from carecontact.recording import read_header
    from carecontact.recording.reason import PRINTED

    try:
        failure = read_header(recording).failure
    except RecordingError as error:
        return [str(error)]
    said, _, printed = readable(failure.message if failure else "no reason recorded").partition(PRINTED)
    lines = [recording.stem + ":", *_last(said, TRACE_LINES)]
    return [*lines, "it printed last:", *_last(printed, PRINTED_LINES)] if printed else lines


def _last(text: str, most: int) -> list[str]:
    lines = [line for line in text.splitlines() if line.strip()]
    return lines if len(lines) <= most else ["...", *lines[-most:]]
