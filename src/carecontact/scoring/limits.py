"""Packs of limits: the force or pressure that a segment may bear, its source, and how certain it is.

Packages add packs through the entry-point group ``carecontact.limit_packs``. A pack that changes gets a new id.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

from carecontact.protocol.sections import sideless
from carecontact.registry import Registry

UNCHECKED = "*"
"""Ends the title of whatever rests on limits that are ``to be checked``; ``footnote`` says what it means."""


@dataclass(frozen=True, kw_only=True)
class LimitPack:
    id: str
    title: str
    source: str
    status: Literal["as published", "to be checked"]
    """``to be checked``: entered from secondary sources; every page that shows a number of it states this."""
    unit: Literal["N", "Pa"] = "N"
    limits: Mapping[str, float]
    """Segment without its side -> limit [unit]."""

    def limit(self, segment: str) -> float:
        """Limit of a segment [unit]; one that the pack does not name takes the strictest entry."""
        return self.limits.get(sideless(segment), min(self.limits.values()))


def footnote(titles: Iterable[str]) -> str:
    """Return the line that belongs under a table with these titles; empty where none of them ends with UNCHECKED."""
    if not any(title.endswith(UNCHECKED) for title in titles):
        return ""
    return f"{UNCHECKED} from secondary sources: these limits still have to be checked against the standard"


LIMIT_PACKS: Registry[LimitPack] = Registry("limit pack", row=LimitPack, plural="limit_packs")

for _pack in (
    LimitPack(
        id="behrens-2021-table-8",
        title="Pain onset by pinching, Behrens et al. 2021, Table 8",
        source="Behrens et al. 2021, Table 8: forearm muscle, deltoid muscle, abdominal muscle",
        status="as published",
        limits={"forearm": 100.0, "upper_arm": 100.0, "abdomen": 60.0},
    ),
    LimitPack(
        id="iso-ts-15066-2016",
        title=f"Quasi-static force, ISO/TS 15066:2016{UNCHECKED}",
        source="ISO/TS 15066:2016, Table A.2, F_QS, entered from secondary transcriptions. A lying person cannot give "
        "way, so the quasi-static limit applies and not the transient one. Head: the face's, which is stricter than "
        "the skull's; feet are not in the table and take the strictest entry",
        status="to be checked",
        limits={
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
    LimitPack(
        id="iso-ts-15066-2016-pressure",
        title=f"Quasi-static pressure, ISO/TS 15066:2016{UNCHECKED}",
        source="ISO/TS 15066:2016, Table A.2, P_S (1 N/cm^2 is 10 kPa), entered from secondary "
        "transcriptions; the least of a segment's places: deltoid, forearm muscle, sternum, pelvic bone, abdominal "
        "muscle, thigh muscle, calf muscle",
        status="to be checked",
        unit="Pa",
        limits={
            "upper_arm": 1.9e6,
            "forearm": 1.8e6,
            "thorax": 1.2e6,
            "abdomen": 1.4e6,
            "pelvis": 2.1e6,
            "thigh": 2.5e6,
            "shank": 2.1e6,
        },
    ),
):
    LIMIT_PACKS.register(_pack.id, _pack)
