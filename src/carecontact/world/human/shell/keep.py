"""Keeps shells on disk: computing one takes a tenth of a second, and importing the splines for it half a second."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from carecontact.contract.protocol import Tissue
from carecontact.regions import REGIONS
from carecontact.world.human.body import Body
from carecontact.world.human.pose import NOT_TURNED, ArmTurn
from carecontact.world.human.shell.shell import Shell
from carecontact.world.kept import Arrays, kept, source_sha256

SHAPING = Path(__file__).parents[1]
"""Folder of all modules that shape a person."""


def kept_shell(
    body: Body, region: str, tissue: Tissue, compute: Callable[[], Shell], *, turn: ArmTurn = NOT_TURNED
) -> Shell:
    """Return the shell that ``compute`` gave earlier for the same body, region, tissue, turn of the arm and release; if
    there is none, call it.
    """
    facts = {
        "body": [body.name, body.sha256], "region": [region, repr(REGIONS[region])],
        "tissue": tissue.model_dump(mode="json"), "turn": repr(turn), "source": source_sha256(SHAPING),
        "numpy": np.__version__, "scipy": version("scipy"),
    }  # fmt: skip

    def arrays() -> Arrays:
        shell = compute()
        return {field.name: np.asarray(getattr(shell, field.name)) for field in fields(Shell)}

    found = kept("shells", facts, arrays)
    values: dict[str, Any] = {name: array if array.ndim else float(array) for name, array in found.items()}
    return Shell(**values)
