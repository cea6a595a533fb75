"""Messages on a page that has to be the same wherever its run lies."""

from __future__ import annotations

import os
import re
from pathlib import Path

MAX_TEXT = 400
"""Characters of a message that a policy wrote."""


def inside(folder: Path, message: str) -> str:
    """Return the message without the path to the run, so that a run that was moved gives the same page."""
    return message.replace(f"{folder}{os.sep}", "")


def of_file(name: str, message: str) -> str:
    """Return the message without the folder in which the file lay when it was written; results.json keeps such
    messages."""
    return re.sub(rf"^\S*{re.escape(os.sep)}{re.escape(name)}(?=:)", name, message)


def shortened(text: str) -> str:
    return text if len(text) <= MAX_TEXT else f"{text[:MAX_TEXT]} …"
