"""Compares both answers, for every skin of the published range."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from carecontact.validation.fem import judge, simulated
from carecontact.validation.fem.answer import Answer
from carecontact.validation.fem.cases import BESIDE_M, CASES, DEPTHS_M, TOUCH_N, Case
from carecontact.validation.fem.ground import Ground
from carecontact.validation.fem.hexahedra import Block
from carecontact.validation.fem.judge import MARGIN, Sample
from carecontact.validation.fem.materials import MATCHED_M, MIDDLE, OTHER_FRICTION, OTHER_POISSON, PLAIN, SKINS
from carecontact.validation.fem.quantities import quantities
from carecontact.validation.fem.table import Standard, made, rounded
from carecontact.validation.subject import Subject

CLOSE_PERCENT = 10.0
"""Largest distance from the nearest end of the finite elements' range that the table counts as agreement."""
SECOND_SIDE_M = 0.003
"""Side of the hexahedra of the second method."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One quantity of one region, by finite elements and by the simulator."""

    standard: Standard
    simulated: float

    @property
    def outside_percent(self) -> float:
        """How far the simulated value lies outside the range of the skins; 0 means inside."""
        return self.standard.outside_percent(self.simulated)

    @property
    def agrees(self) -> bool:
        return self.outside_percent <= CLOSE_PERCENT


@dataclass(frozen=True, kw_only=True)
class Comparison:
    case: Case
    """The case, with the ground of the body that is compared."""
    plain: Answer
    skins: tuple[Answer, ...]
    """Answers in the order of SKINS."""
    simulated: Answer
    extras: Mapping[str, float]
    """Further numbers of the finite elements, by name."""

    def rows(self) -> list[Row]:
        """Return this region's rows of the table."""
        standards = made(self.case, self.plain, self.skins)
        return [
            Row(standard=standard, simulated=quantity.of(self.simulated))
            for standard, quantity in zip(standards, quantities(self.case), strict=True)
        ]


def compare(subject: Subject, *, on_region: Callable[[Comparison], None] = lambda done: None) -> list[Comparison]:
    """Press and drag every case's tools over finite elements and over the person; ``on_region`` is called after each
    case.

    Raises what the bench and the finite elements raise if they find no answer.
    """
    found = []
    for standard in CASES:
        case = replace(standard, ground=simulated.ground(subject, standard))
        plain, skins = judged(case)
        done = Comparison(
            case=case, plain=plain, skins=skins, simulated=simulated.answer(subject, case),
            extras=_extras(case, skins[SKINS.index(MIDDLE)]),
        )  # fmt: skip
        found.append(done)
        on_region(done)
    return found


def judged(case: Case) -> tuple[Answer, tuple[Answer, ...]]:
    """Return the finite elements' answers without skin and with each of SKINS, without using the simulator."""
    return judge.answer(case, PLAIN), tuple(judge.answer(case, skin) for skin in SKINS)


def _extras(case: Case, middle: Answer) -> dict[str, float]:
    """Return further numbers for the middle skin: those of a second method, and the changes by another Poisson's ratio
    and another friction.
    """
    sample = judge.sample(case, MIDDLE, middle)
    name = case.main.name
    out = {f"force of the {name} at 4 mm by hexahedra over the table's": _second(case, sample)}
    for tool in case.gliding():
        drag = middle.drags[tool.name]
        out[f"{tool.name}, 4 mm deep: radius of a circle as large as the touched area (mm)"] = (
            1000 * drag.contact_radius_m
        )
    for poisson in OTHER_POISSON:
        ground: Ground = replace(case.ground, poisson=poisson)
        other = judge.answer(replace(case, ground=ground), MIDDLE)
        for word in ("ball", "disc"):
            out[f"exponent over the radius, {word}s, 4 mm deep, Poisson's ratio {poisson}"] = float(
                other.exponents(case, word)[-1]
            )
        out[f"along, {name}: stiffness while stuck (N/mm), Poisson's ratio {poisson}"] = (
            other.drags[name].stuck_n_m / 1000
        )
        if case.ground.limb_radius_m is not None:
            for distance, share in zip(BESIDE_M, other.beside_at(BESIDE_M), strict=True):
                where = f"{name}, {1000 * distance:g} mm from its axis"
                out[f"dimple around the limb, {where}, Poisson's ratio {poisson}"] = float(share)
    travel = middle.curves[name].touch_m(TOUCH_N) + DEPTHS_M[-1]
    for friction in OTHER_FRICTION:
        drag = sample.drag(case.main, travel, friction)
        for way in (0.0005, 0.001, 0.01):
            out[f"along, {name}: force (N) after {1000 * way:g} mm, friction {friction}"] = float(drag.at(way))
    return out


def _second(case: Case, sample: Sample) -> float:
    block = Block(sample.medium, MARGIN * case.main.reach_m(MATCHED_M) + SECOND_SIDE_M / 2, side_m=SECOND_SIDE_M)
    return block.press(case.main, MATCHED_M) / float(sample.press(case.main, [MATCHED_M])[0])


def as_json(comparisons: list[Comparison]) -> dict[str, object]:
    """Return every number of the table, the materials behind it, and each layer's modulus."""
    return {
        "schema": "carecontact-fem-2",
        "skins": [{"name": s.name, "thickness_m": s.thickness_m, "modulus_pa": s.modulus_pa} for s in SKINS],
        "regions": {
            done.case.region: {
                "thickness_m": done.case.ground.thickness_m, "limb_radius_m": done.case.ground.limb_radius_m,
                "poisson": done.case.ground.poisson, "tissue_pa": [rounded(a.modulus_pa) for a in done.skins],
                "tissue_pa_plain": rounded(done.plain.modulus_pa),
                "finite_elements_alone": {name: rounded(value) for name, value in done.extras.items()},
                "rows": [_row_json(row) for row in done.rows()],
            }
            for done in comparisons
        },
    }  # fmt: skip


def _row_json(row: Row) -> dict[str, object]:
    return {
        "name": row.standard.name, "unit": row.standard.unit, "skins": list(row.standard.skins),
        "plain": row.standard.plain, "simulated": rounded(row.simulated),
        "outside_percent": rounded(row.outside_percent),
    }  # fmt: skip
