"""Keeps shells on disk: computing one takes a tenth of a second, and importing the splines for it half a second."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import fields
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from carecontact.contract.protocol import Tissue
from carecontact.regions import REGIONS
from carecontact.world.human.body import Body
from carecontact.world.human.pose import NOT_TURNED, ArmTurn
from carecontact.world.human.shell.shell import Shell
from carecontact.world.kept import Arrays, kept


def kept_shell(
    body: Body, region: str, tissue: Tissue, compute: Callable[[], Shell], *, turn: ArmTurn = NOT_TURNED
) -> Shell:
    """Return the shell that ``compute`` gave earlier for the same body, region, tissue, turn of the arm and release; if
    there is none, call it.
    """
    facts = {
        "body": [body.name, body.sha256], "region": [region, repr(REGIONS[region])],
        "tissue": tissue.model_dump(mode="json"), "turn": repr(turn), "source": _source_sha256(),
        "numpy": np.__version__, "scipy": version("scipy"),
    }  # fmt: skip

    def arrays() -> Arrays:
        shell = compute()
        return {field.name: np.asarray(getattr(shell, field.name)) for field in fields(Shell)}

    found = kept("shells", facts, arrays)
    values: dict[str, Any] = {name: array if array.ndim else float(array) for name, array in found.items()}
    return Shell(**values)


@cache
def _source_sha256() -> str:
    """Return the hash of the source of all modules that shape a person."""
    folder = Path(__file__).parents[1]
    return hashlib.sha256(b"".join(path.read_bytes() for path in sorted(folder.rglob("*.py")))).hexdigest()
