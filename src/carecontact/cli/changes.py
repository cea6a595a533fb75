"""Lists the differences between two results of the same run, one line each."""

from __future__ import annotations

import json

from carecontact.errors import counted

RESULTS = "results.json"
MOST_LINES = 20


def differences(before: object, after: object) -> list[str]:
    """Return one line for each value that a rescoring changed. The list is empty if there were no earlier results."""
    if before is None:
        return []
    changed = sorted(_changed("", before, after))
    if not changed:
        return [f"nothing differs from the earlier {RESULTS}"]
    shown = [f"  {line}" for line in changed[:MOST_LINES]]
    more = [f"  and {len(changed) - MOST_LINES} more"] if len(changed) > MOST_LINES else []
    return [f"{counted(len(changed), 'value differs', 'values differ')} from the earlier {RESULTS}:", *shown, *more]


def _changed(place: str, before: object, after: object) -> list[str]:
    if isinstance(before, dict) and isinstance(after, dict):
        keys = [*before, *(key for key in after if key not in before)]
        return [line for key in keys for line in _changed(f"{place}.{key}", before.get(key), after.get(key))]
    if isinstance(before, list) and isinstance(after, list):
        named = _by_trial(before), _by_trial(after)
        if named[0] is not None and named[1] is not None:
            return _changed(place, *named)
    return [] if before == after else [f"{place.lstrip('.')}: {_short(before)} -> {_short(after)}"]


def _by_trial(rows: list) -> dict | None:
    """Return the rows by trial, so that one more trial does not make every later one look changed."""
    if rows and all(isinstance(row, dict) and "trial_id" in row for row in rows):
        return {row["trial_id"]: row for row in rows}
    return None


def _short(value: object) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
