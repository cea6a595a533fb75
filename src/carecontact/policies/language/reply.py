"""What an endpoint sends back: the parts of a chat completion or an error that are used, read up to a limit."""

from __future__ import annotations

import time
from typing import Any

from pydantic import BaseModel, Field, ValidationError

MAX_REPLY_BYTES = 1 << 20
"""Bytes that are read of any body, an error's too; a completion has some kilobytes."""


class ReplyMessage(BaseModel):
    """The message of a choice."""

    content: str | None = None
    refusal: str | None = None


class Choice(BaseModel):
    """One answer of a chat completion."""

    message: ReplyMessage
    finish_reason: str | None = None


class Reply(BaseModel):
    """The parts of a chat completion that are used."""

    model: str | None = None
    choices: list[Choice] = Field(min_length=1)


class _ErrorEntry(BaseModel):
    message: str
    param: str | None = None


class _ErrorReply(BaseModel):
    error: _ErrorEntry


class StatusError(Exception):
    """The endpoint answered with a status other than 2xx."""

    def __init__(self, status: int, body: str) -> None:
        """``said`` and ``param`` are taken from the body where it is an error as OpenAI sends it."""
        self.status = status
        try:
            entry = _ErrorReply.model_validate_json(body).error
            self.said, self.param = entry.message, entry.param
        except ValidationError:
            self.said, self.param = body, None
        super().__init__(f"HTTP {status}")

    @property
    def may_pass(self) -> bool:
        """Whether another try may succeed."""
        return self.status == 429 or self.status >= 500


def read_body(response: Any, *, limit_s: float) -> tuple[bytes, bool]:
    """Return the unpacked body up to MAX_REPLY_BYTES, and whether that is all of it.

    Raises TimeoutError after ``limit_s``: by then nobody waits for the body any more, and the thread that reads it must
    not go on for days.
    """
    content, began = bytearray(), time.monotonic()
    for piece in response.iter_bytes():
        if time.monotonic() - began > limit_s:
            raise TimeoutError
        content += piece
        if len(content) > MAX_REPLY_BYTES:
            return bytes(content[:MAX_REPLY_BYTES]), False
    return bytes(content), True
