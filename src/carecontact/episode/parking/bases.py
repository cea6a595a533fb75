"""Draws places for the robot's base until one serves."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from carecontact.contract.protocol import Parking
from carecontact.episode.parking.grounds import Base, Ground, Refusal

NEAREST_STEP = 0.005
"""Share of the whole range by which, for parking ``nearest``, the range of the draws grows with each further draw."""


@dataclass(frozen=True, kw_only=True)
class Search:
    base: Base | None
    """The base that serves; None if no draw served."""
    refused: tuple[Refusal, ...]
    """Why each earlier draw was refused."""


def search(
    ground: Ground, region: str, parking: Parking, *, place: np.random.Generator, height: np.random.Generator
) -> Search:
    """Judge draws of a base until one serves the region.

    ``place``, ``height``: random streams; each draw uses its own part of both.
    """
    refused: list[Refusal] = []
    for base in draws(parking, region, place=place, height=height):
        reason = ground.refusal(base, region)
        if reason is None:
            return Search(base=base, refused=tuple(refused))
        refused.append(reason)
    return Search(base=None, refused=tuple(refused))


def draws(parking: Parking, region: str, *, place: np.random.Generator, height: np.random.Generator) -> Iterator[Base]:
    """Yield as many bases as the protocol tries, in their order."""
    level, upright = _of_region(place, region), _of_region(height, region)
    middle, spread = np.array(parking.centre_m), np.array(parking.spread_m)
    for number in range(parking.tries):
        x, y, turn = level.uniform(-1.0, 1.0, 3)
        z = upright.uniform(-1.0, 1.0)
        reach = min(1.0, NEAREST_STEP * number) if parking.manner == "nearest" else 1.0
        at = middle + reach * np.array([x, y, z]) * spread
        yield Base(
            position_m=(float(at[0]), float(at[1]), float(at[2])),
            yaw_deg=float(parking.centre_yaw_deg + reach * turn * parking.spread_yaw_deg),
        )


def _of_region(stream: np.random.Generator, region: str) -> np.random.Generator:
    """Return a generator for one region alone, so that its draws do not depend on how many draws another region
    needed.
    """
    words = np.frombuffer(hashlib.sha256(region.encode()).digest(), "<u4").tolist()
    return np.random.default_rng([*stream.integers(2**32, size=4).tolist(), *words])
