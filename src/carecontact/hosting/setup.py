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
