"""``live:<model>``: any endpoint that speaks OpenAI's chat completions, distrusted in everything that it sends."""

from __future__ import annotations

import os
import time
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, Field, ValidationError

from carecontact.errors import DependencyError, LanguageError
from carecontact.policies.language.completion import Completion, CompletionRequest

if TYPE_CHECKING:
    from openai import OpenAI

DEADLINE_S = 25.0
"""For one completion with its retry: below the 30 s that a protocol allows a call of a policy."""
RETRY_PAUSE_S = 0.5
MAX_REPLY_BYTES = 1 << 20
"""A completion has some kilobytes."""
EVIDENCE_CHARS = 500


class _ReplyMessage(BaseModel):
    content: str | None = None
    refusal: str | None = None


class _Choice(BaseModel):
    message: _ReplyMessage
    finish_reason: str | None = None


class _Reply(BaseModel):
    """What is used of a chat completion."""

    model: str | None = None
    choices: list[_Choice] = Field(min_length=1)


class Live:
    """Address and key come from OPENAI_BASE_URL and OPENAI_API_KEY; a local endpoint needs no key."""

    def __init__(self, model: str, *, deadline_s: float = DEADLINE_S) -> None:
        """Connects to nothing yet. Raises DependencyError if the package openai is not installed."""
        self.model, self.name = model, f"live:{model}"
        self._deadline_s = deadline_s
        self._client = _client()

    def complete(self, request: CompletionRequest) -> Completion:
        """One retry where another try may help: no connection, 429, 5xx.

        Raises LanguageError saying what the endpoint did: out of reach, slow, an HTTP error, a reply that is cut off,
        too long or no chat completion.
        """
        import openai

        began, passing = (
            time.monotonic(),
            (openai.APIConnectionError, openai.RateLimitError, openai.InternalServerError),
        )
        for left in (1, 0):
            try:
                return self._once(request, began=began)
            except _Slow:
                break
            except openai.APITimeoutError:
                break
            except passing as error:
                if not left:
                    raise LanguageError(f"{self.name}: {_told(error)}") from None
                time.sleep(RETRY_PAUSE_S)
            except openai.OpenAIError as error:
                raise LanguageError(f"{self.name}: {_told(error)}") from None
            except (LanguageError, KeyboardInterrupt):
                raise
            except Exception as error:
                # The HTTP library has classes of its own for replies that break off or are no HTTP.
                if not left:
                    raise LanguageError(f"{self.name}: the reply broke off: {error!r:.{EVIDENCE_CHARS}}") from None
                time.sleep(RETRY_PAUSE_S)
        raise LanguageError(f"{self.name}: no whole reply within {self._deadline_s:g} s")

    def _once(self, request: CompletionRequest, *, began: float) -> Completion:
        options: dict[str, Any] = {}
        if request.json_schema is not None:
            schema = {"name": "answer", "schema": request.json_schema, "strict": True}
            options["response_format"] = {"type": "json_schema", "json_schema": schema}
        left = self._deadline_s - (time.monotonic() - began)
        if left <= 0:
            raise _Slow
        content = bytearray()
        create: Any = self._client.chat.completions.with_streaming_response.create
        # Streamed, so that neither a reply that trickles in nor one without end is waited for.
        with create(
            model=request.model,
            messages=[m.model_dump() for m in request.messages],
            temperature=request.temperature,
            max_tokens=request.max_tokens,
            timeout=left,
            **options,
        ) as reply:
            for piece in reply.iter_bytes():
                content += piece
                if len(content) > MAX_REPLY_BYTES:
                    raise LanguageError(f"{self.name}: a reply of more than {MAX_REPLY_BYTES} bytes")
                if time.monotonic() - began > self._deadline_s:
                    raise _Slow
        try:
            parsed = _Reply.model_validate_json(bytes(content))
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(map(str, first["loc"])) or "the body"
            raise LanguageError(
                f"{self.name}: the reply is no chat completion ({where}: {first['msg']}): "
                f"{bytes(content).decode(errors='replace'):.{EVIDENCE_CHARS}}"
            ) from None
        choice = parsed.choices[0]
        return Completion(
            text=choice.message.content or "",
            refusal=choice.message.refusal or None,
            finish_reason=choice.finish_reason or "stop",
            model=parsed.model or request.model,
        )


class _Slow(Exception):
    pass


def _client() -> OpenAI:
    try:
        from openai import OpenAI
    except ImportError:
        raise DependencyError(
            "the language backend live needs the package openai: pip install 'carecontact[live]'"
        ) from None
    # The client insists on a key, endpoints on one's own machine do not; its own retries could wait for minutes.
    return OpenAI(api_key=os.environ.get("OPENAI_API_KEY") or "none", max_retries=0)


def _told(error: Exception) -> str:
    from openai import APIStatusError

    if isinstance(error, APIStatusError):
        return f"HTTP {error.status_code}: {error.message:.{EVIDENCE_CHARS}}"
    cause = f" ({error.__cause__!r:.200})" if error.__cause__ else ""
    return f"{error!s:.{EVIDENCE_CHARS}}{cause}"
