"""How the page names the protocol of its run."""

from __future__ import annotations

from carecontact.protocols.frozen_state import frozen_state
from carecontact.reports.page.section import Page


def protocol_of(page: Page) -> str | None:
    """Return the title, and whether the protocol differs from what was frozen under its id; None without trials."""
    if not page.scores:
        return None
    title = page.scores[0].protocol_title
    changed = any(frozen_state(header.spec.protocol).startswith("not the frozen") for header in page.headers.values())
    return f"{title} (not the frozen protocol)" if changed else title
