"""The finite elements' results as a small file, so that a tissue can be compared in seconds without solving anything.

``tools/fem_table.py`` writes it. To compare another tissue, read ``standards()``, compute that tissue's response to the
same tools, and ask each standard how far the quantity lies outside.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from importlib.resources import files

import numpy as np

from carecontact.validation.fem.answer import Answer
from carecontact.validation.fem.cases import CASES, TOUCH_N, Case
from carecontact.validation.fem.materials import FRICTION, MATCHED_M, POISSON, SKINS
from carecontact.validation.fem.quantities import POINTS, quantities

FILE = "standards.json"
SCHEMA = "carecontact-fem-standards-1"


@dataclass(frozen=True, kw_only=True)
class Standard:
    """One quantity of one region by finite elements."""

    region: str
    name: str
    unit: str
    skins: tuple[float, ...]
    """Values with each of SKINS; the first is the middle one."""
    plain: float
    """Value without skin."""

    def outside_percent(self, value: float) -> float:
        """Return how far a value lies outside the range of the skins; 0 means inside."""
        low, high = min(self.skins), max(self.skins)
        nearest = min(max(value, low), high)
        return abs(value - nearest) * (1 if self.unit == POINTS else 100 / abs(nearest))


def made(case: Case, plain: Answer, skins: tuple[Answer, ...]) -> list[Standard]:
    """Make the standards of one case. ``skins``: answers in the order of SKINS."""
    return [
        Standard(region=case.region, name=quantity.name, unit=quantity.unit, plain=rounded(quantity.of(plain)),
                 skins=tuple(rounded(quantity.of(answer)) for answer in skins))
        for quantity in quantities(case)
    ]  # fmt: skip


def standards() -> list[Standard]:
    """Return the stored standards, of CASES with their own grounds."""
    stored = json.loads((files("carecontact.validation.fem") / FILE).read_text())
    return [
        Standard(region=region, name=name, unit=unit, skins=tuple(skins), plain=plain)
        for region, held in stored["regions"].items()
        for name, unit, plain, *skins in held["rows"]
    ]


def as_text(found: dict[str, tuple[Answer, tuple[Answer, ...]]]) -> str:
    """Return the file's text, with a line for each quantity, from each region's answers without skin and with each of
    SKINS.
    """
    head = {
        "schema": SCHEMA, "written_by": "tools/fem_table.py", "columns": ["name", "unit", "no skin", *names()],
        "skins": {s.name: {"thickness_m": s.thickness_m, "modulus_pa": s.modulus_pa} for s in SKINS},
        "poisson": POISSON, "friction": FRICTION, "touch_n": TOUCH_N, "matched_m": MATCHED_M,
        "sources": "skin, Poisson's ratio, friction: materials.py; grounds: cases.py; published curves: "
                   "validation/reference.py",
    }  # fmt: skip
    regions = []
    for case in CASES:
        plain, skins = found[case.region]
        about = {
            "thickness_m": case.ground.thickness_m, "limb_radius_m": case.ground.limb_radius_m,
            "published": case.reference.name, "tool": case.main.name,
            "tissue_pa": [rounded(answer.modulus_pa) for answer in (plain, *skins)],
        }  # fmt: skip
        rows = [json.dumps([s.name, s.unit, s.plain, *s.skins]) for s in made(case, plain, skins)]
        lines = ",\n   ".join(rows)
        regions.append(f' "{case.region}": {{{json.dumps(about)[1:-1]},\n  "rows": [\n   {lines}]}}')
    return f'{{{json.dumps(head)[1:-1]},\n"regions": {{\n' + ",\n".join(regions) + "}}\n"


def names() -> list[str]:
    return [skin.name for skin in SKINS]


def rounded(value: float) -> float:
    """Round to four digits."""
    return float(f"{value:.4g}") if np.isfinite(value) else value
