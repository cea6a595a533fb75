"""Completions of a language model: what one is, replayed from a file, recorded, and read with distrust."""

from __future__ import annotations

import base64
import fcntl
import hashlib
import html
import json
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol, TypeVar
from urllib.parse import quote, quote_plus

from pydantic import BaseModel, ConfigDict, Field, SerializerFunctionWrapHandler, ValidationError, model_serializer

from carecontact.errors import ConfigError, LanguageError

_FENCE = re.compile(r"```[\w-]*[ \t\r]*\n(.*?)```", re.DOTALL)
_FENCED_OBJECT = re.compile(r"```[\w-]*\s*(\{.*\})\s*```", re.DOTALL)


def unfenced(text: str) -> str:
    """Return what stands between fences of Markdown, if anything does; otherwise the text as it is."""
    return "\n".join(_FENCE.findall(text)) or text


def json_of(text: str) -> str:
    """Return the JSON object that stands between fences, if one does; otherwise the text as it is."""
    found = _FENCED_OBJECT.search(text)
    return found[1] if found else text


def first_fault(error: ValidationError, whole: str) -> str:
    """Return the place and message of the first error; ``whole`` names the place if all of the text is wrong."""
    first = error.errors()[0]
    # The place may contain the name of a field that the text made up.
    return f"{one_line('.'.join(map(str, first['loc'])), limit=100) or whole}: {first['msg']}"


SHORTEST_SECRET = 6
"""Length [characters] from which a secret is looked for. A shorter one (``none``, ``test``) is a placeholder, and would
be found in ordinary words."""
SHORTEST_BASE64 = 8
_CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]")
REMOVED = "[secret removed]"
CUT = " [...]"


class Cleaner:
    """Removes secrets from the texts of an endpoint that repeats what it was sent.

    An endpoint that means to give a secret away can always spell it in a way that is not known here.
    """

    def __init__(self, secrets: Iterable[str] = ()) -> None:
        """``secrets``: values to remove; those of fewer than SHORTEST_SECRET characters stay."""
        spelled = {s for secret in secrets if len(secret) >= SHORTEST_SECRET for s in _spellings(secret)}
        longest_first = sorted(spelled, key=lambda s: (-len(s), s))
        self._secrets = re.compile("|".join(map(re.escape, longest_first)) or r"(?!)", re.IGNORECASE)

    def text(self, text: str) -> str:
        """Return a text of any length with its line ends and tabs; other control characters become U+FFFD."""
        return _CONTROL.sub("\ufffd", self._secrets.sub(REMOVED, text))

    def line(self, text: str, *, limit: int) -> str:
        """Return what ``one_line`` does, without secrets."""
        # Secrets are removed first, because the first half of a key that is cut in two would stay.
        return one_line(self._secrets.sub(REMOVED, text), limit=limit)


def one_line(text: str, *, limit: int) -> str:
    """Return one line of at most ``limit`` characters; what is not printable is escaped, and a cut is marked."""
    text = " ".join(text.split())[: limit + 1]
    text = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
    return text if len(text) <= limit else text[: limit - len(CUT)] + CUT


