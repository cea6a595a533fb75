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
    """The differences in words for people; empty if the protocol is equal or has no lock."""


class ProtocolLockAnswer(Answer):
    kind: Annotated[Literal["carecontact-protocol-lock-1"], Field(alias="schema")] = "carecontact-protocol-lock-1"
    id: str
    lock: str
    """Path of the lock that was written."""


class RejectedPerson(Part):
    """A person who was drawn and rejected, because the robot cannot serve one region on one of the levels."""

    comfort_arm_deg: float
    shoulder_rotation_deg: float
    palm_deg: float
    region: str
    """The region that cannot be served; empty if the person did not come to rest."""
    refused: dict[str, int]
    """Reason -> number of bases that were refused for it."""


class FeasibleSeed(Part):
    seed: int
    salted: bool
    feasible: bool
    body: str | None
    draws: dict[str, int]
    """Region -> number of draws of a base, including the one that serves."""
    refused: dict[str, int]
    """Reason -> number of bases that were refused for it beside the accepted person."""
    rejected: list[RejectedPerson]
    """The persons who were rejected before this one."""


class ProtocolFeasibleAnswer(Answer):
    kind: Annotated[Literal["carecontact-protocol-feasible-1"], Field(alias="schema")] = (
        "carecontact-protocol-feasible-1"
    )
    id: str
    """Id of the protocol, with its level."""
    feasible: bool
    """Whether every seed is feasible."""
    seeds: list[FeasibleSeed]
