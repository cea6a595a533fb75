"""What differs between the versions of the simulated person that a protocol can name (``Person.version``).

A frozen protocol keeps its version, so that its trials come out bit for bit as they did. Improvements of the person go
into the newest version, which drafts use.
"""

from __future__ import annotations

from dataclasses import dataclass

from carecontact.contract.protocol.person import PersonVersion


@dataclass(frozen=True, kw_only=True)
class Build:
    """The choices of one version. The defaults are those of person-v1."""

    layer_m: float = 0.0
    """Depth in the contact layer at which its pressure is twice that of a linear layer, [m]. 0: the layer is linear."""
    entry_m: float = 0.0
    """Depth over which skin that a tool meets from the side comes to bear, [m]. 0: such skin bears nothing."""


BUILDS: dict[PersonVersion, Build] = {
    "person-v1": Build(),
    "person-v2": Build(layer_m=0.0015, entry_m=0.004),
}
"""Version -> its choices."""
