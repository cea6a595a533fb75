"""The answers of `carecontact protocol`."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from carecontact.cli.answers.answer import Answer, Part


class Listed(Part):
    id: str
    sha256: str
    frozen: bool
    description: str


class ProtocolListAnswer(Answer):
    kind: Annotated[Literal["carecontact-protocol-list-1"], Field(alias="schema")] = "carecontact-protocol-list-1"
    protocols: list[Listed]


class ProtocolShowAnswer(Answer):
    kind: Annotated[Literal["carecontact-protocol-show-1"], Field(alias="schema")] = "carecontact-protocol-show-1"
    id: str
    sha256: str
    frozen: bool
    lock: str | None
    """Name of the lock; null if there is none."""
    fields: dict[str, Any]
    """Every field of the protocol, with those that the file inherits or leaves at their defaults."""


class ProtocolVerifyAnswer(Answer):
    kind: Annotated[Literal["carecontact-protocol-verify-1"], Field(alias="schema")] = "carecontact-protocol-verify-1"
    id: str
    equal: bool
    """Whether the protocol has a lock and equals it."""
    differences: list[str]
    """In words for people; empty if it is equal or has no lock."""


class ProtocolLockAnswer(Answer):
    kind: Annotated[Literal["carecontact-protocol-lock-1"], Field(alias="schema")] = "carecontact-protocol-lock-1"
    id: str
    lock: str
    """Path of the lock that was written."""
