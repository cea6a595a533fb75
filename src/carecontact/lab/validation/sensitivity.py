"""Check 7 measures how far the uncertain constants of the person move the scores, and whether they change the
ranking."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product

import numpy as np

from carecontact.lab.validation.result import CheckResult, Figure, measured
from carecontact.lab.validation.subject import Motion, Scores, Subject, perform, scores_of
from carecontact.tissue.plugin import set_law

TITLE = "Sensitivity to the person's constants"
REGION = "forearm"
GENTLE = Motion(name="gentle", overtravel_m=0.012, half_stroke_m=0.030, strokes=2, speed_m_s=0.06)
FIRM = Motion(name="firm", overtravel_m=0.035, half_stroke_m=0.030, strokes=2, speed_m_s=0.15)
STOP_GO = Motion(name="stop-go", overtravel_m=0.024, half_stroke_m=0.030, strokes=3, speed_m_s=0.20, pause_s=0.25)
MOTIONS = (GENTLE, FIRM, STOP_GO)


LAYER = "layer"
"""The depth over which the contact layer stiffens: a number of the compiled region, and no field of ``Tissue``."""
STIFFNESS = ("a_n_m3", "b_n_m4", "c_n_m5")
"""The coupling follows, which is declared relative to it."""
DAMPING = ("damping_ns_m3", "damping_growth_ns_m4")
CONTACT = ("contact_n_m3",)
CHANGES: dict[str, dict[str, float]] = {
    "as shipped": {},
    "stiffness x 0.5": dict.fromkeys(STIFFNESS, 0.5),
    "stiffness x 2": dict.fromkeys(STIFFNESS, 2.0),
    "damping x 0.25": dict.fromkeys(DAMPING, 0.25),
    "damping x 4": dict.fromkeys(DAMPING, 4.0),
    "contact layer x 0.5": dict.fromkeys(CONTACT, 0.5),
    "contact layer x 2": dict.fromkeys(CONTACT, 2.0),
    "friction 0.1": {"friction": 0.1},
    "friction 0.3": {"friction": 0.3},
    "friction 1": {"friction": 1.0},
    "layer's depth x 0.5": {LAYER: 0.5},
    "layer's depth x 2": {LAYER: 2.0},
}
"""Name -> factors on fields of the tissue and on LAYER, or the coefficient of friction."""
QUICK_CHANGES, QUICK_MOTIONS = ("as shipped", "stiffness x 0.5"), (GENTLE, FIRM)
FIELDS = {"c1_n": "C1", "c5_n": "C5", "stroke_m": "stroke"}


def run(subject: Subject, *, quick: bool) -> CheckResult:
    motions = QUICK_MOTIONS if quick else MOTIONS
    names = QUICK_CHANGES if quick else tuple(CHANGES)
    table = {name: {motion.name: _run_one(subject, motion, CHANGES[name]) for motion in motions} for name in names}
    values = np.array([[[getattr(s, f) for f in FIELDS] for s in row.values()] for row in table.values()])
    base, changed = table[names[0]], names[1:]
    measures = [
        measured("scores that are not finite", (~np.isfinite(values)).sum(), at_most=0.0),
        measured("contacts scored", values.shape[0] * values.shape[1]),
    ]
    for column, label in enumerate(FIELDS.values()):
        turned = [name for name in changed if order(table[name], column) != order(base, column)]
        which = ", ".join(turned) or "none"
        measures.append(measured(f"{label}: constants that change the ranking ({which})", len(turned)))
    for name, motion, (field, label) in product(changed, base, FIELDS.items()):
        change = getattr(table[name][motion], field) / getattr(base[motion], field) - 1
        measures.append(measured(f"{name}: {motion} {label}", 100 * change, "%"))
    beyond = "share of the time in tissue beyond the measured range"
    measures += [measured(f"{motion}: {beyond}", 100 * score.beyond_measured, "%") for motion, score in base.items()]
    return CheckResult(check="sensitivity", title=TITLE, measures=tuple(measures), curves={"values": values})


def _run_one(subject: Subject, motion: Motion, change: Mapping[str, float]) -> Scores:
    simulation, tissue = subject.hovering(REGION), subject.tissue(REGION)
    law = {name: factor * getattr(tissue, name) for name, factor in change.items() if name not in ("friction", LAYER)}
    law |= {name: value for name, value in change.items() if name == "friction"}
    set_law(simulation.model, REGION, tissue.model_copy(update=law))
    # The first number is the layer's depth (``tissue.plugin.add_region``).
    simulation.model.numeric(f"{REGION}/contact").data[0] *= change.get(LAYER, 1.0)
    return scores_of(simulation, REGION, *perform(simulation, REGION, motion))


def order(scores: Mapping[str, Scores], column: int) -> list[str]:
    """Return the motions from the smallest to the largest value of a score."""
    field = list(FIELDS)[column]
    return sorted(scores, key=lambda name: getattr(scores[name], field))


def draw(result: CheckResult, figure: Figure) -> None:
    values = result.curves["values"]
    quick = values.shape[0] == len(QUICK_CHANGES)
    names, motions = (QUICK_CHANGES, QUICK_MOTIONS) if quick else (tuple(CHANGES), MOTIONS)
    figure.set_size_inches(7.0, 2.8)
    rows, panels = np.arange(len(names)), figure.subplots(1, 3, sharey=True)
    labels = {"C1 [N]": 1.0, "C5 [N]": 1.0, "stroke [mm]": 1000.0}
    for column, (axes, (label, unit)) in enumerate(zip(panels, labels.items(), strict=True)):
        for k, motion in enumerate(motions):
            axes.plot(unit * values[:, k, column], rows, "os^"[k], ms=4.5, label=motion.name)
            axes.axvline(unit * values[0, k, column], color=f"C{k}", lw=0.6, ls=":")
        axes.set(xlabel=label, xlim=(0, None))
    figure.axes[0].set_yticks(rows, names)
    figure.axes[0].invert_yaxis()
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(motions))
