"""Runs parts of the audit in a fresh process, which shares neither memory nor patches with the audited one."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import carecontact
from carecontact.errors import CarecontactError

LONGEST_S = 1800.0


def said_by(code: str, logs: Path, *, environment: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Run ``code`` by ``python -c`` with two arguments, the folder of the package and ``logs``; return the JSON object
    that it prints last.

    Raises CarecontactError if the process fails or takes longer than LONGEST_S.
    """
    root = str(Path(carecontact.__file__).resolve().parents[1])
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-c", code, root, str(logs)], env={**os.environ, **(environment or {})},
            stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace", timeout=LONGEST_S, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise CarecontactError(f"a process of the audit did not end within {LONGEST_S:g} s") from None
    if done.returncode != 0:
        raise CarecontactError(f"a process of the audit ended with status {done.returncode}: {done.stderr[-2000:]}")
    return json.loads(done.stdout.splitlines()[-1])
