"""What a language model is asked and what it answers, in the spelling that recordings are found by."""

from __future__ import annotations

import hashlib
import json
from typing import Any, Literal, Protocol

from pydantic import BaseModel, ConfigDict


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

    text: str
    refusal: str | None = None
    """What the model said instead of answering."""
    finish_reason: str = "stop"
    """Anything but ``stop`` means that the text is not whole."""
    model: str
    """As the endpoint reports it, which may be more exact than what was asked for; ``authored``: written by hand."""

    @property
    def sha256(self) -> str:
        """Of text and refusal (hex)."""
        return hashlib.sha256(json.dumps([self.text, self.refusal]).encode()).hexdigest()


class CompletionSource(Protocol):
    name: str
    """``replay:<hash>:<model>`` or ``live:<model>``; travels with every result."""
    model: str
    """To be asked for."""

    def complete(self, request: CompletionRequest) -> Completion:
        """Raises LanguageError when there is none to be had."""
        ...
