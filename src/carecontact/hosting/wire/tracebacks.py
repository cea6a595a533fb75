"""An exception of a policy as the harness is told it."""

from __future__ import annotations

import traceback

from carecontact.hosting.stack import is_plumbing

TRACEBACK_CHARS = 2000
"""Of a traceback or message; all of it could be the policy's whole input."""


def told(error: BaseException) -> str:
    """Its traceback in TRACEBACK_CHARS, without the frames that call every policy.

    Of the stack the end says most, of what the exception says the beginning.
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
