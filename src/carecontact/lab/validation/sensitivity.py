"""Check 7 measures how far the uncertain constants of the person move the scores, and whether they change the
ranking."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from carecontact.lab.validation.result import CheckResult, Measure
from carecontact.lab.validation.subject import Motion, Scores, Subject, perform, scores_of
from carecontact.protocol.person import Tissue
from carecontact.tissue.plugin import set_law

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TITLE = "Sensitivity to the person's constants"
REGION = "forearm"
GENTLE = Motion(name="gentle", overtravel_m=0.012, half_stroke_m=0.030, strokes=2, speed_m_s=0.06)
FIRM = Motion(name="firm", overtravel_m=0.035, half_stroke_m=0.030, strokes=2, speed_m_s=0.15)
STOP_GO = Motion(name="stop-go", overtravel_m=0.024, half_stroke_m=0.030, strokes=3, speed_m_s=0.20, pause_s=0.25)
MOTIONS = (GENTLE, FIRM, STOP_GO)


@dataclass(frozen=True, kw_only=True)
class Change:
    """Factors on K_c (and thereby on the coupling, which is declared relative to it), on D_c, on the contact layer and
    on the depth over which it stiffens, and the coefficient of friction, where None means the shipped
    one.
    """

    stiffness: float = 1.0
    damping: float = 1.0
    contact: float = 1.0
    layer: float = 1.0
    friction: float | None = None

    def of(self, tissue: Tissue) -> Tissue:
        scaled = {
            **dict.fromkeys(("a_n_m3", "b_n_m4", "c_n_m5"), self.stiffness),
            **dict.fromkeys(("damping_ns_m3", "damping_growth_ns_m4"), self.damping), "contact_n_m3": self.contact,
        }  # fmt: skip
        update = {name: factor * getattr(tissue, name) for name, factor in scaled.items()}
        return tissue.model_copy(update=update if self.friction is None else update | {"friction": self.friction})


CHANGES = {
    "as shipped": Change(), "stiffness x 0.5": Change(stiffness=0.5), "stiffness x 2": Change(stiffness=2.0),
    "damping x 0.25": Change(damping=0.25), "damping x 4": Change(damping=4.0),
    "contact layer x 0.5": Change(contact=0.5), "contact layer x 2": Change(contact=2.0),
    "friction 0.1": Change(friction=0.1), "friction 0.3": Change(friction=0.3), "friction 1": Change(friction=1.0),
    "layer's depth x 0.5": Change(layer=0.5), "layer's depth x 2": Change(layer=2.0),
}  # fmt: skip
QUICK_CHANGES, QUICK_MOTIONS = ("as shipped", "stiffness x 0.5"), (GENTLE, FIRM)
FIELDS = {"c1_n": "C1", "c5_n": "C5", "stroke_m": "stroke"}


def run(subject: Subject, *, quick: bool) -> CheckResult:
    motions = QUICK_MOTIONS if quick else MOTIONS
    names = QUICK_CHANGES if quick else tuple(CHANGES)
    table = {name: {b.name: _run_one(subject, b, CHANGES[name]) for b in motions} for name in names}
    values = np.array([[[getattr(s, f) for f in FIELDS] for s in row.values()] for row in table.values()])
    measures = [
        Measure(name="scores that are not finite", value=float((~np.isfinite(values)).sum()), limit=0.0),
        Measure(name="contacts scored", value=float(values.shape[0] * values.shape[1])),
    ]  # fmt: skip
    base = table[names[0]]
    for column, label in enumerate(FIELDS.values()):
        turned = [n for n in names[1:] if order(table[n], column) != order(base, column)]
        measures.append(
            Measure(name=f"{label}: constants that change the ranking ({', '.join(turned) or 'none'})",
                    value=float(len(turned)))
        )  # fmt: skip
    measures += [
        Measure(name=f"{name}: {b} {label}", unit="%",
                value=float(100 * (getattr(table[name][b], field) / getattr(base[b], field) - 1)))
        for name in names[1:] for b in base for field, label in FIELDS.items()
    ]  # fmt: skip
    measures += [
        Measure(name=f"{b}: share of the time in tissue beyond the measured range", unit="%",
                value=100 * score.beyond_measured)
        for b, score in base.items()
    ]  # fmt: skip
    return CheckResult(check="sensitivity", title=TITLE, measures=tuple(measures), curves={"values": values})


def _run_one(subject: Subject, motion: Motion, change: Change) -> Scores:
    simulation = subject.hovering(REGION)
    set_law(simulation.model, REGION, change.of(subject.tissue(REGION)))
    if change.layer != 1.0:
        # The first number is the layer's depth (``kernel.region.add_region``).
        simulation.model.numeric(f"{REGION}/contact").data[0] *= change.layer
    return scores_of(simulation, REGION, perform(simulation, REGION, motion))


def order(scores: Mapping[str, Scores], column: int) -> list[str]:
    """Return the motions from the smallest to the largest value of a score."""
    field = list(FIELDS)[column]
    return sorted(scores, key=lambda name: getattr(scores[name], field))


def draw(result: CheckResult, figure: Figure) -> None:
    values = result.curves["values"]
    quick = values.shape[0] == len(QUICK_CHANGES)
    names, motions = (QUICK_CHANGES, QUICK_MOTIONS) if quick else (tuple(CHANGES), MOTIONS)
    names = names[: values.shape[0]]
    figure.set_size_inches(7.0, 2.8)
    units = (1.0, 1.0, 1000.0)
    rows = np.arange(len(names))
    for column, (axes, label) in enumerate(zip(figure.subplots(1, 3, sharey=True),
                                               ("C1 [N]", "C5 [N]", "stroke [mm]"), strict=True)):  # fmt: skip
        for k, motion in enumerate(motions):
            axes.plot(units[column] * values[:, k, column], rows, "os^"[k], ms=4.5, label=motion.name)
            axes.axvline(units[column] * values[0, k, column], color=f"C{k}", lw=0.6, ls=":")
        axes.set(xlabel=label, xlim=(0, None))
    figure.axes[0].set_yticks(rows, names)
    figure.axes[0].invert_yaxis()
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(motions))
