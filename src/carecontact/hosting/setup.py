"""What hosting needs to start or reach one policy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Self

from carecontact.contract.policy_ref import PolicyRef
from carecontact.errors import ConfigError
from carecontact.hosting.dialects.options import check_options


@dataclass(frozen=True, kw_only=True)
class PolicySetup:
    """A policy and everything that its process is given. It crosses process boundaries as JSON, on a pipe."""

    ref: PolicyRef
    search_path: tuple[str, ...] = ()
    """Folders in which ``module:Class`` is looked for before the installed packages."""
    arguments: Mapping[str, str] = field(default_factory=dict[str, str])
    """For the constructor or factory, as text; its annotations say what each becomes (``hosting.arguments``)."""
    environment: Mapping[str, str] = field(default_factory=dict[str, str], repr=False)
    """Variables that the process has besides the usual ones (``hosting.process``)."""
    language: str | None = None
    """For the argument ``language``: rules-v1, replay:FILE.jsonl or live:MODEL. It is not one of ``arguments``, which
    stand in recordings: the card's ``language_backend`` names it, by a file's content and not by its place."""
    record: str | None = None
    """For the argument ``record``: file to which the completions of a live model are added. In no recording either."""
    readable: tuple[str, ...] = ()
    """Files and folders that its isolated process may read besides what programs need and what belongs to it."""
    writable: tuple[str, ...] = ()
    """Files and folders that it may read and write besides its own temporary folder."""
    closed: tuple[str, ...] = ()
    """Folders that stay closed to it wherever they lie: those of runs."""
    isolated: bool = True
    """False only to measure what isolation costs and closes."""

    @classmethod
    def of(cls, policy: str, *, search_path: Sequence[str] = (), arguments: Mapping[str, str] | None = None) -> Self:
        """Make the setup of a policy as the user writes it. Raises ConfigError for a malformed reference."""
        return cls(ref=PolicyRef.parse(policy), search_path=tuple(search_path), arguments=arguments or {})

    def __post_init__(self) -> None:
        """Raises ConfigError for a remote policy that is given anything, and for unknown options of its address."""
        given = self.arguments or self.environment or self.language or self.record or self.readable or self.writable
        if self.ref.kind == "remote" and given:
            where = "`carecontact serve` there" if self.ref.scheme == "ws" else "the server itself"
            raise ConfigError(
                f"policy {self.ref}: --policy-arg, --policy-env, --policy-read, --policy-write, --language and "
                f"--record do not reach another host; give them to {where}"
            )
        check_options(self.ref)
