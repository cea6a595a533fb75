"""``replay:<hash>:<model>``: completions from a file, found by their requests. Any other request is an error."""

from __future__ import annotations

import hashlib
import stat
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from carecontact.errors import ConfigError, LanguageError
from carecontact.policies.language.completion import (
    MODEL_NAME,
    MODEL_NAME_WANTED,
    Completion,
    CompletionRequest,
)
from carecontact.policies.language.untrusted import one_line

AUTHORED = "authored"
"""Model name of completions that a person wrote: results made with them show what the method does, and say so."""
MAX_BYTES = 64 << 20


class RecordedCompletion(BaseModel):
    """One line of a replay file."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    key: str
    """SHA-256 of the request."""
    request: CompletionRequest
    completion: Completion


class Replay:
    """Answers requests from a file; it is deterministic and needs no network."""

    def __init__(self, path: Path | str) -> None:
        """Read the file.

        Raises ConfigError, with file and line, if the file is unreadable or not JSON lines, if a key does not belong to
        its request, if one request has two answers, or if completions are for more than one model.
        """
        content = read_bytes(Path(path))
        self._completions: dict[str, Completion] = {}
        self.model = ""
        for number, line in enumerate(content.decode(errors="replace").splitlines(), 1):
            if line.strip():
                self._add(line, place=f"{path}, line {number}")
        if not self._completions:
            raise ConfigError(f"replay file {path} contains no completion")
        self.name = replay_name(content, model=self.model)

    def complete(self, request: CompletionRequest) -> Completion:
        """Return the recorded completion. Raises LanguageError if there is none; no similar one takes its place."""
        found = self._completions.get(request.sha256)
        if found is None:
            last = request.messages[-1].content.strip()[-200:]
            raise LanguageError(
                f"{self.name} has no completion for request {request.sha256[:12]} (prompt {request.prompt_version}, "
                f"ending {last!r}); it holds {len(self._completions)}"
            )
        return found

    def _add(self, line: str, *, place: str) -> None:
        try:
            row = RecordedCompletion.model_validate_json(line)
        except ValidationError as error:
            first = error.errors()[0]
            where = one_line(".".join(map(str, first["loc"])), limit=100) or "the line"
            raise ConfigError(f"replay file {place}: {where}: {first['msg']}") from None
        if row.key != row.request.sha256:
            raise ConfigError(
                f"replay file {place}: the key is {row.key[:12]}, but its request has {row.request.sha256[:12]}"
            )
        if self.model not in ("", row.request.model):
            raise ConfigError(f"replay file {place}: model {row.request.model}, but lines before it have {self.model}")
        if not MODEL_NAME.fullmatch(row.request.model):
            raise ConfigError(
                f"replay file {place}: request.model: expected {MODEL_NAME_WANTED}, got {row.request.model!r:.80}"
            )
        # A model that is asked twice may answer differently; which answer counts must not depend on the order of lines.
        if self._completions.get(row.key, row.completion) != row.completion:
            raise ConfigError(f"replay file {place}: an earlier line has another answer to the same request")
        self.model = row.request.model
        self._completions[row.key] = row.completion


def replay_name(content: bytes, *, model: str) -> str:
    """Return the name by which results call a replay file with this content."""
    return f"replay:{hashlib.sha256(content).hexdigest()[:12]}:{model}"


def read_bytes(path: Path) -> bytes:
    """Read a file. Raises ConfigError if it is not a regular file, cannot be read or is larger than MAX_BYTES."""
    try:
        # A pipe or device may have no end, or block for ever.
        if not stat.S_ISREG(path.stat().st_mode):
            raise ConfigError(f"replay file {path}: expected a regular file, got a folder, pipe or device")
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise ConfigError(f"replay file {path}: {error.strerror}") from None
    if len(content) > MAX_BYTES:
        raise ConfigError(f"replay file {path}: it has more than {MAX_BYTES >> 20} MiB, the most that is read")
    return content
