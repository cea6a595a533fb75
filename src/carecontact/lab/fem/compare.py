"""Compares the answers of finite elements and simulator, number by number, as table and figure."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from carecontact.lab.fem import simulated, solve
from carecontact.lab.fem.cases import (
    BESIDE_M,
    CASES,
    DEPTHS_M,
    DIMPLE_M,
    MATCHED_M,
    MIDDLE,
    OTHER_FRICTION,
    OTHER_POISSON,
    PLAIN,
    RINGS_M,
    SKINS,
    TABLE_WAYS_M,
    TOUCH_N,
    TOUCHES_N,
    Answer,
    Case,
    Tool,
)
from carecontact.lab.fem.solve import MARGIN, Block, Sample
from carecontact.lab.validation.result import Array, Figure
from carecontact.lab.validation.subject import Subject

if TYPE_CHECKING:
    from matplotlib.axes import Axes


POINTS = "%"
"""Unit of quantities that are percentages: they are compared by their difference, all others by their ratio."""


@dataclass(frozen=True)
class Quantity:
    name: str
    unit: str
    row: Callable[[Answer], Array]
    at: int
    """Index in the row."""

    def of(self, answer: Answer) -> float:
        return float(self.row(answer)[self.at])


def quantities(case: Case) -> list[Quantity]:
    """Return every quantity of a case, in the order of the table."""
    rows = (*_curves(case), *_dimples(case), *_along(case))
    return [Quantity(name, unit, row, k) for names, unit, row in rows for k, name in enumerate(names)]


def off_published(answer: Answer, case: Case, touch_n: float) -> Array:
    """Return how far (d,) [%] the force at DEPTHS_M lies above the published curve's, if ``touch_n`` is touch."""
    published = np.interp(DEPTHS_M, case.reference.depth_m, case.reference.force_n)
    return 100 * (answer.curves[case.main.name].at(DEPTHS_M, touch_n=touch_n) / published - 1)


Rows = Iterator[tuple[list[str], str, Callable[[Answer], Array]]]
"""Names, unit, and what computes them from an answer."""


def _curves(case: Case) -> Rows:
    depths = [_mm(depth) for depth in DEPTHS_M]

    def forces(name: str, which: list[int]) -> tuple[list[str], str, Callable[[Answer], Array]]:
        return [f"force, {name}, {depths[k]} deep" for k in which], "N", lambda a: a.curves[name].at(DEPTHS_M)[which]

    yield forces(case.main.name, [1, 2, 4])
    yield [f"share of the 4 mm force at {depth}" for depth in depths[:4]], "", lambda a: a.shares(case)
    above = [f"above the published curve at {d}, touch at {t:g} N" for d in depths[:3] for t in TOUCHES_N]
    yield above, POINTS, lambda a: np.stack([off_published(a, case, t)[:3] for t in TOUCHES_N], 1).ravel()
    for name, tool in case.tools().items():
        if tool != case.main and (tool in case.references or tool in case.gliding()):
            yield forces(name, [1, 4])
    for word in ("ball", "disc"):
        names = [f"exponent over the radius, {word}s, {depths[k]} deep" for k in (1, 2, 4)]
        yield names, "", lambda a, word=word: a.exponents(case, word)[[1, 2, 4]]


def _dimples(case: Case) -> Rows:
    of = f"{case.main.name},"
    yield (
        [f"dimple, {of} {_mm(far)} from its axis" for far in DIMPLE_M],
        "",
        lambda a: np.interp(DIMPLE_M, RINGS_M, a.dimple),
    )
    if case.ground.limb_radius_m is not None:
        names = [f"dimple around the limb, {of} {_mm(far)} from its axis" for far in BESIDE_M]
        yield names, "", lambda a: a.beside_at(BESIDE_M)


def _along(case: Case) -> Rows:
    for tool in case.gliding():
        yield from _drags(f"along, {tool.name}:", tool)


def _drags(of: str, tool: Tool) -> Rows:
    name = tool.name
    yield [f"{of} stiffness while stuck"], "N/mm", lambda a: np.array([a.drags[name].stuck_n_m / 1000])
    over = f"{of} the same over the tool's radius"
    yield [over], "kPa", lambda a: np.array([a.drags[name].stuck_n_m / tool.radius_m / 1000])
    yield [f"{of} force after {_mm(way)}" for way in TABLE_WAYS_M], "N", lambda a: a.drags[name].at(TABLE_WAYS_M)
    ends = f"{of} force over normal force after 10 mm"
    yield [ends], "", lambda a: a.drags[name].force_n[-1:] / a.drags[name].normal_n[-1:]


def _mm(length_m: float) -> str:
    return f"{1000 * length_m:g} mm"


@dataclass(frozen=True, kw_only=True)
class Standard:
    """One quantity of one region by finite elements; ``tools/fem_table.py`` keeps a table of them."""

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
    out = []
    for quantity in quantities(case):
        without, *values = (rounded(quantity.of(answer)) for answer in (plain, *skins))
        name, unit = quantity.name, quantity.unit
        out.append(Standard(region=case.region, name=name, unit=unit, skins=tuple(values), plain=without))
    return out


def rounded(value: float) -> float:
    return float(f"{value:.4g}") if np.isfinite(value) else value


CLOSE_PERCENT = 10.0
"""Largest distance from the nearest end of the finite elements' range that the table counts as agreement."""
SECOND_SIDE_M = 0.003
"""Side of the hexahedra of the second method."""


