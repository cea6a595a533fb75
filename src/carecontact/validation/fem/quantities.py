"""The numbers by which two tissues are compared, each computed from an answer."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from carecontact.validation.fem.answer import Answer
from carecontact.validation.fem.cases import BESIDE_M, DEPTHS_M, DIMPLE_M, TOLD_WAYS_M, TOUCHES_N, Case
from carecontact.validation.result import Array

POINTS = "%"
"""Unit of quantities that are percentages: they are compared by their difference, all others by their ratio."""


@dataclass(frozen=True, kw_only=True)
class Quantity:
    name: str
    unit: str
    of: Callable[[Answer], float]


def quantities(case: Case) -> list[Quantity]:
    """Return every quantity of a case, in the order of the table."""
    return [*_main_curve(case), *_other_tools(case), *_exponents(case), *_dimple(case), *_along(case)]


def off_published(answer: Answer, case: Case, touch_n: float) -> Array:
    """Return how far (d,) [%] the force at DEPTHS_M lies above the published curve's, if ``touch_n`` counts as
    touch.
    """
    published = np.interp(DEPTHS_M, case.reference.depth_m, case.reference.force_n)
    return 100 * (answer.curves[case.main.name].at(DEPTHS_M, touch_n=touch_n) / published - 1)


def _main_curve(case: Case) -> Iterator[Quantity]:
    name = case.main.name
    for k in (1, 2, 4):
        yield Quantity(
            name=f"force, {name}, {_mm(DEPTHS_M[k])} deep", unit="N",
            of=lambda a, k=k: float(a.curves[name].at(DEPTHS_M)[k]),
        )  # fmt: skip
    for k in range(4):
        yield Quantity(
            name=f"share of the 4 mm force at {_mm(DEPTHS_M[k])}", unit="", of=lambda a, k=k: float(a.shares(case)[k])
        )
    for k in (0, 1, 2):
        for touch in TOUCHES_N:
            yield Quantity(
                name=f"above the published curve at {_mm(DEPTHS_M[k])}, touch at {touch:g} N", unit=POINTS,
                of=lambda a, k=k, touch=touch: float(off_published(a, case, touch)[k]),
            )  # fmt: skip


def _other_tools(case: Case) -> Iterator[Quantity]:
    for name, tool in case.tools().items():
        if tool == case.main or not (tool in case.references or tool in case.gliding()):
            continue
        for k in (1, 4):
            yield Quantity(
                name=f"force, {name}, {_mm(DEPTHS_M[k])} deep", unit="N",
                of=lambda a, name=name, k=k: float(a.curves[name].at(DEPTHS_M)[k]),
            )  # fmt: skip


def _exponents(case: Case) -> Iterator[Quantity]:
    for word in ("ball", "disc"):
        for k in (1, 2, 4):
            yield Quantity(
                name=f"exponent over the radius, {word}s, {_mm(DEPTHS_M[k])} deep", unit="",
                of=lambda a, word=word, k=k: float(a.exponents(case, word)[k]),
            )  # fmt: skip


def _dimple(case: Case) -> Iterator[Quantity]:
    for k, distance in enumerate(DIMPLE_M):
        yield Quantity(
            name=f"dimple, {case.main.name}, {_mm(distance)} from its axis", unit="",
            of=lambda a, k=k: float(a.dimple_at(DIMPLE_M)[k]),
        )  # fmt: skip
    if case.ground.limb_radius_m is None:
        return
    for k, distance in enumerate(BESIDE_M):
        yield Quantity(
            name=f"dimple around the limb, {case.main.name}, {_mm(distance)} from its axis", unit="",
            of=lambda a, k=k: float(a.beside_at(BESIDE_M)[k]),
        )  # fmt: skip


def _along(case: Case) -> Iterator[Quantity]:
    for tool in case.gliding():
        name = tool.name
        yield Quantity(
            name=f"along, {name}: stiffness while stuck", unit="N/mm", of=lambda a, n=name: a.drags[n].stuck_n_m / 1000
        )
        yield Quantity(
            name=f"along, {name}: the same over the tool's radius", unit="kPa",
            of=lambda a, tool=tool: a.drags[tool.name].stuck_n_m / tool.radius_m / 1000,
        )  # fmt: skip
        for k, way in enumerate(TOLD_WAYS_M):
            yield Quantity(
                name=f"along, {name}: force after {_mm(way)}", unit="N",
                of=lambda a, n=name, k=k: float(a.drags[n].at(TOLD_WAYS_M)[k]),
            )  # fmt: skip
        yield Quantity(
            name=f"along, {name}: force over normal force after 10 mm", unit="",
            of=lambda a, n=name: float(a.drags[n].force_n[-1] / a.drags[n].normal_n[-1]),
        )  # fmt: skip


def _mm(length_m: float) -> str:
    return f"{1000 * length_m:g} mm"
