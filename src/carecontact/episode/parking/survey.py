"""Whether the robot can serve every seed of a protocol, and what had to be drawn again for that."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from carecontact.contract.protocol import Protocol
from carecontact.episode.parking.persons import Parked, parked
from carecontact.errors import SceneError


@dataclass(frozen=True, kw_only=True)
class Surveyed:
    """The result for one seed on one level."""

    seed: int
    salt: str
    found: Parked | None
    """The person and the bases; None if the seed is not feasible."""
    why: str = ""

    @property
    def draws(self) -> dict[str, int]:
        """Region -> number of draws of a base, including the one that serves."""
        return {} if self.found is None else {name: len(row) + 1 for name, row in self.found.refused.items()}

    @property
    def refused(self) -> Counter[str]:
        """Reason -> number of bases that were refused for it beside the accepted person."""
        rows = () if self.found is None else self.found.refused.values()
        return Counter(reason for row in rows for reason in row)


def survey(protocol: Protocol, seed: int, *, salt: str = "") -> Surveyed:
    """Draw the person and the bases of one seed, for a protocol whose variation parks the robot."""
    try:
        return Surveyed(seed=seed, salt=salt, found=parked(protocol, seed, salt=salt))
    except SceneError as error:
        return Surveyed(seed=seed, salt=salt, found=None, why=str(error))
