"""The text about a policy's exception that the harness receives."""

from __future__ import annotations

import traceback

from carecontact.hosting.stack import is_plumbing

TRACEBACK_CHARS = 2000
"""Most characters of a traceback or message: the whole of it might contain the policy's whole input."""


def told(error: BaseException) -> str:
    """Return the traceback of an exception in at most TRACEBACK_CHARS, without the harness's own frames.

    Where it has to be cut, the end of the stack and the beginning of the exception's message are kept.
    """
    found = traceback.TracebackException.from_exception(error)
    _hide_plumbing(found)
    whole = "".join(found.format())
    if len(whole) <= TRACEBACK_CHARS:
        return whole
    said = "".join(found.format_exception_only())
    stack, half = whole.removesuffix(said), TRACEBACK_CHARS // 2
    if len(said) > half:
        said = f"{said[: half - 6]} [...]"
    return stack[-(TRACEBACK_CHARS - len(said)) :] + said


def _hide_plumbing(found: traceback.TracebackException) -> None:
    found.stack[:] = [frame for frame in found.stack if not is_plumbing(frame.filename)]
    for earlier in (found.__cause__, found.__context__, *(found.exceptions or ())):
        if earlier is not None:
            _hide_plumbing(earlier)
