"""A wall against accidents: a policy in this process cannot import the world that it is judged in."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

OPEN = (
    "carecontact.errors",
    "carecontact.exhausted",
    "carecontact.own_process",
    "carecontact.registry",
    "carecontact.regions",
    "carecontact.sight",
    "carecontact.contract",
    "carecontact.policies",
    "carecontact.hosting",
)
"""The modules of carecontact that a policy may import; a new module is closed until it is named here."""


def _closed(name: str) -> bool:
    top = name.partition(".")[0]
    if top == "carecontact":
        return name != top and not any(name == part or name.startswith(f"{part}.") for part in OPEN)
    return top == "mujoco"


class ImportWall(MetaPathFinder):
    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None, /
    ) -> ModuleSpec | None:
        """Raise ImportError for mujoco and for every part of carecontact that is not in OPEN; leave the rest to other
        finders.
        """
        if _closed(fullname):
            raise ImportError(
                f"{fullname} is closed to policies: a policy sees only its observations, never the simulation or the "
                f"scorer; it may import {', '.join(OPEN)} and packages other than mujoco",
                name=fullname,
            )
        return None


def raise_wall() -> None:
    """Install the wall. Raises RuntimeError if a closed module is already loaded, because the wall could not close
    it.
    """
    wall = ImportWall()
    for name in list(sys.modules):
        try:
            wall.find_spec(name, None)
        except ImportError as error:
            raise RuntimeError(f"loaded before the import restrictions were in place: {error}") from None
    sys.meta_path.insert(0, wall)
