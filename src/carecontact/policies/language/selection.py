"""Finds the language backend that the text of a policy's argument ``language`` names."""

from __future__ import annotations

from pathlib import Path

from carecontact.errors import ConfigError
from carecontact.policies.language.completion import MODEL_NAME, MODEL_NAME_WANTED
from carecontact.policies.language.live import Live
from carecontact.policies.language.replay import Replay
from carecontact.policies.language.rules import Rules
from carecontact.policies.language.transcript import Transcript

SPELLINGS = "rules-v1, replay:FILE.jsonl or live:MODEL"


def language_name(spelled: str) -> str:
    """Return what a result calls the backend that ``spelled`` names. Opens a replay file, connects to nothing.

    Raises ConfigError for another spelling or a file that is not a replay file, DependencyError for live without its
    package.
    """
    return Rules.name if spelled == Rules.name else _source(spelled).name


def transcript_of(spelled: str, *, record: Path | None = None) -> Transcript | None:
    """Return the transcript of a language model, None for rules-v1. Raises as ``language_name``.

    ``record``: file to which the completions of a live model are added.
    """
    return None if spelled == Rules.name else Transcript(_source(spelled), record=record)


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
