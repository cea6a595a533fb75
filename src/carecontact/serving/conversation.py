"""How a run sets a policy up, and the conversation with it: deadlines, answers, and what its failures mean."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from types import TracebackType
from typing import NoReturn, Self, TypeVar

from carecontact.errors import ActionError, ConfigError, PolicyError
from carecontact.interface.observation import Observation
from carecontact.interface.policy import PolicyCard, PolicyRef
from carecontact.interface.robot import Session
from carecontact.serving.client import ActReply, Client
from carecontact.serving.dialect import check_options

# What hosting needs to start or reach one policy.


@dataclass(frozen=True, kw_only=True)
class PolicySetup:
    """A policy and everything that its process is given. It crosses process boundaries as JSON, on a pipe."""

    ref: PolicyRef
    search_path: tuple[str, ...] = ()
    """Folders in which ``module:Class`` is looked for before the installed packages."""
    arguments: Mapping[str, str] = field(default_factory=dict[str, str])
    """Texts for the constructor or factory, whose annotations decide what each becomes (``hosting.arguments``)."""
    environment: Mapping[str, str] = field(default_factory=dict[str, str], repr=False)
    """Environment variables of the process besides the usual ones (``hosting.process``)."""
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
    """Folders that stay closed to it even inside one that it may read: those of runs. The folder of what is kept
    between trials (``world.kept``) is closed as well."""
    isolated: bool = True
    """False only to measure what isolation costs and closes."""

    @classmethod
    def of(cls, policy: str, *, search_path: Sequence[str] = (), arguments: Mapping[str, str] | None = None) -> Self:
        """Make the setup of a policy as the user writes it. Raises ConfigError for a malformed reference."""
        return cls(ref=PolicyRef.parse(policy), search_path=tuple(search_path), arguments=arguments or {})

    def __post_init__(self) -> None:
        """Raise ConfigError for a remote policy that is given anything of this, and for unknown options in its
        address.
        """
        given = self.arguments or self.environment or self.language or self.record or self.readable or self.writable
        if self.ref.kind == "remote" and given:
            where = "`carecontact serve` there" if self.ref.scheme == "ws" else "the server itself"
            raise ConfigError(
                f"policy {self.ref}: --policy-arg, --policy-env, --policy-read, --policy-write, --language and "
                f"--record do not reach another host; give them to {where}"
            )
        check_options(self.ref)


# One trial's conversation with a policy, wherever it runs: the order of the calls, their deadlines, and the messages
# when one fails.

GRACE_S = 1.0
"""Time [s] that a policy has for ending after it was asked to."""
EVIDENCE_CHARS = 4000
GONE = ("died", "killed")
"""Kinds of failure of a policy whose process is gone."""
WAIT_REPORT_S = 10.0
"""Interval [s] at which a silent policy is reported."""
BUDGET_S = 3600.0
"""Wall time that a policy may take in one trial, all calls together: 2.4 s for each of the 1,500 calls that 30 s at
50 Hz can hold. It is in the code and in no protocol, because it only keeps a trial from reaching the supervisor's
limit, which would count as a harness error."""

T = TypeVar("T")
Left = Callable[[], float]
"""Returns the seconds until the deadline of a call, never below 0."""


def readable(text: str) -> str:
    """Return text of a policy in a form that is safe for a terminal, a log or a page: control characters other than
    line ends and tabs are escaped.
    """
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
    """How far the policy's process is isolated (``isolation.fence``); None before its start and for a policy on another
    host."""
    patient = False
    """Whether the calls before the first answer wait, within their deadline, for a server that accepts no connection or
    has lost it."""

    on_sent: Callable[[bytes], None] | None = None
    """Called with every message that has been sent to the policy."""

    on_received: Callable[[bytes | str], None] | None = None
    """Called with every frame that the policy sends as an answer, before it is decoded."""

    def __init__(self, policy: str, *, first_deadline_s: float, deadline_s: float, budget_s: float = BUDGET_S) -> None:
        """Prepare a conversation without starting it.

        ``first_deadline_s`` [s] applies to the start, each reset and the first act, when models load; ``deadline_s`` to
        every later act; ``budget_s`` to all of them together.
        """
        self.policy = policy
        self._first_deadline_s, self._deadline_s = first_deadline_s, deadline_s
        self._budget_s = self._left_s = budget_s
        self._acted = False
        self._client: Client | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    @property
    def printed(self) -> str:
        """The last part of what the policy wrote to stdout and stderr, if that can be known; complete after
        ``close``.
        """
        return ""

    def start(self) -> PolicyCard:
        """Connect, and return the policy's card.

        Raises UnreachableError if no server accepts a connection; so do ``reset`` and the first ``act`` of a
        conversation that is ``patient``. Raises ExhaustedError if this process gets no further process or thread.
        """
        with self._evidence("start"), self._within(self._first_deadline_s) as left:
            return self._carried_out(self._connect, left)

    def reset(self, instruction: str, session: Session) -> None:
        def step(left: Left) -> None:
            self._connected().reset(instruction, session, deadline_s=left())

        with self._evidence("reset"), self._within(self._first_deadline_s) as left:
            self._carried_out(step, left)

    def act(self, observation: Observation) -> ActReply:
        """Send one observation and return one chunk. ObservationError and ContractError are mistakes of the
        harness.
        """

        def step(left: Left) -> ActReply:
            return self._connected().act(observation, deadline_s=left())

        with self._evidence("act"), self._within(self._deadline_s if self._acted else self._first_deadline_s) as left:
            reply = self._carried_out(step, left)
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

    def _carried_out(self, step: Callable[[Left], T], left: Left) -> T:
        """Take one step of the conversation within the seconds that are ``left``."""
        return step(left)

    def _shown(self, text: str) -> str:
        """Make text that came from the policy fit for a terminal, a log or a recording."""
        return readable(text)

    def _hint(self, message: str) -> str:
        """Return what to append to the message of a failure whose remedy is known."""
        return ""

    def _kind(self, error: PolicyError) -> str:
        """Return the kind of a failure, which may be known better than from the connection alone."""
        return error.kind

    def _how_it_ended(self) -> str:
        """Return how a policy that is gone ended, to replace the message of its failure; empty if that is unknown."""
        return ""

    def _where(self, kind: str) -> str:
        """Return what to append to the message of a failure of this kind: the stack of a policy that hangs or has
        crashed.
        """
        return ""

    def _drop(self) -> None:
        """Close everything, whatever state the other end is in."""
        client, self._client = self._client, None
        if client is not None:
            # The other end may be gone, and websockets may fail at the bytes that a dying process sent last.
            with suppress(Exception):
                client.disconnect()

    def _connected(self) -> Client:
        if self._client is None:
            raise RuntimeError(f"{type(self).__name__}: call start() first, and nothing after a failure or close()")
        return self._client

    @contextmanager
    def _within(self, deadline_s: float) -> Generator[Left, None, None]:
        """Yield the function that returns the seconds left for a call; afterwards, subtract the call's time from the
        budget.
        """
        started, allowed_s = time.monotonic(), min(deadline_s, self._left_s)
        try:
            with self._reported_wait(allowed_s):
                yield lambda: max(started + allowed_s - time.monotonic(), 0.0)
        except PolicyError as error:
            if error.kind == "timeout" and allowed_s < deadline_s:
                raise PolicyError(
                    "timeout", f"took more than {self._budget_s:g} s of wall time in all its calls of one trial",
                    notes=error.notes,
                ) from None  # fmt: skip
            raise
        finally:
            self._left_s = max(self._left_s - (time.monotonic() - started), 0.0)

    @contextmanager
    def _reported_wait(self, allowed_s: float) -> Generator[None, None, None]:
        report, started, over = self.on_wait, time.monotonic(), threading.Event()
        if report is None:
            yield
            return

        def repeat() -> None:
            while not over.wait(WAIT_REPORT_S):
                report(f"waiting for the policy: {time.monotonic() - started:.0f} of {allowed_s:.0f} s")

        # Nobody waits for its end: to report something may block, on a terminal for example.
        threading.Thread(target=repeat, daemon=True).start()
        try:
            yield
        finally:
            over.set()

    @contextmanager
    def _evidence(self, doing: str) -> Generator[None, None, None]:
        """End the conversation if anything fails inside the block; add to a PolicyError what is known about its
        cause.
        """
        try:
            yield
        except PolicyError as error:
            kind = self._kind(error)
            said = (self._how_it_ended() if kind in GONE else "") or str(error)[:EVIDENCE_CHARS].rstrip()
            where = self._where(error.kind)[:EVIDENCE_CHARS]
            self._drop()
            message = f"policy {self.policy!r} failed at {doing}: {said}{self._hint(said)}{where}"
            if self.printed:
                message += f"\nit printed last:\n{self.printed[-EVIDENCE_CHARS // 2 :]}"
            failure = type(error) if kind == error.kind else PolicyError
            raise failure(kind, self._shown(message), notes=error.notes) from None
        except BaseException:
            self._drop()
            raise
