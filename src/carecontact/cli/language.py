"""--language and --record: checked before a run, then carried to every policy's process."""

from __future__ import annotations

import os
from pathlib import Path

from carecontact.cli.groups import LanguageGroup
from carecontact.errors import ConfigError
from carecontact.policies.language import LANGUAGE_VARIABLE, RECORD_VARIABLE


def language_environment(policy: str, options: LanguageGroup) -> dict[str, str]:
    """Return variables for the trials' processes, empty without an option, so that a shell's own are not inherited.

    Raises ConfigError for a policy that takes no such language, a replay file that is none, or a record of nothing;
    DependencyError for ``live:`` without its package.
    """
    language, record = options.language, options.record
    if record is not None and not (language or "").startswith("live:"):
        raise ConfigError("--record: only the answers of --language live:MODEL can be recorded")
    if record is not None:
        _check_record(record)
    if language is None:
        return {LANGUAGE_VARIABLE: "", RECORD_VARIABLE: ""}
    from carecontact.contract.policy_address import remote_address
    from carecontact.policies.language.selection import language_name
    from carecontact.policies.registry import POLICIES

    if remote_address(policy) is not None:
        raise ConfigError(f"--language {language}: a policy on another host is told at its end: carecontact serve")

    if ":" not in policy:
        kinds = POLICIES[policy].languages
        if language.partition(":")[0] not in kinds:
            takes = f"takes {', '.join(kinds)}" if kinds else "uses no language backend that can be chosen"
            raise ConfigError(f"--language {language}: policy {policy} {takes}")
    kind, colon, place = language.partition(":")
    if kind == "replay" and not place:
        raise ConfigError(f"--language {language}: expected a file after it, as in replay:said.jsonl")
    spelled = f"replay:{os.path.abspath(place)}" if kind == "replay" and colon else language
    language_name(spelled)
    return {LANGUAGE_VARIABLE: spelled, RECORD_VARIABLE: os.path.abspath(record) if record else ""}


def _check_record(record: Path) -> None:
    if not os.path.isdir(os.path.dirname(os.path.abspath(record))):
        raise ConfigError(f"--record {record}: there is no folder {record.parent}")
    if os.path.exists(record) and not os.path.isfile(record):
        raise ConfigError(f"--record {record}: expected a new or regular file, got a folder, pipe or device")
