"""The script of the page: it sorts and filters the table of trials, which is whole without it."""

from __future__ import annotations

import base64
import hashlib
from functools import cache
from importlib.resources import files


@cache
def table_script() -> str:
    return (files("carecontact.reports.page") / "templates" / "trials.js").read_text(encoding="utf-8")


def script_source() -> str:
    """Return what the page's Content-Security-Policy allows: this script and no other."""
    digest = hashlib.sha256(table_script().encode()).digest()
    return f"'sha256-{base64.b64encode(digest).decode()}'"
