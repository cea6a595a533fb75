"""A request to a language model and its completion, with the hashes by which recorded ones are found."""

from __future__ import annotations

import hashlib
import json
import re
from typing import Annotated, Any, Literal, Protocol

from pydantic import BaseModel, ConfigDict, Field, SerializerFunctionWrapHandler, model_serializer

MAX_TEXT_CHARS = 16384
"""Longest answer; the token limit allows some 4,000 characters, and the wire to the harness 65,536 bytes a text."""
MAX_REFUSAL_CHARS = 2000
MAX_NAME_CHARS = 200

Name = Annotated[str, Field(max_length=MAX_NAME_CHARS)]

MODEL_NAME = re.compile(r"[A-Za-z0-9@/._~][A-Za-z0-9@/._~:+=-]{0,127}")
MODEL_NAME_WANTED = "1 to 128 letters, digits or @ / . _ ~ : + = -, such as gpt-4o-mini or meta-llama/Llama-3.1-8B"
"""What the name of a requested model may be, because it stands in results, tables and file names."""


class Message(BaseModel):
    """One message of a conversation."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    role: Literal["system", "user", "assistant"]
    content: str


class CompletionRequest(BaseModel):
    """Everything that a completion depends on; ``sha256`` is the key of a recorded completion."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    model: str
    messages: tuple[Message, ...]
    json_schema: dict[str, Any] | None = None
    """Schema that the answer has to follow; None for free text."""
    temperature: float = 0.0
    max_tokens: int
    prompt_version: str

    @property
    def sha256(self) -> str:
        """SHA-256 of the canonical JSON, in hexadecimal."""
        content = json.dumps(self.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(content.encode()).hexdigest()


class Completion(BaseModel):
    """What a language model answered."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    text: Annotated[str, Field(max_length=MAX_TEXT_CHARS)]
    refusal: Annotated[str, Field(max_length=MAX_REFUSAL_CHARS)] | None = None
    """What the model said instead of answering."""
    finish_reason: Name = "stop"
    """Any value but ``stop`` means that the text is not whole."""
    model: Name
    """The model as the endpoint reports it, perhaps more exactly than it was requested; ``authored`` if a person wrote
    the text."""
    endpoint: Name | None = None
    """``host`` or ``host:port`` that answered; None if a person wrote the text."""
    sent: dict[Name, float | int] | None = None
    """Sampling parameters that the endpoint accepted, which may differ from the request's."""

    @property
    def sha256(self) -> str:
        """SHA-256 of text and refusal, in hexadecimal."""
        return hashlib.sha256(json.dumps([self.text, self.refusal]).encode()).hexdigest()

    @model_serializer(mode="wrap")
    def _without_none(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out the fields that only an endpoint's answers have."""
        return {k: v for k, v in handler(self).items() if v is not None or k not in ("endpoint", "sent")}


class CompletionSource(Protocol):
    """Something that answers requests: an endpoint or a file."""

    name: str
    """``replay:<hash>:<model>`` or ``live:<model>``; travels with every result."""
    model: str
    """Model that requests name."""

    def complete(self, request: CompletionRequest) -> Completion:
        """Return the completion of a request. Raises LanguageError if there is none."""
        ...
