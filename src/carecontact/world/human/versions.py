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
    """Way of a tool over which skin that it has not pressed comes to bear, by a factor of e, [m]. 0: beside an upright
    wall such skin bears nothing, and once the wall is no longer upright to it, all at once. Chosen for a cap that
    scrubs the abdomen with 15 N: with 2 to 3 mm its force rattles, and with 8 mm its mean is 10 to 15 % off the one
    asked for."""
    parted: bool = False
    """Whether the hulls of neighbouring plates meet in planes (``parting``). False: they overlap, and both plates carry
    what lies there."""
    inner_sides: bool = False
    """Whether flank and thigh of the side away from the robot give way sideways too. False: their inner side, which a
    tool can reach over the abdomen and between the legs, is rigid to a push from the robot's side."""
    belly_floor: bool = False
    """Whether the bone under the abdomen's soft region gives way on a plate. False: it is rigid."""
    breath_margin_m: float | None = None
    """How far the visible skin makes all of a breath's movement beyond the abdomen's soft region and beyond what the
    chest's plates carry, [m]. None: its movement fades by shares of the body's breadth, also over parts of both."""


BUILDS: dict[PersonVersion, Build] = {
    "person-v1": Build(),
    "person-v2": Build(
        layer_m=0.0015, entry_m=0.006, parted=True, inner_sides=True, belly_floor=True, breath_margin_m=0.015
    ),
}
"""Version -> its choices."""
