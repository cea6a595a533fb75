"""Language models behind an endpoint that speaks OpenAI's chat completions, and which backend a run's `language`
names."""

from __future__ import annotations

import logging
import os
import re
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar
from urllib.parse import SplitResult, unquote, urlsplit

from pydantic import BaseModel, Field, ValidationError

from carecontact.errors import ConfigError, DependencyError, LanguageError
from carecontact.policies.language.backend import Rules
from carecontact.policies.language.completion import (
    MAX_NAME_CHARS,
    MAX_REFUSAL_CHARS,
    MAX_TEXT_CHARS,
    MODEL_NAME,
    MODEL_NAME_WANTED,
    Cleaner,
    Completion,
    CompletionRequest,
    Replay,
    Transcript,
    first_fault,
)

if TYPE_CHECKING:
    from openai import OpenAI

URL_VARIABLE, KEY_VARIABLE = "OPENAI_BASE_URL", "OPENAI_API_KEY"
DEFAULT_URL = "https://api.openai.com/v1"
MAX_URL = 500
_PROXIES = ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY")
_WANTED = "expected http:// or https:// with a host and no query, such as http://127.0.0.1:8000/v1"


@dataclass(frozen=True, kw_only=True)
class Address:
    """The place of the endpoint, and what must not be shown of it."""

    url: str = field(repr=False)
    key: str = field(repr=False)
    """Empty if none was given."""
    endpoint: str
    """``host`` or ``host:port``: the part of the address that may be stored."""
    secrets: tuple[str, ...] = field(repr=False)
    """Every confidential value of the environment that a request carries."""


def address_of_environment() -> Address:
    """Raises ConfigError that names the variable that is wrong, without its value."""
    url, key = os.environ.get(URL_VARIABLE) or DEFAULT_URL, os.environ.get(KEY_VARIABLE) or ""
    if not all("!" <= c <= "~" for c in key):
        raise ConfigError(f"{KEY_VARIABLE}: expected printable ASCII without spaces or line ends")
    parts = _split(url)
    if parts is None or parts.scheme not in ("http", "https") or not parts.hostname or parts.query or parts.fragment:
        raise ConfigError(f"{URL_VARIABLE}: {_WANTED}")
    endpoint = parts.netloc.rpartition("@")[2].lower()
    return Address(url=url, key=key, endpoint=endpoint, secrets=tuple(_secrets(key, parts)))


def _split(url: str) -> SplitResult | None:
    try:
        parts = urlsplit(url)
        # urlsplit checks a port only when it is read.
        _ = parts.port
    except ValueError:
        return None
    return parts if len(url) <= MAX_URL and url.isprintable() and " " not in url else None


def _secrets(key: str, address: SplitResult) -> Iterator[str]:
    yield key
    yield os.environ.get("OPENAI_ADMIN_KEY", "")
    for header in os.environ.get("OPENAI_CUSTOM_HEADERS", "").splitlines():
        value = header.partition(":")[2].strip()
        yield value
        yield value.partition(" ")[2]
    proxies = (_split(os.environ.get(name) or os.environ.get(name.lower()) or "") for name in _PROXIES)
    for parts in (address, *proxies):
        if parts is not None and parts.password:
            user, password = unquote(parts.username or ""), unquote(parts.password)
            yield from (password, f"{user}:{password}")


Value = TypeVar("Value")


def call_within(seconds: float, function: Callable[[], Value]) -> Value:
    """Return or raise what ``function`` does, or raise TimeoutError once the time is up.

    The function runs in a thread of its own, which is left to itself after the time limit: nothing else ends the
    look-up of a host's name, or a header that arrives byte by byte, each byte well within the timeout of a socket.
    """
    if seconds <= 0:
        raise TimeoutError
    answer: Future[Value] = Future()

    def work() -> None:
        try:
            answer.set_result(function())
        except BaseException as error:
            answer.set_exception(error)

    threading.Thread(target=work, daemon=True).start()
    return answer.result(timeout=seconds)


