"""What a part of the audit returns, and the fresh processes in which parts run, some of them without any simulator."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import carecontact
from carecontact.errors import CarecontactError

PRIVILEGED = (
    "force", "torque", "wrench", "stiffness", "tissue", "anchor", "shell", "human_joint", "qpos", "seed", "trial",
    "label", "score", "gate", "comfort", "protocol", "task",
)  # fmt: skip
"""No key of a message may contain one of these words, even if the contract's classes allow it. Keys of a dialect that
contain one are on the dialect's exact list (``audit.schema``)."""


CLOSED = (
    "mujoco", "carecontact.human", "carecontact.tissue", "carecontact.world", "carecontact.sim", "carecontact.running",
    "carecontact.scoring",
)  # fmt: skip
"""Packages that stay closed: ``carecontact.sensing`` and the contract are enough to make an observation."""


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
    """Return the modules of CLOSED that are loaded or could be loaded. After ``refuse_simulators``, this function asks
    the hook that was installed: it can find that the hook was forgotten or came too late, but not that the hook itself
    fails. The tests check that with the interpreter's log of imports."""
    loaded = {name for name in sys.modules if _closed(name)}
    return sorted(loaded | {name for name in CLOSED if _importable(name)})


def _closed(name: str) -> bool:
    return any(name == part or name.startswith(f"{part}.") for part in CLOSED)


def _importable(name: str) -> bool:
    try:
        return find_spec(name) is not None
    except ImportError:
        return False


LONGEST_S = 1800.0


def output_of(code: str, logs: Path, *, environment: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Run ``code`` by ``python -c`` in a process that shares nothing; return the JSON object that it prints last."""
    command = [sys.executable, "-P", "-c", code, str(Path(carecontact.__file__).resolve().parents[1]), str(logs)]
    texts: dict[str, Any] = {"capture_output": True, "text": True, "errors": "replace"}
    given = {**os.environ, **(environment or {})}
    try:
        done = subprocess.run(command, env=given, stdin=subprocess.DEVNULL, timeout=LONGEST_S, check=False, **texts)
    except subprocess.TimeoutExpired:
        raise CarecontactError(f"a process of the audit did not end within {LONGEST_S:g} s") from None
    if done.returncode != 0:
        raise CarecontactError(f"a process of the audit ended with status {done.returncode}: {done.stderr[-2000:]}")
    return json.loads(done.stdout.splitlines()[-1])


@dataclass(frozen=True)
class Finding:
    policy: str
    place: str
    """The value that leaks, such as ``observation.cameras.overhead.landmarks`` or ``session.time_limit_s``."""
    detail: str


def findings(policy: str, found: Iterable[tuple[str, str]], *, before: str = "", after: str = "") -> list[Finding]:
    """Return one finding for each pair of a place and what is wrong there, with words before and after the latter."""
    return [Finding(policy, place, f"{before}{what}{after}") for place, what in found]


TIME = "time"
TITLES = {
    "re-derivation": "observations recomputed without a simulator",
    "readings": "time, encoders and images recomputed from the recorded state",
    "frozen frames": "hidden state of the world scrambled while the images stay the same",
    "canary": "same observations until contact in worlds with different hidden values",
    "handshake": "start, handshake and reset of two different trials",
    "schema": "messages of real trials of each policy",
    TIME: "wall time between two acts against contact",
}
"""Name of a part -> its title, in the order of the table. Recordings alone are enough for the last one."""


@dataclass(frozen=True, kw_only=True)
class Part:
    name: str
    counts: dict[str, int]
    """What was examined, and how often. A part that examined nothing has shown nothing, and fails."""
    findings: tuple[Finding, ...]
    notes: tuple[str, ...] = ()
    """What the part measured without judging it."""
    nothing_to_examine: bool = False
    """Whether nothing was there that could have shown a leak. This is no fault, so the part does not fail."""

    @property
    def title(self) -> str:
        return TITLES[self.name]

    @property
    def passed(self) -> bool:
        return not self.findings and bool(self.counts) and all(self.counts.values())

    @property
    def missing(self) -> list[str]:
        return [what for what, count in self.counts.items() if not count]

    def as_json(self) -> dict[str, Any]:
        return {
            "part": self.name, "title": self.title, "passed": self.passed, "counts": self.counts,
            "findings": [{"policy": f.policy, "place": f.place, "told": f.detail} for f in self.findings],
        }  # fmt: skip
