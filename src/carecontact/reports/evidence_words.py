"""The evidence that is kept with a score, as pages word it: kept scores never change, so that the words do here."""

from __future__ import annotations

import re

from carecontact.scoring.result import TrialScore

OFF_SURFACE = re.compile(r"came to (\S+ mm) above the surface of")
"""The distance is to the nearest point of the region's surface, which may lie to the side."""
SHARE_OF = re.compile(r"\b(\d+)% of (\d+)%")
SEGMENT = re.compile(r"\b(?:left|right)(?:_[a-z]+)+\b")


def evidence_text(score: TrialScore) -> str:
    """Return the evidence for a cause; empty without one. What it quotes from the policy, in quotation marks, stays."""
    parts = (score.evidence or "").split('"')
    return '"'.join(_worded(part) if i % 2 == 0 else part for i, part in enumerate(parts))


def off_surface(score: TrialScore) -> bool:
    """Whether the commanded path came near the region and never onto its surface."""
    evidence = score.evidence or ""
    return bool(OFF_SURFACE.search(evidence)) or " off its surface" in evidence


def spaced(text: str) -> str:
    """Percent signs behind a no-break space."""
    return re.sub(r"(?<=\d) ?%", "\N{NO-BREAK SPACE}%", text)


def _worded(text: str) -> str:
    text = OFF_SURFACE.sub(r"came to within \1 of the surface of", text)
    text = SHARE_OF.sub(r"\1% of the time, \2% needed", text)
    return spaced(SEGMENT.sub(lambda found: found[0].replace("_", " "), text))
