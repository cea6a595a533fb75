"""How a run sets a policy up, and the conversation with it: deadlines, answers, and what its failures mean."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import NoReturn, Self, TypeVar

from carecontact.errors import ActionError, ConfigError, PolicyError
from carecontact.interface.observation import Observation
from carecontact.interface.policy import PolicyCard, PolicyRef
from carecontact.interface.robot import Session
from carecontact.serving.client import ActReply, Client
from carecontact.serving.dialect import check_options

GRACE_S = 1.0
"""Time [s] that a policy has for ending after it was asked to."""
EVIDENCE_CHARS = 4000
WAIT_REPORT_S = 10.0
"""Interval [s] at which a silent policy is reported."""
BUDGET_S = 3600.0
"""Wall time that a policy may take in one trial, all calls together: 2.4 s for each of the 1,500 calls that 30 s at
50 Hz can hold. It is in the code and in no protocol, because it only keeps a trial from reaching the supervisor's
limit, which would count as a harness error."""

T = TypeVar("T")
Left = Callable[[], float]
"""Returns the seconds until the deadline of a call, never below 0."""


@dataclass(frozen=True, kw_only=True)
class PolicySetup:
    """A policy and everything that its process is given. It crosses process boundaries as JSON, on a pipe."""

    ref: PolicyRef
    search_path: tuple[str, ...] = ()
    """Folders in which ``module:Class`` is looked for before the installed packages."""
    arguments: Mapping[str, str] = field(default_factory=dict[str, str])
    """Texts for the constructor or factory, whose annotations decide what each becomes (``serving.arguments``)."""
    environment: Mapping[str, str] = field(default_factory=dict[str, str], repr=False)
    """Environment variables of the process besides the usual ones (``serving.process``)."""
    language: str | None = None
    """Value of the argument ``language``: rules-v1, replay:FILE.jsonl or live:MODEL. It is not in ``arguments``, which
    recordings hold; instead, the card's ``language_backend`` names it, a file by its content and not by its path."""
    record: str | None = None
    """Value of the argument ``record``: the file to which the completions of a live model are added. No recording holds
    it either."""
    readable: tuple[str, ...] = ()
    """Files and folders that its isolated process may read, besides what programs need and the policy's own files."""
    writable: tuple[str, ...] = ()
    """Files and folders that it may read and write besides its own temporary folder."""
    closed: tuple[str, ...] = ()
    """Folders that stay closed to it even inside one that it may read: those of runs. The cache folder is closed as
    well."""
    isolated: bool = True
    """False only to measure what isolation costs and closes."""

    @classmethod
    def of(cls, policy: str, *, search_path: Sequence[str] = (), arguments: Mapping[str, str] | None = None) -> Self:
        """Make the setup of a policy as the user writes it. Raises ConfigError for a malformed reference."""
        return cls(ref=PolicyRef.parse(policy), search_path=tuple(search_path), arguments=arguments or {})

    def __post_init__(self) -> None:
        """Raise ConfigError for a remote policy that is given any of this, and for unknown options in its address."""
        given = self.arguments or self.environment or self.language or self.record or self.readable or self.writable
        if self.ref.kind == "remote" and given:
            where = "`carecontact serve` there" if self.ref.scheme == "ws" else "the server itself"
            raise ConfigError(
                f"policy {self.ref}: --policy-arg, --policy-env, --policy-read, --policy-write, --language and "
                f"--record do not reach another host; give them to {where}"
            )
        check_options(self.ref)


def readable(text: str) -> str:
    """Return text of a policy with its control characters, other than line ends and tabs, escaped."""
    return "".join(c if c.isprintable() or c in "\n\t" else ascii(c)[1:-1] for c in text.replace("\r\n", "\n"))


