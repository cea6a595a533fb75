"""The regions of the body that a task can name: one file each, plain data, found by name in REGIONS."""

from carecontact.regions.anatomy import JOINTS, SEGMENTS
from carecontact.regions.region import (
    REGIONS,
    STANDARD_REGIONS,
    Belly,
    LimbSight,
    Region,
    TrunkSight,
    Tube,
    all_regions,
)

__all__ = [
    "JOINTS",
    "REGIONS",
    "SEGMENTS",
    "STANDARD_REGIONS",
    "Belly",
    "LimbSight",
    "Region",
    "TrunkSight",
    "Tube",
    "all_regions",
]
