"""Which language backend a run uses: named on the command line, carried to the policy's process by its environment."""

from __future__ import annotations

import os
from pathlib import Path

from carecontact.errors import ConfigError
from carecontact.policies.language import LANGUAGE_VARIABLE, RECORD_VARIABLE
from carecontact.policies.language.completion import MODEL_NAME, MODEL_NAME_WANTED
from carecontact.policies.language.live import Live
from carecontact.policies.language.replay import Replay
from carecontact.policies.language.rules import Rules
from carecontact.policies.language.transcript import Transcript

SPELLINGS = "rules-v1, replay:FILE.jsonl or live:MODEL"


def language_name(spelled: str) -> str:
    """What a result calls the backend that ``spelled`` names; opens a replay file, connects to nothing.

    Raises ConfigError for another spelling or a replay file that is none, DependencyError for live without its package.
    """
    return Rules.name if spelled == Rules.name else _source(spelled).name


def chosen_transcript(default: str) -> Transcript | None:
    """Of this process's environment; None stands for rules-v1. Raises as ``language_name``."""
    spelled = os.environ.get(LANGUAGE_VARIABLE) or default
    record = os.environ.get(RECORD_VARIABLE)
    return None if spelled == Rules.name else Transcript(_source(spelled), record=Path(record) if record else None)


def _source(spelled: str) -> Replay | Live:
    kind, _, rest = spelled.partition(":")
    if kind == "replay" and rest:
        return Replay(rest)
    if kind == "live" and rest:
        if not MODEL_NAME.fullmatch(rest):
            raise ConfigError(f"language {spelled!r:.200}: expected as MODEL {MODEL_NAME_WANTED}")
        return Live(rest)
    if kind == "live":
        raise ConfigError(f"language {spelled!r:.200}: expected a model after it, as in live:my-model")
    raise ConfigError(f"language {spelled!r:.200}: expected {SPELLINGS}")
