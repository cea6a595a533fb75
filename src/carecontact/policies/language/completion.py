"""What a language model is asked and what it answers, in the spelling that recordings are found by."""

from __future__ import annotations

import hashlib
import json
import re
from typing import Annotated, Any, Literal, Protocol

from pydantic import BaseModel, ConfigDict, Field, SerializerFunctionWrapHandler, model_serializer

MAX_TEXT_CHARS = 16384
"""Of an answer; the token limit allows some 4,000, and the wire to the harness 65,536 bytes a text."""
MAX_REFUSAL_CHARS = 2000
MAX_NAME_CHARS = 200

Name = Annotated[str, Field(max_length=MAX_NAME_CHARS)]

MODEL_NAME = re.compile(r"[A-Za-z0-9@/._~][A-Za-z0-9@/._~:+=-]{0,127}")
MODEL_NAME_WANTED = "1 to 128 letters, digits or @ / . _ ~ : + = -, such as gpt-4o-mini or meta-llama/Llama-3.1-8B"
"""Of a model that is asked for: its name stands in results, tables and file names."""


class Message(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    role: Literal["system", "user", "assistant"]
    content: str


class CompletionRequest(BaseModel):
    """Everything that a completion depends on; ``sha256`` is the key of a recorded one."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    model: str
    messages: tuple[Message, ...]
    json_schema: dict[str, Any] | None = None
    """That the answer has to follow; None: free text."""
    temperature: float = 0.0
    max_tokens: int
    prompt_version: str

    @property
    def sha256(self) -> str:
        """Of the canonical JSON (hex)."""
        content = json.dumps(self.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(content.encode()).hexdigest()


class Completion(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    text: Annotated[str, Field(max_length=MAX_TEXT_CHARS)]
    refusal: Annotated[str, Field(max_length=MAX_REFUSAL_CHARS)] | None = None
    """What the model said instead of answering."""
    finish_reason: Name = "stop"
    """Anything but ``stop`` means that the text is not whole."""
    model: Name
    """As the endpoint reports it, which may be more exact than what was asked for; ``authored``: written by hand."""
    endpoint: Name | None = None
    """``host`` or ``host:port`` that gave it; None: written by hand, or recorded before this was."""
    sent: dict[Name, float | int] | None = None
    """Sampling parameters as the endpoint accepted them, which may be others than the request's."""

    @property
    def sha256(self) -> str:
        """Of text and refusal (hex)."""
        return hashlib.sha256(json.dumps([self.text, self.refusal]).encode()).hexdigest()

    @model_serializer(mode="wrap")
    def _as_before(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Without the fields that only an endpoint's answers have: files of others stay what they were."""
        return {k: v for k, v in handler(self).items() if v is not None or k not in ("endpoint", "sent")}


class CompletionSource(Protocol):
    name: str
    """``replay:<hash>:<model>`` or ``live:<model>``; travels with every result."""
    model: str
    """To be asked for."""

    def complete(self, request: CompletionRequest) -> Completion:
        """Raises LanguageError when there is none to be had."""
        ...