def _spellings(secret: str) -> Iterator[str]:
    """Yield a secret as it is, and as it looks in JSON, a Python literal, HTML, a URL, and base64 of a longer text."""
    yield from (secret, json.dumps(secret)[1:-1], secret.replace("/", "\\/"), repr(secret)[1:-1], html.escape(secret))
    yield from (quote(secret), quote(secret, safe=""), quote_plus(secret))
    for before, depends in enumerate((0, 2, 3)):
        # Characters of base64 that depend on what stands beside the secret are left out.
        content = b"\0" * before + secret.encode()
        fragment = base64.b64encode(content)[: len(content) * 4 // 3].decode()[depends:]
        if len(fragment) >= SHORTEST_BASE64:
            yield from (fragment, fragment.replace("+", "-").replace("/", "_"))


MAX_TEXT_CHARS = 16384
"""Longest answer; the token limit allows some 4,000 characters, and the wire to the harness 65,536 bytes a text."""
MAX_REFUSAL_CHARS = 2000
MAX_NAME_CHARS = 200

Name = Annotated[str, Field(max_length=MAX_NAME_CHARS)]

MODEL_NAME = re.compile(r"[A-Za-z0-9@/._~][A-Za-z0-9@/._~:+=-]{0,127}")
MODEL_NAME_WANTED = "1 to 128 letters, digits or @ / . _ ~ : + = -, such as gpt-4o-mini or meta-llama/Llama-3.1-8B"
"""What the name of a requested model may be, because it stands in results, tables and file names."""


class Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Message(Frozen):
    role: Literal["system", "user", "assistant"]
    content: str


class CompletionRequest(Frozen):
    """Everything that a completion depends on; ``sha256`` is the key of a recorded completion."""

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


class Completion(Frozen):
    text: Annotated[str, Field(max_length=MAX_TEXT_CHARS)]
    refusal: Annotated[str, Field(max_length=MAX_REFUSAL_CHARS)] | None = None
    """The model's words in place of an answer."""
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


AUTHORED = "authored"
"""Model name of completions that a person wrote: results made with them show what the method does, and say so."""
MAX_BYTES = 64 << 20


class RecordedCompletion(Frozen):
    key: str
    """SHA-256 of the request."""
    request: CompletionRequest
    completion: Completion


class Replay:
    """Answers requests from a file; it is deterministic and needs no network."""

    def __init__(self, path: Path | str) -> None:
        """Raises ConfigError, with file and line, for a file that was not recorded, or from more than one model."""
        content = read_bytes(Path(path))
        self._completions: dict[str, Completion] = {}
        self.model = ""
        for number, line in enumerate(content.decode(errors="replace").splitlines(), 1):
            if line.strip():
                self._add(line, place=f"{path}, line {number}")
        if not self._completions:
            raise ConfigError(f"replay file {path} contains no completion")
        self.name = f"replay:{hashlib.sha256(content).hexdigest()[:12]}:{self.model}"

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
            raise ConfigError(f"replay file {place}: {first_fault(error, 'the line')}") from None
        key, model, wrong = row.request.sha256, row.request.model, ""
        if row.key != key:
            wrong = f"the key is {row.key[:12]}, but its request has {key[:12]}"
        elif self.model not in ("", model):
            wrong = f"model {model}, but lines before it have {self.model}"
        elif not MODEL_NAME.fullmatch(model):
            wrong = f"request.model: expected {MODEL_NAME_WANTED}, got {model!r:.80}"
        # The answer that counts must not depend on the order of the lines.
        elif self._completions.get(key, row.completion) != row.completion:
            wrong = "an earlier line has another answer to the same request"
        if wrong:
            raise ConfigError(f"replay file {place}: {wrong}")
        self.model, self._completions[key] = model, row.completion


def read_bytes(path: Path) -> bytes:
    """Read a file. Raises ConfigError if it is not a regular file, cannot be read or is larger than MAX_BYTES."""
    try:
        if path.exists() and not path.is_file():
            raise ConfigError(f"replay file {path}: expected a regular file, got a folder, pipe or device")
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise ConfigError(f"replay file {path}: {error.strerror}") from None
    if len(content) > MAX_BYTES:
        raise ConfigError(f"replay file {path}: it has more than {MAX_BYTES >> 20} MiB, the most that is read")
    return content


Answer = TypeVar("Answer", bound=BaseModel)

MAX_TOKENS = 1024
REPAIRS = 1


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
        """Return an answer that the schema accepts; a wrong one is sent back once. Raises LanguageError."""
        messages, wrong = list(messages), ""
        for _ in range(1 + REPAIRS):
            completion = self._complete(
                messages, purpose=purpose, prompt_version=prompt_version, json_schema=schema.model_json_schema()
            )
            try:
                return schema.model_validate_json(json_of(completion.text))
            except ValidationError as error:
                wrong = first_fault(error, "the answer")
            messages += [
                Message(role="assistant", content=completion.text),
                Message(role="user", content=f"That does not fit the schema ({wrong}). Send the corrected JSON alone."),
            ]
        raise LanguageError(f"{self._about(purpose)} does not fit its schema after {REPAIRS} repair: {wrong}")

    def take_calls(self) -> list[dict[str, object]]:
        """Return the calls since the last time, for the recording."""
        calls, self._calls = self._calls, []
        return calls

    def _about(self, purpose: str) -> str:
        last = self._calls[-1]
        return f"{self.name}: the answer {str(last['completion_sha256'])[:12]} to {purpose}"

    def _complete(
        self, messages: Sequence[Message], *, purpose: str, prompt_version: str, json_schema: dict[str, Any] | None
    ) -> Completion:
        request = CompletionRequest(
            model=self._source.model,
            messages=tuple(messages),
            json_schema=json_schema,
            max_tokens=MAX_TOKENS,
            prompt_version=prompt_version,
        )
        call: dict[str, object] = {"purpose": purpose, "backend": self.name, "prompt_version": prompt_version}
        call |= {"request_sha256": request.sha256, "completion_sha256": None}
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
    """Append one line, unless the file holds an answer to the request already; trials may do so at the same time."""
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
