"""Tools of a kilogram bounce on the skin and are dragged over it. The energy that they lose is in the tissue, in its
dampers or in friction, and no energy is ever gained."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np

from carecontact.protocols import FAST_DT_S
from carecontact.validation.result import Array, Measure
from carecontact.validation.rig import FLANK, PAD, Rig, Tool, robot_tool
from carecontact.validation.subject import Subject

SPEED_M_S, SIDEWAYS_M_S, GAP_M, BOUNCE_S = 0.2, 0.1, 0.003, 0.4
PRESS_N, DRAG_M_S, DRAG_FROM_M, REST_S, RISE_S, DRAG_S = 3.0, 0.1, -0.04, 0.3, 0.05, 1.3
DRAG_NS_M = 100.0
"""Damper that keeps a dragged tool at its speed."""
UNEXPLAINED_PERCENT, GAIN_PERCENT = 2.0, 1.0
Case = Literal["bounced", "bounced aslant", "dragged"]
CASES: tuple[Case, ...] = ("bounced", "bounced aslant", "dragged")


@dataclass(frozen=True, kw_only=True)
class Ledger:
    """The energies of one contact [J]."""

    began: float
    """The tool's kinetic energy at the start."""
    put_in: float
    """Kinetic energy at the start plus the work of the driving forces."""
    left: float
    """Energy in tool and tissue at the end, minus the work of the driving forces on the way."""
    held: Array
    """(n,) the same at every step. The tissue responds to the tool's place at the beginning of a step, so that the
    tool's energy and the work are means of the values before and after the step."""
    lost: float
    """Energy that dampers and friction absorbed, as the compiled tissue counts it."""

    @property
    def unexplained(self) -> float:
        """Share of the input that is neither left nor lost; negative if there is more energy than was put in."""
        return (self.began - self.left - self.lost) / self.put_in

    @property
    def gain(self) -> float:
        """Largest rise of ``held`` over its lowest earlier value, as a share of the input."""
        return float((self.held - np.minimum.accumulate(self.held)).max()) / self.put_in


def measures(subject: Subject, region: str, *, quick: bool) -> list[Measure]:
    """Measure each tool and contact, at the protocol's step and at that of the fast mode."""
    shipped = subject.protocol.physics.dt_s
    out: list[Measure] = []
    for dt_s in (shipped,) if quick else sorted({shipped, FAST_DT_S}):
        for tool in (robot_tool(subject), *(() if quick else (PAD, FLANK))):
            ledgers = [contact(subject, region, tool, case, dt_s=dt_s) for case in CASES]
            for case, found in zip(CASES, ledgers, strict=True):
                name = f"{region}: {tool.name} of 1 kg {case} at {1000 * dt_s:g} ms"
                out += [
                    Measure(name=f"{name}: energy that is not accounted for, of that put in", unit="%",
                            value=100 * abs(found.unexplained), limit=UNEXPLAINED_PERCENT),
                    Measure(name=f"{name}: energy gained, of that put in", unit="%", value=100 * found.gain,
                            limit=GAIN_PERCENT),
                ]  # fmt: skip
    return out


def contact(subject: Subject, region: str, tool: Tool, case: Case, *, dt_s: float) -> Ledger:
    """Bounce a free tool off the region's middle, or press and drag one that slides along the region."""
    rig = Rig(subject, region, tool, joints="slides" if case == "dragged" else "free", dt_s=dt_s)
    model, data = rig.model, rig.data
    if case == "dragged":
        rig.reset(position=(DRAG_FROM_M, GAP_M + rig.clear_of_m(DRAG_FROM_M)))
    else:
        # The velocity of a free body is given in the axes of the world.
        along, _, outward = data.body("tool").xmat.reshape(3, 3).T
        sideways = SIDEWAYS_M_S if case == "bounced aslant" else 0.0
        rig.reset(position=data.qpos[:3] + GAP_M * outward, velocity=sideways * along - SPEED_M_S * outward)
    began, work, lost, tissue = rig.kinetic_j(), 0.0, 0.0, 0.0
    # The tool's energy, minus the work that was put in so far.
    own, held = began, [began]
    for _ in range(round((DRAG_S if case == "dragged" else BOUNCE_S) / dt_s)):
        before = data.qvel.copy()
        if case == "dragged":
            wanted = DRAG_M_S * min(1.0, max(0.0, (data.time - REST_S) / RISE_S))
            data.qfrc_applied[:] = DRAG_NS_M * (wanted - before[0]), -PRESS_N
        mujoco.mj_step(model, data)
        work += float(data.qfrc_applied @ (before + data.qvel)) / 2 * dt_s
        row = rig.felt.last(data, 1)[0]
        lost += float(row["damped_j"] + row["rubbed_j"])
        tissue = float(row["stored_j"] + row["kinetic_j"])
        own_before, own = own, rig.kinetic_j() - work
        held.append((own_before + own) / 2 + tissue)
    return Ledger(began=began, put_in=began + work, left=own + tissue, held=np.array(held), lost=lost)
