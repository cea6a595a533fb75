"""--language and --record: the arguments ``language`` and ``record`` of a policy, checked before a run."""

from __future__ import annotations

import fcntl
import os
import tempfile
from pathlib import Path

from carecontact.cli.groups import PolicyGroup
from carecontact.contract.policy_ref import PolicyRef
from carecontact.errors import ConfigError
from carecontact.policies.language.selection import language_name
from carecontact.policies.registry import POLICIES

SPELLED = {"rules-v1": "rules-v1", "replay": "replay:FILE.jsonl", "live": "live:MODEL"}
"""Kind of language backend -> how a command line names one."""


def chosen_language(ref: PolicyRef, options: PolicyGroup, arguments: dict[str, str]) -> tuple[str | None, str | None]:
    """Return ``language`` and ``record`` for the policy, with paths that hold in every folder, or None.

    A registered policy with language backends may be given both as --policy-arg too, which takes them out of
    ``arguments``.

    Raises UnknownNameError; ConfigError for a policy that takes no such language, a file that is not a replay file, or
    a record without a live model; DependencyError for ``live:`` without its package.
    """
    kinds = POLICIES[ref.text].languages if ref.kind == "registered" else ()
    language, record = options.language, options.record
    if kinds:
        language = _one("language", language, arguments.pop("language", None))
        place = _one("record", None if record is None else str(record), arguments.pop("record", None))
        record = None if place is None else Path(place)
    if record is not None:
        if not (language or "").startswith("live:"):
            raise ConfigError("--record needs --language live:MODEL")
        _check_record(record)
    if language is None:
        return None, None
    kind, colon, place = language.partition(":")
    if ref.kind == "registered" and kind not in kinds:
        takes = (
            f"takes {' or '.join(SPELLED[kind] for kind in kinds)}" if kinds else "has no language backend to choose"
        )
        raise ConfigError(f"--language {language}: policy {ref} {takes}")
    if kind == "replay" and not place:
        raise ConfigError(f"--language {language}: expected a file after it, as in replay:said.jsonl")
    spelled = f"replay:{os.path.abspath(place)}" if kind == "replay" and colon else language
    language_name(spelled)
    return spelled, None if record is None else os.path.abspath(record)


def _one(name: str, option: str | None, argument: str | None) -> str | None:
    if option is not None and argument is not None:
        raise ConfigError(f"--{name} and --policy-arg {name}= mean the same; give only one of them")
    return argument if option is None else option


def _check_record(record: Path) -> None:
    if not os.path.isdir(os.path.dirname(os.path.abspath(record))):
        raise ConfigError(f"--record {record}: the folder {record.parent} does not exist")
    if os.path.exists(record) and not os.path.isfile(record):
        raise ConfigError(f"--record {record}: expected a new or regular file, got a folder, pipe or device")
    try:
        # Trials append to it at the same time.
        with tempfile.TemporaryFile(dir=os.path.dirname(os.path.abspath(record))) as beside:
            fcntl.flock(beside, fcntl.LOCK_EX)
    except OSError as error:
        raise ConfigError(
            f"--record {record}: no file in its folder can be written and locked ({error.strerror}); name a file on "
            "another mount"
        ) from None
