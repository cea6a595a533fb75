"""``results.json``: write it, pack it, read it, and refuse one that contradicts itself."""

from __future__ import annotations

import gzip
import io
import json
import zlib
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Literal, cast

from pydantic import BaseModel, BeforeValidator, FailFast, Field, ValidationError

from carecontact.errors import ConfigError
from carecontact.recording.schema import RELEASE_0_1_0
from carecontact.recording.writer import replace_file
from carecontact.runs.contradiction import contradiction
from carecontact.runs.pooling import check_one_run
from carecontact.runs.results_content import results
from carecontact.runs.run_scores import RunScores
from carecontact.runs.stored_json import MAX_BYTES, parse, read_bounded
from carecontact.scoring.result import TrialScore

RESULTS_NAME = "results.json"
MAX_TRIAL_BYTES = 1 << 20
"""Largest size of one trial's scores as JSON; most have 6 kB."""
GZIP = b"\x1f\x8b"
"""First bytes of a file that gzip packed (RFC 1952)."""


def _are_texts(found: object) -> bool:
    return isinstance(found, list) and all(isinstance(text, str) for text in cast("list[object]", found))


def _checked(found: object) -> object:
    """Raise one error for a mapping, where pydantic makes one for each of its values."""
    held = list(cast("dict[object, object]", found).values()) if isinstance(found, dict) else []
    if not (_are_texts(held) or all(map(_are_texts, held))):
        raise ValueError("must map names to texts or to lists of texts")
    return found


def _small(found: object) -> object:
    """Raise one error for the scores of a trial that are much longer than any, where pydantic might make many."""
    if len(json.dumps(found)) > MAX_TRIAL_BYTES:
        raise ValueError("holds more than the scores of a trial")
    return found


class _Results(BaseModel):
    """What of ``results.json`` is not computed from its trials."""

    version: Annotated[Literal["carecontact-results-1"], Field(alias="schema")]
    trials: Annotated[list[Annotated[TrialScore, BeforeValidator(_small)]], FailFast()]
    skipped: Annotated[dict[str, str], BeforeValidator(_checked)]
    versions: Annotated[dict[str, Annotated[list[str], FailFast()]], BeforeValidator(_checked)]
    missing: Annotated[list[str], FailFast()] = []
    elsewhere: Annotated[list[str], FailFast()] = []


def write_scores(folder: Path | str, run: RunScores) -> Path:
    """Write ``results.json`` into ``folder`` at once; the same scores give the same bytes. Returns its path."""
    return write_results(folder, results(run))


def write_results(folder: Path | str, data: Mapping[str, Any]) -> Path:
    """Write the content of a ``results.json``; the same content gives the same bytes. Returns its path."""
    path = Path(folder) / RESULTS_NAME
    replace_file(path, _as_bytes(data))
    return path


def pack_results(path: Path, run: RunScores) -> None:
    """Write the content of a ``results.json`` packed with gzip, a tenth of its size; ``read_results`` reads both.

    A file that already has this content stays as it is: other releases of zlib pack into other bytes.
    """
    content = _as_bytes(results(run))
    with suppress(ConfigError, FileNotFoundError):
        if _unpacked(path) == content:
            return
    replace_file(path, gzip.compress(content, mtime=0))


def read_results(path: Path | str) -> RunScores:
    """Return the scores in a ``results.json``, packed with gzip or not, as they were written; nothing is computed
    again.

    Raises ConfigError for a file that cannot be read, contradicts itself or mixes protocols, policies or worlds.
    """
    try:
        stored = _Results.model_validate(parse(_unpacked(Path(path))))
    except ValidationError as error:
        first = error.errors()[0]
        why = f"{'.'.join(map(str, first['loc'])) or 'content'}: {first['msg']}"
        raise ConfigError(
            f"{path} is damaged or of another release ({why}); release {RELEASE_0_1_0} reads its own results and "
            "earlier ones"
        ) from error
    except ValueError as error:
        raise ConfigError(f"{path} is damaged or of another release (not JSON: {error})") from error
    if fault := _fault(stored):
        raise ConfigError(f"{path} {fault}")
    check_one_run(stored.trials)
    return RunScores(
        scores=stored.trials, skipped=stored.skipped, versions=stored.versions, missing=tuple(stored.missing),
        elsewhere=tuple(stored.elsewhere),
    )  # fmt: skip


def skipped_before(folder: Path) -> set[str]:
    """Return names of the recordings that the last scoring of a folder skipped; none where there is no result to
    read."""
    try:
        return set(read_results(folder / RESULTS_NAME).skipped)
    except (ConfigError, OSError):
        return set()


def _fault(stored: _Results) -> str | None:
    """Return what of a results file no scorer can have written; None where there is nothing."""
    twice = [trial_id for trial_id, k in Counter(s.trial_id for s in stored.trials).items() if k > 1]
    if twice:
        return f"is damaged: it holds {twice[0]} twice"
    for score in stored.trials:
        if why := contradiction(score):
            return f"is damaged or changed by hand: {score.trial_id}: {why}"
    overlap = sorted({s.trial_id for s in stored.trials} & set(stored.missing))
    if overlap:
        return f"is damaged: {overlap[0]} is among its trials and among those that are missing"
    return None


def _as_bytes(data: Mapping[str, Any]) -> bytes:
    return (json.dumps(data, sort_keys=True, indent=1, allow_nan=False) + "\n").encode("ascii")


def _unpacked(path: Path) -> bytes:
    content = read_bounded(path)
    if not content.startswith(GZIP):
        return content
    try:
        with gzip.open(io.BytesIO(content)) as stream:
            unpacked = stream.read(MAX_BYTES + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise ConfigError(f"{path} is damaged: {error}") from error
    if len(unpacked) > MAX_BYTES:
        raise ConfigError(f"{path} unpacks to more than the {MAX_BYTES >> 20} MB that the scores of a run may have")
    return unpacked