class PolicyConversation(ABC):
    """Context manager around the conversation with one policy, for one trial.

    Every method below raises PolicyError (``kind`` says what happened, the message ends with what the policy printed,
    where that is known) and leaves nothing open behind. After a failure the object is closed.
    """

    on_wait: Callable[[str], None] | None = None
    """Called with one line every WAIT_REPORT_S seconds while the policy is silent, by another thread; and as soon as a
    conversation that is ``patient`` begins to wait."""
    isolation: str | None = None
    """How far the policy's process is isolated (``serving.fence``); None before its start and for a policy on another
    host."""
    patient = False
    """Whether the calls before the first answer wait, within their deadline, for a server that accepts no connection or
    has lost it."""
    on_sent: Callable[[bytes], None] | None = None
    """Called with every message that has been sent to the policy."""
    on_received: Callable[[bytes | str], None] | None = None
    """Called with every frame that the policy sends as an answer, before it is decoded."""

    def __init__(self, policy: str, *, first_deadline_s: float, deadline_s: float) -> None:
        """``first_deadline_s`` [s] applies to the start, each reset and the first act, when models load; ``deadline_s``
        to every later act; BUDGET_S to all of them together."""
        self.policy = policy
        self._first_deadline_s, self._deadline_s = first_deadline_s, deadline_s
        self._left_s = BUDGET_S
        self._acted = False
        self._client: Client | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    @property
    def printed(self) -> str:
        """The last part of what the policy printed, if that can be known; complete after ``close``."""
        return ""

    def start(self) -> PolicyCard:
        """Connect, and return the policy's card.

        Raises UnreachableError if no server accepts a connection; so do ``reset`` and the first ``act`` of a
        conversation that is ``patient``. Raises ExhaustedError if this process gets no further process or thread.
        """
        return self._call("start", self._first_deadline_s, self._connect)

    def reset(self, instruction: str, session: Session) -> None:
        def step(left: Left) -> None:
            self._connected().reset(instruction, session, deadline_s=left())

        self._call("reset", self._first_deadline_s, step)

    def act(self, observation: Observation) -> ActReply:
        """Send one observation and return one chunk. ObservationError and ContractError are the harness's mistakes."""

        def step(left: Left) -> ActReply:
            return self._connected().act(observation, deadline_s=left())

        reply = self._call("act", self._deadline_s if self._acted else self._first_deadline_s, step)
        self._acted = True
        return reply

    def refuse(self, number: int, error: ActionError) -> NoReturn:
        """End the conversation because the trial does not accept action ``number`` of the last chunk."""
        with self._evidence("act"):
            raise PolicyError("action", f"actions[{number}].{error}")

    def close(self) -> None:
        """End the conversation, gracefully if the policy still answers. Further calls do nothing."""
        if self._client is not None:
            self._client.say_goodbye(deadline_s=GRACE_S)
        self._drop()

    @abstractmethod
    def _open(self, left: Left) -> Client:
        """Reach the policy within the seconds that are ``left``."""

    def _connect(self, left: Left) -> PolicyCard:
        self._client = self._open(left)
        self._client.connection.on_sent = self.on_sent
        self._client.connection.on_received = self.on_received
        return self._client.card(deadline_s=left())

    def _call(self, name: str, deadline_s: float, step: Callable[[Left], T]) -> T:
        with self._evidence(name), self._within(deadline_s) as left:
            return self._carried_out(step, left)

    # What follows is for subclasses, which know more than the connection does.

    def _carried_out(self, step: Callable[[Left], T], left: Left) -> T:
        return step(left)

    def _shown(self, text: str) -> str:
        """Make text that came from the policy fit for a terminal, a log or a recording."""
        return readable(text)

    def _hint(self, message: str) -> str:
        """Return what to append to the message of a failure whose remedy is known."""
        return ""

    def _cause(self, error: PolicyError) -> tuple[str, str, str]:
        """Return kind, message in place of the error's, and stack of a policy that hangs or crashed, if known."""
        return error.kind, "", ""

    def _drop(self) -> None:
        """Close everything, whatever state the other end is in."""
        client, self._client = self._client, None
        if client is not None:
            # The other end may be gone, and websockets may fail at the bytes that a dying process sent last.
            with suppress(Exception):
                client.connection.close()

    def _connected(self) -> Client:
        if self._client is None:
            raise RuntimeError(f"{type(self).__name__}: call start() first, and nothing after a failure or close()")
        return self._client

    @contextmanager
    def _within(self, deadline_s: float) -> Generator[Left, None, None]:
        """Yield the function that returns the seconds left for a call; report that the policy is silent. Afterwards,
        subtract the call's time from the budget."""
        started, allowed_s, over = time.monotonic(), min(deadline_s, self._left_s), threading.Event()

        def report(on_wait: Callable[[str], None]) -> None:
            while not over.wait(WAIT_REPORT_S):
                on_wait(f"waiting for the policy: {time.monotonic() - started:.0f} of {allowed_s:.0f} s")

        if self.on_wait is not None:
            # The call does not wait for the end of this thread, whose report may block, on a terminal for example.
            threading.Thread(target=report, args=(self.on_wait,), daemon=True).start()
        try:
            yield lambda: max(started + allowed_s - time.monotonic(), 0.0)
        except PolicyError as error:
            if error.kind == "timeout" and allowed_s < deadline_s:
                text = f"took more than {BUDGET_S:g} s of wall time in all its calls of one trial"
                raise PolicyError("timeout", text, notes=error.notes) from None
            raise
        finally:
            over.set()
            self._left_s = max(self._left_s - (time.monotonic() - started), 0.0)

    @contextmanager
    def _evidence(self, call: str) -> Generator[None, None, None]:
        """End the conversation if anything in the block fails; add to a PolicyError what is known about its cause."""
        try:
            yield
        except PolicyError as error:
            kind, end, stack = self._cause(error)
            why = end or str(error)[:EVIDENCE_CHARS].rstrip()
            self._drop()
            message = f"policy {self.policy!r} failed at {call}: {why}{self._hint(why)}{stack[:EVIDENCE_CHARS]}"
            if self.printed:
                message += f"\nit printed last:\n{self.printed[-EVIDENCE_CHARS // 2 :]}"
            failure = type(error) if kind == error.kind else PolicyError
            raise failure(kind, self._shown(message), notes=error.notes) from None
        except BaseException:
            self._drop()
            raise