MAX_REPLY_BYTES = 1 << 20
"""Bytes that are read of any body, an error's too; a completion has some kilobytes."""


class ReplyMessage(BaseModel):
    content: str | None = None
    refusal: str | None = None


class Choice(BaseModel):
    message: ReplyMessage
    finish_reason: str | None = None


class Reply(BaseModel):
    """The parts of a chat completion that are used."""

    model: str | None = None
    choices: list[Choice] = Field(min_length=1)


class ErrorEntry(BaseModel):
    message: str
    param: str | None = None


class ErrorReply(BaseModel):
    error: ErrorEntry


class StatusError(Exception):
    def __init__(self, status: int, body: str) -> None:
        self.status = status
        try:
            self.entry = ErrorReply.model_validate_json(body).error
        except ValidationError:
            self.entry = ErrorEntry(message=body)


def read_body(response: Any) -> tuple[bytes, bool]:
    """Return the unpacked body up to MAX_REPLY_BYTES, and whether that is all of it.

    Raises TimeoutError after DEADLINE_S: by then the call has ended, and its thread must not go on reading for days.
    """
    content, began = bytearray(), time.monotonic()
    for piece in response.iter_bytes():
        if time.monotonic() - began > DEADLINE_S:
            raise TimeoutError
        content += piece
        if len(content) > MAX_REPLY_BYTES:
            return bytes(content[:MAX_REPLY_BYTES]), False
    return bytes(content), True


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """Sampling parameters that are sent: OpenAI's newer models take other names than most endpoints."""

    temperature: bool = True
    """False if the endpoint accepts none; it then samples as it does by default."""
    limit: str = "max_tokens"
    """Name of the token limit; the newer one, ``max_completion_tokens``, also counts a model's reasoning."""

    def parameters(self, request: CompletionRequest) -> dict[str, float | int]:
        sent: dict[str, float | int] = {self.limit: request.max_tokens}
        return {"temperature": request.temperature, **sent} if self.temperature else sent

    def adapted(self, parameter: str | None, message: str) -> Sampling:
        """Return what to send after an HTTP 400: the parameter that the error's field or text names is replaced."""
        named = {parameter} if parameter else set(re.findall(r"\b(?:temperature|max_tokens)\b", message))
        return Sampling(
            temperature=self.temperature and "temperature" not in named,
            limit="max_completion_tokens" if "max_tokens" in named else self.limit,
        )


DEADLINE_S = 25.0
"""Limit of one completion with all its tries: below the 30 s that a protocol allows a call of a policy."""
RETRIES = 1
"""Further tries where one may help: no connection, 429, 5xx."""
RETRY_PAUSE_S = 0.5
EVIDENCE_CHARS = 500
"""Characters of an endpoint's text that an error message quotes."""


