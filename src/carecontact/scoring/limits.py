"""Packs of force limits: the force that a segment may bear, its source, and how certain it is.

Packages add packs through the entry-point group ``carecontact.limit_packs``. A pack that changes gets a new id.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from carecontact.contract.protocol import sideless
from carecontact.registry import Registry


@dataclass(frozen=True, kw_only=True)
class LimitPack:
    id: str
    title: str
    source: str
    status: Literal["as published", "to be checked"]
    """``to be checked``: entered from secondary sources; whoever shows a number of it says so."""
    limit_n: Mapping[str, float]
    """Segment without its side -> limit [N]."""

    def limit(self, segment: str) -> float:
        """Limit of a segment [N]; one that the pack does not name takes the strictest entry."""
        return self.limit_n.get(sideless(segment), min(self.limit_n.values()))


LIMIT_PACKS: Registry[LimitPack] = Registry("limit pack", row=LimitPack, plural="limit_packs")

LIMIT_PACKS.register(
    "behrens-2021-table-8",
    LimitPack(
        id="behrens-2021-table-8",
        title="Pain onset by pinching, Behrens et al. 2021, Table 8",
        source="Behrens et al. 2021, Table 8: forearm muscle, deltoid muscle, abdominal muscle",
        status="as published",
        limit_n={"forearm": 100.0, "upper_arm": 100.0, "abdomen": 60.0},
    ),
)

LIMIT_PACKS.register(
    "iso-ts-15066-2016",
    LimitPack(
        id="iso-ts-15066-2016",
        title="Quasi-static force, ISO/TS 15066:2016 (to be checked against the standard)",
        source="ISO/TS 15066:2016, Table A.2, F_QS, entered from secondary transcriptions. A lying person cannot give "
        "way, so the quasi-static limit applies and not the transient one. Head: the face's, which is stricter than "
        "the skull's; feet are not in the table and take the strictest entry",
        status="to be checked",
        limit_n={
            "head": 65.0,
            "neck": 150.0,
            "thorax": 140.0,
            "abdomen": 110.0,
            "pelvis": 180.0,
            "upper_arm": 150.0,
            "forearm": 160.0,
            "hand": 140.0,
            "thigh": 220.0,
            "shank": 130.0,
        },
    ),
)
