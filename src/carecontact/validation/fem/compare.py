"""Both answers beside each other, for every skin of the published range."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from carecontact.validation.fem import judge, simulated
from carecontact.validation.fem.answer import Answer
from carecontact.validation.fem.cases import CASES, DEPTHS_M, DIMPLE_M, LATE_TOUCH_N, Case
from carecontact.validation.fem.judge import Ground
from carecontact.validation.fem.materials import MIDDLE, OTHER_POISSON, PLAIN, SKINS
from carecontact.validation.result import Array
from carecontact.validation.subject import Subject

CLOSE_PERCENT = 10.0
"""Of the nearest end of the finite elements' range: what counts as agreement in the table."""
TOLD = [1, 4]
"""Which of DEPTHS_M the table tells of: 1 and 4 mm."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One quantity of one region."""

    region: str
    name: str
    unit: str
    skins: tuple[float, ...]
    """Of the layer with each of SKINS; the first is the middle one."""
    plain: float
    """Of the layer without skin."""
    simulated: float

    @property
    def outside_percent(self) -> float:
        """How far the simulated value lies outside the range of the skins; 0: inside."""
        low, high = min(self.skins), max(self.skins)
        nearest = min(max(self.simulated, low), high)
        return 100 * abs(self.simulated - nearest) / abs(nearest)

    @property
    def agrees(self) -> bool:
        return self.outside_percent <= CLOSE_PERCENT


@dataclass(frozen=True, kw_only=True)
class Comparison:
    case: Case
    ground: Ground
    plain: Answer
    skins: tuple[Answer, ...]
    """In the order of SKINS."""
    simulated: Answer
    extras: Mapping[str, float]
    """Numbers of the finite elements alone, by name."""

    def rows(self) -> list[Row]:
        """The table's rows of this region."""
        return [row for name, unit, measure in _measures(self.case) for row in self._rows(name, unit, measure)]

    def _rows(self, name: str, unit: str, measure: Callable[[Answer], Mapping[str, float]]) -> list[Row]:
        skins = [measure(answer) for answer in self.skins]
        plain, here = measure(self.plain), measure(self.simulated)
        return [
            Row(region=self.case.region, name=name.format(key), unit=unit, skins=tuple(s[key] for s in skins),
                plain=plain[key], simulated=here[key])
            for key in here
        ]  # fmt: skip


def compare(subject: Subject, *, on_region: Callable[[Comparison], None] = lambda done: None) -> list[Comparison]:
    """Press every case's indenters into finite elements and into the person; called after each: ``on_region``.

    Raises what the bench and the finite elements raise where they find no answer.
    """
    found = []
    for case in CASES:
        shell = subject.scene(case.region).regions[case.region].shell
        radius = shell.radius_m if case.limb else None
        ground = Ground(thickness_m=subject.tissue(case.region).thickness_m, limb_radius_m=radius)
        done = Comparison(
            case=case, ground=ground, plain=judge.answer(case, PLAIN, ground),
            skins=tuple(judge.answer(case, skin, ground) for skin in SKINS), simulated=simulated.answer(subject, case),
            extras=_extras(case, ground),
        )  # fmt: skip
        found.append(done)
        on_region(done)
    return found


def _extras(case: Case, ground: Ground) -> dict[str, float]:
    """What friction at its most, and another Poisson's ratio, would change for the middle skin."""
    out = {"force of the 10 mm ball without slip over the frictionless one": judge.sticking_gain(case, MIDDLE, ground)}
    for poisson in OTHER_POISSON:
        other = judge.answer(case, MIDDLE, replace(ground, poisson=poisson))
        for word in ("ball", "disc"):
            exponent = float(other.exponents(word)[-1])
            out[f"exponent over the radius, {word}, {1000 * DEPTHS_M[-1]:g} mm, Poisson's ratio {poisson}"] = exponent
    return out


def _measures(case: Case) -> list[tuple[str, str, Callable[[Answer], Mapping[str, float]]]]:
    def by_depth(values: Array, pick: list[int] = TOLD) -> dict[str, float]:
        return {f"{1000 * DEPTHS_M[k]:g}": float(values[k]) for k in pick}

    others = [
        name for name in case.indenters() if name != case.main() and name in ("ball 10.0 mm", "disc 10.7 mm", "cap")
    ]
    return [
        (f"force, {case.main()}, {{}} mm deep", "N", lambda a: by_depth(a.curves[case.main()].at(DEPTHS_M))),
        ("share of the 4 mm force at {} mm", "", lambda a: by_depth(a.shares(case), [0, 1, 2, 3])),
        ("the same with a touch at 0.1 N, {} mm", "",
         lambda a: by_depth(a.shares(case, touch_n=LATE_TOUCH_N), [0, 1, 2, 3])),
        *((f"force, {name}, {{}} mm deep", "N", lambda a, name=name: by_depth(a.curves[name].at(DEPTHS_M)))
          for name in others),
        ("exponent over the radius, ball, {} mm deep", "", lambda a: by_depth(a.exponents("ball"), [1, 2, 4])),
        ("exponent over the radius, disc, {} mm deep", "", lambda a: by_depth(a.exponents("disc"), [1, 2, 4])),
        (f"dimple, {case.main()}, {{}} mm from its axis", "",
         lambda a: {f"{1000 * r:g}": float(v) for r, v in zip(DIMPLE_M, a.dimple(DIMPLE_M), strict=True)}),
    ]  # fmt: skip


def as_json(comparisons: list[Comparison]) -> dict[str, object]:
    """Every number of the table, the materials behind it, and each layer's modulus."""
    return {
        "schema": "carecontact-fem-1",
        "skins": [{"name": s.name, "thickness_m": s.thickness_m, "modulus_pa": s.modulus_pa} for s in SKINS],
        "regions": {
            done.case.region: {
                "thickness_m": done.ground.thickness_m, "limb_radius_m": _rounded(done.ground.limb_radius_m),
                "poisson": done.ground.poisson, "tissue_pa": [_rounded(a.modulus_pa) for a in done.skins],
                "tissue_pa_plain": _rounded(done.plain.modulus_pa),
                "finite_elements_alone": {name: _rounded(value) for name, value in done.extras.items()},
                "rows": [_row_json(row) for row in done.rows()],
            }
            for done in comparisons
        },
    }  # fmt: skip


def _row_json(row: Row) -> dict[str, object]:
    return {
        "name": row.name, "unit": row.unit, "skins": [_rounded(value) for value in row.skins],
        "plain": _rounded(row.plain), "simulated": _rounded(row.simulated),
        "outside_percent": _rounded(row.outside_percent),
    }  # fmt: skip


def _rounded(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else float(f"{value:.4g}")
