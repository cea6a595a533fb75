"""Makes a process in which no simulator can be imported."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType

CLOSED = ("mujoco", "carecontact.world", "carecontact.sim", "carecontact.trials", "carecontact.scoring")
"""Packages that stay closed: ``carecontact.observation`` and the contract are enough to make an observation."""


class NoSimulator:
    """Install an import hook that refuses to load CLOSED."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None, /
    ) -> ModuleSpec | None:
        if _closed(fullname):
            raise ImportError(f"{fullname} is closed to the re-derivation", name=fullname)
        return None


def refuse_simulators() -> None:
    sys.meta_path.insert(0, NoSimulator())


def within_reach() -> list[str]:
    """Return the modules of CLOSED that are loaded or could be loaded.

    After ``refuse_simulators``, this function asks the hook that was installed: it can find that the hook was forgotten
    or came too late, but not that the hook itself fails. The tests check that with the interpreter's log of imports.
    """
    loaded = {name for name in sys.modules if _closed(name)}
    return sorted(loaded | {name for name in CLOSED if _importable(name)})


def _closed(name: str) -> bool:
    return any(name == part or name.startswith(f"{part}.") for part in CLOSED)


def _importable(name: str) -> bool:
    try:
        return find_spec(name) is not None
    except ImportError:
        return False
