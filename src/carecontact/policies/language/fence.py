"""Code and JSON as language models send them: between fences of Markdown, or bare."""

from __future__ import annotations

import re

_FENCE = re.compile(r"```[\w-]*[ \t\r]*\n(.*?)```", re.DOTALL)
_FENCED_OBJECT = re.compile(r"```[\w-]*\s*(\{.*\})\s*```", re.DOTALL)


def unfenced(text: str) -> str:
    """Return what stands between fences, if anything does; otherwise the text as it is."""
    blocks = _FENCE.findall(text)
    return "\n".join(blocks) if blocks else text


def json_of(text: str) -> str:
    """Return the JSON object that stands between fences, if one does; otherwise the text as it is."""
    found = _FENCED_OBJECT.search(text)
    return found[1] if found else text
