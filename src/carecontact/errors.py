"""Every exception carecontact raises on purpose.

CarecontactError
├── ConfigError              a protocol, option or file that the user gave is wrong
│   └── UnknownNameError     a name that no registry row has
├── DependencyError          a package or library is missing or refuses to work; says what helps
├── AssetError               a shipped body or mesh is missing or does not match its hash
├── SceneError               the world could not be built
│   └── SettleError          the person did not come to rest before t = 0 (harness, not policy)
├── ContractError            a message does not fit the observation / action contract
│   ├── ObservationError
│   └── ActionError
├── LanguageError            a language backend is out of reach, refuses, or answers outside its schema
├── ProgramError             a program that a language model wrote was stopped or is wrong
├── PolicyError              the policy process died, hung or answered wrongly: its process failure
│   ├── UnreachableError     no server takes a connection at the policy's address: says nothing about the policy
│   └── LostError            the connection to the policy ended, and its server did not say why
├── RecordingError           a trial file is corrupt, truncated or foreign
├── StorageError             there is no space for a file: says nothing about a trial
└── ExhaustedError           no process, thread or memory is left: says nothing about a policy
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable

SHORTEST_PART = 2
"""Characters of a name that may be meant for a longer one that contains it."""


def did_you_mean(name: str, valid: Iterable[str]) -> str:
    """`` (did you mean 'hover'?)`` where a valid name is close to this one or is the only one that contains it, else
    nothing."""
    by_case = {word.casefold(): word for word in valid}
    close = difflib.get_close_matches(name.casefold(), by_case, n=1)
    if not close and len(name) >= SHORTEST_PART:
        longer = [word for word in by_case if name.casefold() in word]
        close = longer if len(longer) == 1 else []
    return f" (did you mean {by_case[close[0]]!r}?)" if close else ""


def counted(n: int, one: str, more: str = "") -> str:
    """``1 trial``, ``2 trials``; ``more`` is the plural where it is not ``one`` with an s: ``2 trials are``."""
    return f"{n} {one if n == 1 else more or f'{one}s'}"


class CarecontactError(Exception):
    """Base of all; its message is meant to be read by a user without a traceback."""


class ConfigError(CarecontactError):
    pass


class UnknownNameError(ConfigError, KeyError):
    """A name that is not registered; lists the registered ones. Also a KeyError, as ``get`` of a mapping expects."""

    __str__ = Exception.__str__  # KeyError would show the message in quotes

    def __init__(self, kind: str, name: str, valid: Iterable[str]) -> None:
        self.kind, self.name, self.valid = kind, name, sorted(valid)
        meant = did_you_mean(name, self.valid)
        super().__init__(f"no {kind} named {name!r}{meant}; valid: {', '.join(self.valid) or '(none)'}")


class DependencyError(CarecontactError):
    pass


class AssetError(CarecontactError):
    pass


class SceneError(CarecontactError):
    pass


class SettleError(SceneError):
    pass


class ContractError(CarecontactError):
    pass


class ObservationError(ContractError):
    pass


class ActionError(ContractError):
    pass


class LanguageError(CarecontactError):
    """Inside a policy it is that policy's process failure."""

    def __init__(self, message: str, *, endpoint: str | None = None) -> None:
        """``endpoint``: host that was asked and gave no completion."""
        self.endpoint = endpoint
        super().__init__(message)


class ProgramError(CarecontactError):
    """Inside a policy it is that policy's process failure."""


class PolicyError(CarecontactError):
    """A policy process failed; ``kind`` is one of KINDS and goes into the recording as evidence."""

    REPORTED = ("exception", "action", "language", "program", "handshake")
    """Kinds that the policy's own process may report. The benchmark detects all other kinds itself."""
    KINDS = ("start", "argument", "died", "killed", "timeout", "garbage", "oversize", *REPORTED)

    def __init__(self, kind: str, message: str, *, notes: dict[str, object] | None = None) -> None:
        """``notes``: what the policy wanted to be kept of the step that failed."""
        if kind not in self.KINDS:
            raise ValueError(f"unknown policy failure kind {kind!r}; valid: {', '.join(self.KINDS)}")
        self.kind, self.notes = kind, notes or {}
        super().__init__(message)


class UnreachableError(PolicyError):
    """Of kind ``start`` or ``timeout``."""


class LostError(PolicyError):
    """Of kind ``died``. Before the first action, the server may just be restarting."""


class RecordingError(CarecontactError):
    pass


class StorageError(CarecontactError):
    pass


class ExhaustedError(CarecontactError):
    """The machine, or the limit of this user, leaves no process, thread or memory for the harness's own work."""
