"""The end of a policy's failure as a terminal shows it."""

from __future__ import annotations

TRACE_LINES, PRINTED_LINES = 6, 4
"""Number of last lines of a traceback, and of what the policy printed, that are shown. The report has all lines."""


def excerpt(message: str) -> list[str]:
    """Return the end of the traceback or stack under a failure's first line, and of what the policy printed.

    Empty where the message is one line.
    """
    from carecontact.hosting.conversation import readable
    from carecontact.recording.reason import PRINTED, TRACEBACK

    said, _, printed = readable(message).partition(PRINTED)
    _, _, trace = said.partition("\n")
    lines = _last(trace, TRACE_LINES)
    if len([line for line in lines if line != TRACEBACK]) < 2:
        # Of a traceback that only had frames of ours, the exception alone is left: the reason, which stands above.
        lines = []
    if printed:
        lines += ["it printed last:", *_last(printed, PRINTED_LINES)]
    return [f"  | {line}" for line in lines]


def _last(text: str, most: int) -> list[str]:
    # Neither empty lines nor those in which a traceback only underlines.
    lines = [line for line in text.splitlines() if line.strip(" ~^")]
    return lines if len(lines) <= most else ["...", *lines[-most:]]
