"""Asks a source of completions, notes every answer, and writes a replay file on request."""

from __future__ import annotations

import fcntl
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from carecontact.errors import LanguageError
from carecontact.policies.language.completion import Completion, CompletionRequest, CompletionSource, Message
from carecontact.policies.language.fence import json_of
from carecontact.policies.language.replay import RecordedCompletion
from carecontact.policies.language.untrusted import one_line

Answer = TypeVar("Answer", bound=BaseModel)

MAX_TOKENS = 1024
REPAIRS = 1
PLACE_CHARS = 100


class Transcript:
    """Conversations with one source; each call starts from the messages that it is given."""

    def __init__(self, source: CompletionSource, *, record: Path | None = None) -> None:
        """``record``: a replay file to which every new completion is appended, refusals too."""
        self.name = source.name
        self._source, self._record = source, record
        self._calls: list[dict[str, object]] = []

    def text(self, messages: Sequence[Message], *, purpose: str, prompt_version: str) -> str:
        """Return a free text. Raises LanguageError, also for a refusal and for a text that was cut."""
        completion = self._complete(messages, purpose=purpose, prompt_version=prompt_version, json_schema=None)
        if completion.finish_reason != "stop":
            raise LanguageError(f"{self._about(purpose)} is not whole (finish reason {completion.finish_reason})")
        return completion.text

    def answer(self, messages: Sequence[Message], schema: type[Answer], *, purpose: str, prompt_version: str) -> Answer:
        """Return an answer that the schema accepts.

        A wrong answer is sent back to the model once with what is wrong. Raises LanguageError if the answer is still
        wrong, and for a refusal.
        """
        messages, wrong = list(messages), ""
        for _ in range(1 + REPAIRS):
            completion = self._complete(
                messages, purpose=purpose, prompt_version=prompt_version, json_schema=schema.model_json_schema()
            )
            try:
                return schema.model_validate_json(json_of(completion.text))
            except ValidationError as error:
                first = error.errors()[0]
                # It may contain the name of a field that the answer made up.
                place = one_line(".".join(map(str, first["loc"])), limit=PLACE_CHARS) or "the answer"
                wrong = f"{place}: {first['msg']}"
            messages += [
                Message(role="assistant", content=completion.text),
                Message(role="user", content=f"That does not fit the schema ({wrong}). Send the corrected JSON alone."),
            ]
        raise LanguageError(f"{self._about(purpose)} does not fit its schema after {REPAIRS} repair: {wrong}")

    def take_calls(self) -> list[dict[str, object]]:
        """Return the calls since the last time this was called, for the recording."""
        calls, self._calls = self._calls, []
        return calls

    def _about(self, purpose: str) -> str:
        last = self._calls[-1]
        return f"{self.name}: the answer {str(last['completion_sha256'])[:12]} to {purpose}"

    def _complete(
        self, messages: Sequence[Message], *, purpose: str, prompt_version: str, json_schema: dict[str, Any] | None
    ) -> Completion:
        request = CompletionRequest(
            model=self._source.model, messages=tuple(messages), json_schema=json_schema, max_tokens=MAX_TOKENS,
            prompt_version=prompt_version,
        )  # fmt: skip
        call: dict[str, object] = {
            "purpose": purpose, "backend": self.name, "prompt_version": prompt_version,
            "request_sha256": request.sha256, "completion_sha256": None,
        }  # fmt: skip
        try:
            completion = self._source.complete(request)
        except LanguageError as error:
            if error.endpoint is not None:
                self._calls.append(call | {"endpoint": error.endpoint})
            raise
        call |= {"model": completion.model, "completion_sha256": completion.sha256}
        given = {"endpoint": completion.endpoint, "sent": completion.sent}
        self._calls.append(call | {k: v for k, v in given.items() if v is not None})
        if self._record is not None:
            append_completion(self._record, request, completion)
        if completion.refusal is not None:
            raise LanguageError(f"{self._about(purpose)} is a refusal: {completion.refusal:.500}")
        return completion


def append_completion(path: Path, request: CompletionRequest, completion: Completion) -> None:
    """Append one line, unless the file holds an answer to the request already; trials may do so at the same time.

    Raises LanguageError if the file cannot be written.
    """
    row = RecordedCompletion(key=request.sha256, request=request, completion=completion)
    line = json.dumps(row.model_dump(mode="json"), sort_keys=True) + "\n"
    try:
        with path.open("a+b") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            file.seek(0)
            # The first answer counts: a model that answers differently the second time must not spoil the file.
            if any(f'"key": "{row.key}"'.encode() in held for held in file):
                return
            file.write(line.encode())
    except OSError as error:
        raise LanguageError(f"completions cannot be recorded in {path}: {error.strerror}") from None
