"""Check 7 measures how far the uncertain constants of the person move the scores, and whether they change the
ranking."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from carecontact.sim.simulation import Simulation
from carecontact.validation.moves import Motion, perform
from carecontact.validation.result import CheckResult, Measure
from carecontact.validation.scores import Scores, scores_of
from carecontact.validation.subject import Subject
from carecontact.world.human.tissue import anchor_joints, coupling_tendons

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TITLE = "Sensitivity to the person's constants"
REGION = "forearm"
GENTLE = Motion(name="gentle", overtravel_m=0.012, half_stroke_m=0.030, strokes=2, speed_m_s=0.06)
FIRM = Motion(name="firm", overtravel_m=0.035, half_stroke_m=0.030, strokes=2, speed_m_s=0.15)
STOP_GO = Motion(name="stop-go", overtravel_m=0.024, half_stroke_m=0.030, strokes=3, speed_m_s=0.20, pause_s=0.25)
MOTIONS = (GENTLE, FIRM, STOP_GO)
CHANGES: dict[str, tuple[float, float, float | None]] = {
    "as shipped": (1.0, 1.0, None), "stiffness x 0.5": (0.5, 1.0, None), "stiffness x 2": (2.0, 1.0, None),
    "damping x 0.25": (1.0, 0.25, None), "damping x 4": (1.0, 4.0, None), "friction 0.1": (1.0, 1.0, 0.1),
    "friction 0.3": (1.0, 1.0, 0.3), "friction 1": (1.0, 1.0, 1.0),
}  # fmt: skip
"""Factor on K_c (and so on the coupling, which is declared through it), factor on D_c, coefficient of friction (None:
as shipped)."""
QUICK_CHANGES, QUICK_MOTIONS = ("as shipped", "stiffness x 0.5"), (GENTLE, FIRM)
FIELDS = {"c1_n": "C1", "c5_n": "C5", "stroke_m": "stroke"}


def run(subject: Subject, *, quick: bool) -> CheckResult:
    motions = QUICK_MOTIONS if quick else MOTIONS
    names = QUICK_CHANGES if quick else tuple(CHANGES)
    table = {name: {b.name: _run_one(subject, b, *CHANGES[name]) for b in motions} for name in names}
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


def _run_one(subject: Subject, motion: Motion, stiffness: float, damping: float, friction: float | None) -> Scores:
    simulation = subject.hovering(REGION)
    change(simulation, stiffness=stiffness, damping=damping, friction=friction)
    return scores_of(simulation, REGION, perform(simulation, REGION, motion))


def change(simulation: Simulation, *, stiffness: float, damping: float, friction: float | None) -> None:
    """Edit the region's anchors and its skin's friction in the simulation's own model."""
    model = simulation.model
    joints = anchor_joints(model, REGION)
    model.jnt_stiffness[joints] *= stiffness
    model.jnt_stiffnesspoly[joints] *= stiffness
    model.tendon_stiffness[coupling_tendons(model, REGION)] *= stiffness
    model.dof_damping[model.jnt_dofadr[joints]] *= damping
    if friction is not None:
        flex = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_FLEX, REGION)
        model.flex_friction[flex, 0] = friction


def order(scores: Mapping[str, Scores], column: int) -> list[str]:
    """Motions from the smallest to the largest value of a score."""
    field = list(FIELDS)[column]
    return sorted(scores, key=lambda name: getattr(scores[name], field))


def draw(result: CheckResult, figure: Figure) -> None:
    values = result.curves["values"]
    quick = values.shape[0] == len(QUICK_CHANGES)
    names, motions = (QUICK_CHANGES, QUICK_MOTIONS) if quick else (tuple(CHANGES), MOTIONS)
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
