"""``live:<model>``: any endpoint that speaks OpenAI's chat completions, distrusted in everything that it sends."""

from __future__ import annotations

import logging
import time
from functools import partial
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, Field, ValidationError

from carecontact.errors import ConfigError, DependencyError, LanguageError
from carecontact.policies.language.address import Address, address_of_environment
from carecontact.policies.language.completion import (
    MAX_NAME_CHARS,
    MAX_REFUSAL_CHARS,
    MAX_TEXT_CHARS,
    Completion,
    CompletionRequest,
)
from carecontact.policies.language.deadline import call_within
from carecontact.policies.language.sampling import Sampling
from carecontact.policies.language.untrusted import Cleaner

if TYPE_CHECKING:
    from openai import OpenAI

DEADLINE_S = 25.0
"""For one completion with all its tries: below the 30 s that a protocol allows a call of a policy."""
RETRIES = 1
"""Where another try may help: no connection, 429, 5xx."""
RETRY_PAUSE_S = 0.5
MAX_REPLY_BYTES = 1 << 20
"""Of any body, an error's too; a completion has some kilobytes."""
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


class _ErrorEntry(BaseModel):
    message: str
    param: str | None = None


class _ErrorReply(BaseModel):
    error: _ErrorEntry


class _StatusError(Exception):
    """The endpoint answered with another status than 2xx."""

    def __init__(self, status: int, body: str) -> None:
        self.status = status
        try:
            entry = _ErrorReply.model_validate_json(body).error
            self.said, self.param = entry.message, entry.param
        except ValidationError:
            self.said, self.param = body, None
        super().__init__(f"HTTP {status}")

    @property
    def may_pass(self) -> bool:
        return self.status == 429 or self.status >= 500