class Live:
    """``live:<model>``: asks an endpoint at OPENAI_BASE_URL with the key OPENAI_API_KEY; a local one needs no key.

    No key or password of the environment gets into a completion or an error.
    """

    def __init__(self, model: str, *, deadline_s: float = DEADLINE_S) -> None:
        """Raises DependencyError without the package openai, ConfigError for an address or key that cannot be one."""
        self.model, self.name = model, f"live:{model}"
        self._deadline_s = deadline_s
        self._address = address_of_environment()
        self._cleaner = Cleaner(self._address.secrets)
        self._sampling = Sampling()
        self._client: OpenAI | None = self._new_client()

    def complete(self, request: CompletionRequest) -> Completion:
        """Return the completion within the deadline. Raises LanguageError if the endpoint gives none."""
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
                raise self._failure(f"there was no whole reply within {self._deadline_s:g} s") from None
            except LanguageError:
                raise
            except StatusError as error:
                sent, text = sampling, error.entry.message
                if error.status == 400:
                    sampling = sent.adapted(error.entry.param, text)
                if sampling != sent:
                    continue
                wrong = f"HTTP {error.status}: {self._evidence(text)}"
                if error.status != 429 and error.status < 500:
                    raise self._failure(wrong) from None
            except openai.OpenAIError as error:
                cause = f" ({error.__cause__!r})" if error.__cause__ else ""
                wrong = self._evidence(f"{error}{cause}")
            except Exception as error:
                # The HTTP library has classes of its own for replies that break off or are not HTTP.
                wrong = f"the reply is incomplete or is not HTTP: {self._evidence(repr(error))}"
            else:
                # Later requests begin with what was accepted once.
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
        # The reply is streamed, so that one without end is cut.
        with create(
            model=request.model,
            messages=[m.model_dump() for m in request.messages],
            timeout=max(until - time.monotonic(), 0.001),
            **sent,
            **options,
        ) as reply:
            content, whole = read_body(reply)
        if not whole:
            raise self._failure(f"the reply has more than {MAX_REPLY_BYTES} bytes")
        try:
            parsed = Reply.model_validate_json(content)
        except ValidationError as error:
            body = self._evidence(content.decode(errors="replace"))
            fault = first_fault(error, "the body")
            raise self._failure(f"the reply is not a chat completion ({fault}): {body}") from None
        choice, clean = parsed.choices[0], self._cleaner
        text, refusal = clean.text(choice.message.content or ""), choice.message.refusal
        if len(text) > MAX_TEXT_CHARS:
            raise self._failure(f"the answer has {len(text)} characters; at most {MAX_TEXT_CHARS} are taken")
        return Completion(
            text=text,
            refusal=clean.line(refusal, limit=MAX_REFUSAL_CHARS) if refusal else None,
            finish_reason=clean.line(choice.finish_reason or "stop", limit=MAX_NAME_CHARS),
            model=clean.line(parsed.model or request.model, limit=MAX_NAME_CHARS),
            endpoint=self._address.endpoint,
            sent=sent,
        )

    def _evidence(self, text: str) -> str:
        return self._cleaner.line(text, limit=EVIDENCE_CHARS)

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
                f"{self.name}: an HTTP client cannot be made with these variables OPENAI_*, *_PROXY and SSL_CERT_FILE: "
                f"{self._evidence(repr(error))}"
            ) from None


def _client(address: Address) -> OpenAI:
    from openai import DefaultHttpxClient, OpenAI

    # OPENAI_LOG=debug would print requests and replies as they are, and what a policy prints is kept.
    logging.getLogger("openai").setLevel(logging.WARNING)
    # A redirect would lead to a host other than the one that results name.
    http = DefaultHttpxClient(event_hooks={"response": [_raise_for_status]}, follow_redirects=False)
    # The client insists on a key; its own retries could wait for minutes.
    client = OpenAI(api_key=address.key or "none", base_url=address.url, http_client=http, max_retries=0)
    # The first use imports modules, whose time shall not count for the first request.
    _ = client.chat.completions
    return client


def _raise_for_status(response: Any) -> None:
    """Raise StatusError before the client reads all of an error's body."""
    if not response.is_success:
        content, _ = read_body(response)
        raise StatusError(response.status_code, content.decode(errors="replace"))


SPELLINGS = "rules-v1, replay:FILE.jsonl or live:MODEL"


def language_name(spelled: str) -> str:
    """Return what a result calls the backend that ``spelled`` names. Opens a replay file, connects to nothing.

    Raises ConfigError for another spelling or file, DependencyError for live without its package.
    """
    return Rules.name if spelled == Rules.name else _source(spelled).name


def transcript_of(spelled: str, *, record: Path | None = None) -> Transcript | None:
    """Return the transcript of a language model, None for rules-v1. Raises as ``language_name``."""
    return None if spelled == Rules.name else Transcript(_source(spelled), record=record)


def _source(spelled: str) -> Replay | Live:
    kind, _, rest = spelled.partition(":")
    if kind == "replay" and rest:
        return Replay(rest)
    if kind == "live" and MODEL_NAME.fullmatch(rest):
        return Live(rest)
    wanted = SPELLINGS
    if kind == "live":
        wanted = f"as MODEL {MODEL_NAME_WANTED}" if rest else "a model after it, as in live:my-model"
    raise ConfigError(f"language {spelled!r:.200}: expected {wanted}")
