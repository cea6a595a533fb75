"""The regions of the body that a task can name: one file each, plain data, found by name in REGIONS."""

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
    "REGIONS",
    "STANDARD_REGIONS",
    "Belly",
    "LimbSight",
    "Region",
    "TrunkSight",
    "Tube",
    "all_regions",
]