class Live:
    """Address and key come from OPENAI_BASE_URL and OPENAI_API_KEY; a local endpoint needs no key.

    No value of a key or password of the environment gets into a completion or an error.
    """

    def __init__(self, model: str, *, deadline_s: float = DEADLINE_S) -> None:
        """Connects to nothing yet. Raises DependencyError if the package openai is not installed, ConfigError for an
        address or key that cannot be one."""
        self.model, self.name = model, f"live:{model}"
        self._deadline_s = deadline_s
        self._address = address_of_environment()
        self._cleaner = Cleaner(self._address.secrets)
        self._sampling = Sampling()
        self._client: OpenAI | None = self._new_client()

    def complete(self, request: CompletionRequest) -> Completion:
        """Within the deadline, whatever the endpoint does.

        Raises LanguageError saying what that was: out of reach, slow, an HTTP error, a reply that is cut off, too long
        or no chat completion.
        """
        import openai

        self._client = client = self._client or self._new_client()
        until, retries, sampling = time.monotonic() + self._deadline_s, RETRIES, self._sampling
        while True:
            try:
                once = partial(self._once, client, request, sampling, until)
                completion = call_within(until - time.monotonic(), once)
            except (TimeoutError, openai.APITimeoutError):
                # A thread that was left behind may still hold its connections.
                self._client = None
                raise self._failure(f"no whole reply within {self._deadline_s:g} s") from None
            except LanguageError:
                raise
            except _StatusError as error:
                adapted = sampling.adapted(error.param, error.said) if error.status == 400 else sampling
                if adapted != sampling:
                    sampling = adapted
                    continue
                wrong = f"HTTP {error.status}: {self._evidence(error.said)}"
                if not error.may_pass:
                    raise self._failure(wrong) from None
            except openai.OpenAIError as error:
                cause = f" ({error.__cause__!r})" if error.__cause__ else ""
                wrong = self._evidence(f"{error}{cause}")
            except Exception as error:
                # The HTTP library has classes of its own for replies that break off or are no HTTP.
                wrong = f"the reply broke off: {self._evidence(repr(error))}"
            else:
                # What was accepted once is asked for at once from now on.
                self._sampling = sampling
                return completion
            if not retries:
                raise self._failure(wrong)
            retries -= 1
            time.sleep(min(RETRY_PAUSE_S, max(until - time.monotonic(), 0.0)))

    def _once(self, client: OpenAI, request: CompletionRequest, sampling: Sampling, until: float) -> Completion:
        sent = sampling.parameters(request)
        options: dict[str, Any] = {}
        if request.json_schema is not None:
            schema = {"name": "answer", "schema": request.json_schema, "strict": True}
            options["response_format"] = {"type": "json_schema", "json_schema": schema}
        create: Any = client.chat.completions.with_streaming_response.create
        # Streamed, so that a reply without end is not waited for.
        with create(
            model=request.model,
            messages=[m.model_dump() for m in request.messages],
            timeout=max(until - time.monotonic(), 0.001),
            **sent,
            **options,
        ) as reply:
            content, whole = _read(reply)
        if not whole:
            raise self._failure(f"a reply of more than {MAX_REPLY_BYTES} bytes")
        try:
            parsed = _Reply.model_validate_json(content)
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(map(str, first["loc"])) or "the body"
            raise self._failure(
                f"the reply is no chat completion ({where}: {first['msg']}): "
                f"{self._evidence(content.decode(errors='replace'))}"
            ) from None
        return self._completion(parsed, request, sent)

    def _completion(self, reply: _Reply, request: CompletionRequest, sent: dict[str, float | int]) -> Completion:
        choice, clean = reply.choices[0], self._cleaner
        text, refusal = clean.text(choice.message.content or ""), choice.message.refusal
        if len(text) > MAX_TEXT_CHARS:
            raise self._failure(f"an answer of {len(text)} characters; at most {MAX_TEXT_CHARS} are taken")
        return Completion(
            text=text,
            refusal=clean.line(refusal, limit=MAX_REFUSAL_CHARS) if refusal else None,
            finish_reason=clean.line(choice.finish_reason or "stop", limit=MAX_NAME_CHARS),
            model=clean.line(reply.model or request.model, limit=MAX_NAME_CHARS),
            endpoint=self._address.endpoint,
            sent=sent,
        )

    def _evidence(self, said: str) -> str:
        return self._cleaner.line(said, limit=EVIDENCE_CHARS)

    def _failure(self, what: str) -> LanguageError:
        endpoint = self._address.endpoint
        return LanguageError(f"{self.name}: {what} (endpoint {endpoint})", endpoint=endpoint)

    def _new_client(self) -> OpenAI:
        try:
            return _client(self._address)
        except ImportError:
            raise DependencyError(
                "the language backend live needs the package openai: pip install 'carecontact[live]'"
            ) from None
        except Exception as error:
            # Proxies and certificates of the environment; a proxy's address may hold a password.
            raise ConfigError(
                f"{self.name}: no HTTP client with these variables OPENAI_*, *_PROXY and SSL_CERT_FILE: "
                f"{self._evidence(repr(error))}"
            ) from None


def _client(address: Address) -> OpenAI:
    from openai import DefaultHttpxClient, OpenAI

    # OPENAI_LOG=debug would print requests and replies as they are, and what a policy prints is kept.
    logging.getLogger("openai").setLevel(logging.WARNING)
    # A redirect would be answered by another host than the results name.
    http = DefaultHttpxClient(event_hooks={"response": [_raise_for_status]}, follow_redirects=False)
    # The client insists on a key; its own retries could wait for minutes.
    client = OpenAI(api_key=address.key or "none", base_url=address.url, http_client=http, max_retries=0)
    # Imported by the first use, which shall not count for the first request.
    _ = client.chat.completions
    return client


def _raise_for_status(response: Any) -> None:
    """Before the client reads all of an error's body."""
    if not response.is_success:
        content, _ = _read(response)
        raise _StatusError(response.status_code, content.decode(errors="replace"))


def _read(response: Any) -> tuple[bytes, bool]:
    """The body up to MAX_REPLY_BYTES as it is unpacked, and whether that is all of it."""
    content, began = bytearray(), time.monotonic()
    for piece in response.iter_bytes():
        # Nobody waits any more; the thread that was left behind shall not read for days.
        if time.monotonic() - began > DEADLINE_S:
            raise TimeoutError
        content += piece
        if len(content) > MAX_REPLY_BYTES:
            return bytes(content[:MAX_REPLY_BYTES]), False
    return bytes(content), True
