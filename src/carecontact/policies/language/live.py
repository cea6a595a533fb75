"""``live:<model>``: any endpoint that speaks OpenAI's chat completions; nothing that it sends is trusted."""

from __future__ import annotations

import logging
import time
from functools import partial
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

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
from carecontact.policies.language.reply import MAX_REPLY_BYTES, Reply, StatusError, read_body
from carecontact.policies.language.sampling import Sampling
from carecontact.policies.language.untrusted import Cleaner

if TYPE_CHECKING:
    from openai import OpenAI

DEADLINE_S = 25.0
"""Limit of one completion with all its tries: below the 30 s that a protocol allows a call of a policy."""
RETRIES = 1
"""Further tries where one may help: no connection, 429, 5xx."""
RETRY_PAUSE_S = 0.5
EVIDENCE_CHARS = 500
"""Characters of what an endpoint said that an error message quotes."""


class Live:
    """Asks an endpoint at OPENAI_BASE_URL with the key OPENAI_API_KEY; a local endpoint needs no key.

    No key or password of the environment gets into a completion or an error.
    """

    def __init__(self, model: str, *, deadline_s: float = DEADLINE_S) -> None:
        """Read the environment; this connects to nothing yet.

        Args:
            model: name of the model that is requested.
            deadline_s: limit of one completion with all its tries [s].

        Raises:
            DependencyError: the package openai is not installed.
            ConfigError: an address or key of the environment cannot be one.
        """
        self.model, self.name = model, f"live:{model}"
        self._deadline_s = deadline_s
        self._address = address_of_environment()
        self._cleaner = Cleaner(self._address.secrets)
        self._sampling = Sampling()
        self._client: OpenAI | None = self._new_client()

    def complete(self, request: CompletionRequest) -> Completion:
        """Return the completion within the deadline, whatever the endpoint does.

        Raises LanguageError that names what went wrong: the endpoint is out of reach or slow, sends an HTTP error, or
        sends a reply that is cut off, too long or not a chat completion.
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
                raise self._failure(f"there was no whole reply within {self._deadline_s:g} s") from None
            except LanguageError:
                raise
            except StatusError as error:
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
            content, whole = read_body(reply, limit_s=DEADLINE_S)
        if not whole:
            raise self._failure(f"the reply has more than {MAX_REPLY_BYTES} bytes")
        try:
            parsed = Reply.model_validate_json(content)
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(map(str, first["loc"])) or "the body"
            raise self._failure(
                f"the reply is not a chat completion ({where}: {first['msg']}): "
                f"{self._evidence(content.decode(errors='replace'))}"
            ) from None
        return self._completion(parsed, request, sent)

    def _completion(self, reply: Reply, request: CompletionRequest, sent: dict[str, float | int]) -> Completion:
        choice, clean = reply.choices[0], self._cleaner
        text, refusal = clean.text(choice.message.content or ""), choice.message.refusal
        if len(text) > MAX_TEXT_CHARS:
            raise self._failure(f"the answer has {len(text)} characters; at most {MAX_TEXT_CHARS} are taken")
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
        content, _ = read_body(response, limit_s=DEADLINE_S)
        raise StatusError(response.status_code, content.decode(errors="replace"))
