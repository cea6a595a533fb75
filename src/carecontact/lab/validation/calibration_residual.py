"""Check 5: the person's tissue responds to the references' own indenters as people's tissue does."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from carecontact.interface.regions import REGIONS
from carecontact.lab.validation.result import Array, CheckResult, Figure, Measure, measured
from carecontact.lab.validation.rig import ABDOMEN, FITTED, FOREARM, REFERENCES, SPEED_M_S, Reference, person_bench
from carecontact.lab.validation.subject import Subject
from carecontact.protocol.overrides import load_tissue_set

TITLE = "Calibration residual"
NRMSE_LIMIT_PERCENT, WORST_LIMIT_PERCENT = 5.0, 10.0
"""Limits of the error of the mean over held-out places, since the references are means or medians over people and, on
the abdomen, over five sites; and of the error at the worst single place, whose curvature is the body's own."""
DEPTH_SHARES = (0.1, 0.25, 0.5, 1.0)
"""Depths, as shares of the deepest, at which the error is also given as a share of the force there: NRMSE is relative
to the largest force and therefore tolerates large errors at small depths."""
QUICK_PLACES, QUICK_UNFITTED = 2, (FOREARM, ABDOMEN)
Places = tuple[tuple[float, float], ...]


def run(subject: Subject, *, quick: bool) -> CheckResult:
    curves: dict[str, Array] = {}
    fitted_to = applying(subject)
    measures = [measured("published curves that apply to this tissue", len(fitted_to))]
    for published in (fitted_to or QUICK_UNFITTED) if quick else REFERENCES:
        # The curves come from people of every build, and the rows that were fitted to them count as those of
        # man-adult: the middle curve is scaled by what follows from this body's build, the band is not.
        region = published.region
        share = subject.tissue(region).a_n_m3 / subject.protocol.person.tissue[region].a_n_m3
        reference = replace(published, force_n=share * published.force_n)
        curve = responses(subject, reference, held_out_m(region)[: QUICK_PLACES if quick else None])
        curves[f"{reference.name}/places"] = curve
        measures += _residuals(reference, curve, fitted=published in fitted_to)
    return CheckResult(check="calibration-residual", title=TITLE, measures=tuple(measures), curves=curves)


def _residuals(reference: Reference, curve: Array, *, fitted: bool) -> Iterator[Measure]:
    """Yield how far the forces (places, n) [N] are from the reference; limits hold for the curves of the fit."""
    wanted, mean = reference.force_n, curve.mean(0)
    each = 100 * np.sqrt(np.mean((curve - wanted) ** 2, axis=1)) / wanted.max()
    of_mean = 100 * np.sqrt(np.mean((mean - wanted) ** 2)) / wanted.max()
    inside = (mean >= reference.low_n) & (mean <= reference.high_n)
    name = f"{reference.name}, {'held-out places' if fitted else 'not fitted to'}"
    limit, worst = (NRMSE_LIMIT_PERCENT, WORST_LIMIT_PERCENT) if fitted else (None, None)
    yield measured(f"{name}: NRMSE of the mean curve", of_mean, "%", at_most=limit)
    yield measured(f"{name}: NRMSE of the worst place", each.max(), "%", at_most=worst)
    people = f"{name}: share of depths inside people's P5-P95"
    yield measured(people, 100 * inside[1:].mean(), "%", at_least=100.0, decides=False)
    for share in DEPTH_SHARES:
        here, there = (np.interp(share * reference.depth_m[-1], reference.depth_m, of) for of in (mean, wanted))
        where = f"deviation from the reference at {share:.0%} of its depth"
        yield measured(f"{reference.name}: {where}", 100 * (here / there - 1), "%")
    falls = (np.diff(curve, axis=1) <= 0).any(axis=1).sum()
    yield measured(f"{reference.name}: places where the force falls with depth", falls, at_most=0.0)


def held_out_m(region: str) -> Places:
    """Return places (along, across) [m] in the region's frame that the fit did not use; empty for a rigid region."""
    shape = REGIONS[region].shape
    return () if shape is None else shape.held_out_m


def applying(subject: Subject) -> tuple[Reference, ...]:
    """Return the curves to which the law of their region was fitted.

    The rows decide and not the name of the set, because a calibrated set keeps those rows of its base that it does not
    replace. No curve applies to a user's own row.
    """
    found: dict[str, Reference] = {}
    for name, references in FITTED.items():
        shipped = load_tissue_set(name).tissue
        found |= {r.name: r for r in references if subject.protocol.person.tissue[r.region] == shipped[r.region]}
    return tuple(found.values())


def responses(subject: Subject, reference: Reference, places: Places) -> Array:
    """Return the force (places, n) [N] of the person at the reference's depths, with its indenter and speed."""
    bench = person_bench(subject, reference.region, reference.indenter)
    return np.array([bench.response(reference.depth_m, along_m=x, across_m=y, speed_m_s=SPEED_M_S) for x, y in places])


def draw(result: CheckResult, figure: Figure) -> None:
    shown = [r for r in REFERENCES if f"{r.name}/places" in result.curves]
    required = {m.name.partition(", held-out")[0] for m in result.measures if ", held-out" in m.name}
    figure.set_size_inches(2.3 * len(shown), 2.5)
    for axes, reference in zip(np.atleast_1d(figure.subplots(1, len(shown))), shown, strict=True):
        depth = 1000 * reference.depth_m
        axes.fill_between(depth, reference.low_n, reference.high_n, color="0.88", lw=0, label="people, P5-P95")
        axes.plot(depth, reference.force_n, "--", color="C4", lw=1.6, label="people, middle")
        curve = result.curves[f"{reference.name}/places"]
        axes.plot(depth, curve.T, color="C0", lw=0.5, alpha=0.6)
        axes.plot(depth, curve.mean(0), color="C0", label="this person")
        place, _, source = reference.name.partition(" (")
        title = f"{place}\n{source.rstrip(')')}{'' if reference.name in required else ', not fitted to'}"
        axes.set(xlabel="indentation [mm]", title=title, xlim=(0, None), ylim=(0, None))
        axes.title.set_fontsize(7.5)
    figure.axes[0].set_ylabel("force [N]")
    figure.axes[0].legend(loc="upper left")