@dataclass(frozen=True, kw_only=True)
class Row:
    standard: Standard
    simulated: float

    @property
    def outside_percent(self) -> float:
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
    return solve.answer(case, PLAIN), tuple(solve.answer(case, skin) for skin in SKINS)


def _extras(case: Case, middle: Answer) -> dict[str, float]:
    """Return, for the middle skin, numbers of a second method, of other Poisson's ratios and other friction."""
    sample = solve.sample(case, MIDDLE, middle)
    name = case.main.name
    out = {f"force of the {name} at 4 mm by hexahedra over the table's": _second(case, sample)}
    for tool in case.gliding():
        drag = middle.drags[tool.name]
        touched = f"{tool.name}, 4 mm deep: radius of a circle as large as the touched area (mm)"
        out[touched] = 1000 * drag.contact_radius_m
    for poisson in OTHER_POISSON:
        other = solve.answer(replace(case, ground=replace(case.ground, poisson=poisson)), MIDDLE)
        ratio = f"Poisson's ratio {poisson}"
        for word in ("ball", "disc"):
            out[f"exponent over the radius, {word}s, 4 mm deep, {ratio}"] = float(other.exponents(case, word)[-1])
        out[f"along, {name}: stiffness while stuck (N/mm), {ratio}"] = other.drags[name].stuck_n_m / 1000
        if case.ground.limb_radius_m is not None:
            for distance, share in zip(BESIDE_M, other.beside_at(BESIDE_M), strict=True):
                out[f"dimple around the limb, {name}, {_mm(distance)} from its axis, {ratio}"] = float(share)
    travel = middle.curves[name].touch_m(TOUCH_N) + DEPTHS_M[-1]
    for friction in OTHER_FRICTION:
        drag = sample.drag(case.main, travel, friction)
        for way in (0.0005, 0.001, 0.01):
            out[f"along, {name}: force (N) after {_mm(way)}, friction {friction}"] = float(drag.at(way))
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
                "rows": [
                    {
                        "name": row.standard.name, "unit": row.standard.unit, "skins": list(row.standard.skins),
                        "plain": row.standard.plain, "simulated": rounded(row.simulated),
                        "outside_percent": rounded(row.outside_percent),
                    }
                    for row in done.rows()
                ],
            }
            for done in comparisons
        },
    }  # fmt: skip


FEM, MIDDLE_SKIN, PLAIN_SKIN, HERE = "#56B4E9", "#0072B2", "#009E73", "#D55E00"
TITLES = ("force over depth", "growth with balls' size", "growth with discs' size", "dimple", "gliding, 4 mm deep")
SHOWN_WAYS_M = np.linspace(0.0, 0.005, 51)


def draw(comparisons: list[Comparison], figure: Figure) -> None:
    figure.set_size_inches(9.6, 2.05 * len(comparisons) + 0.5)
    grid = figure.subplots(len(comparisons), len(TITLES), squeeze=False, sharex="col")
    for axes, title in zip(grid[0], TITLES, strict=True):
        axes.set_title(title)
    for row, done in zip(grid, comparisons, strict=True):
        _row(row, done)
    for axes, label in zip(grid[-1], ("depth [mm]",) * 3 + ("from the axis [mm]", "way along [mm]"), strict=True):
        axes.set_xlabel(label)
    handles, labels = grid[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))


def _row(row: list[Axes], done: Comparison) -> None:
    case, name = done.case, done.case.main.name
    depth = np.linspace(0.0002, DEPTHS_M[-1], 40)
    _panel(row[0], done, 1000 * depth, lambda a: a.curves[name].at(depth))
    shown = case.reference.depth_m <= 0.0045
    row[0].plot(
        1000 * case.reference.depth_m[shown], case.reference.force_n[shown], "k:", lw=1.2, label="people, middle"
    )
    row[0].set(ylabel="force [N]", ylim=(0, None), xlim=(0, 4.5))
    row[0].annotate(
        f"{case.region.replace('_', ' ')}\n{name}", (0.05, 0.95), xycoords="axes fraction", va="top", weight="bold"
    )
    for axes, word in zip(row[1:3], ("ball", "disc"), strict=True):
        _panel(axes, done, 1000 * DEPTHS_M, lambda a, w=word: a.exponents(case, w))
        axes.set(ylabel="exponent over radius", xlim=(0, 4.2))
    _panel(row[3], done, 1000 * RINGS_M, lambda a: -a.dimple)
    row[3].set(ylabel="height / travel", xlim=(0, 31))
    _panel(row[4], done, 1000 * SHOWN_WAYS_M, lambda a: a.drags[name].at(SHOWN_WAYS_M))
    row[4].set(ylabel="force along [N]", ylim=(0, None), xlim=(0, 5))


def _panel(axes: Axes, done: Comparison, x: Array, of: Callable[[Answer], Array]) -> None:
    skins = np.array([of(answer) for answer in done.skins])
    axes.fill_between(x, skins.min(0), skins.max(0), color=FEM, alpha=0.35, lw=0, label="finite elements, all skins")
    axes.plot(x, skins[0], color=MIDDLE_SKIN, label="middle skin")
    axes.plot(x, of(done.plain), "--", color=PLAIN_SKIN, label="no skin")
    axes.plot(x, of(done.simulated), color=HERE, label="simulator")
