"""Code and JSON as language models send them: between fences of Markdown, or bare."""

from __future__ import annotations

import re

_FENCE = re.compile(r"```[\w-]*\s*\n(.*?)```", re.DOTALL)


def unfenced(text: str) -> str:
    """What stands between fences, if anything does; otherwise the text as it is."""
    blocks = _FENCE.findall(text)
    return "\n".join(blocks) if blocks else text
