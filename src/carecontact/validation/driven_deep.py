"""The robot's own tool, driven into the abdomen as fast, as stiffly and as deep as a policy can: does the skin hold it?

The kernel drops a contact point that has sunk into a tool beyond the tool's middle, because the nearest surface is then
behind it. A tool of which this is true goes through the skin: nothing holds it until it meets bone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from carecontact.contract.embodiment import EMBODIMENTS, PANDA, Tip
from carecontact.contract.rays import Triangles
from carecontact.sim.simulation import Simulation, lengths
from carecontact.validation.moves import DOWN, in_base, move_to, skin_points, surface_point
from carecontact.validation.result import Array, Measure
from carecontact.validation.subject import Subject

REGION = "abdomen"
ABOVE_M = 0.12
"""Height over the skin from which the target goes down, so that the tool is at speed when it touches."""
STEPS = 2
"""Physics steps between two looks at the skin: 1 mm of the way at 0.25 m/s."""
HOLD_S = 0.6
"""Time for which the press goes on after the target has reached its end [s], so that the robot and the skin come to
rest there."""
BEHIND_M = 0.1
"""How far behind the tool's middle the ray begins that looks for the skin in the direction of the tool [m]; more than
any tool is thick."""
MIDDLE_PERCENT = 100.0


@dataclass(frozen=True, kw_only=True)
class Driven:
    """One press, until the target has rested for HOLD_S or the protocol would cut the trial."""

    tool: str
    speed_m_s: float
    """Of the tool when it touched."""
    peak_n: float
    """Largest force on a part of the person."""
    deepest_m: float
    """Of the tool's tip under where the skin was."""
    sunk: float
    """How far the skin sank into the tool at most, over half of the tool's thickness. Above 1, it lies beyond the
    tool's middle.
    """
    lost_n: float | None
    """Largest force until then; None where the skin stayed before the tool's middle."""

    def measures(self) -> Iterator[Measure]:
        name = f"abdomen, {self.tool} driven in by the robot"
        yield Measure(name=f"{name}: speed at touch", value=self.speed_m_s, unit="m/s")
        yield Measure(name=f"{name}: largest force", value=self.peak_n, unit="N")
        yield Measure(name=f"{name}: deepest", value=1000 * self.deepest_m, unit="mm")
        yield Measure(name=f"{name}: skin in the tool, over half of its thickness", value=100 * self.sunk, unit="%",
                      limit=MIDDLE_PERCENT)  # fmt: skip
        if self.lost_n is not None:
            yield Measure(name=f"{name}: force at which it goes through", value=self.lost_n, unit="N")


def drive(subject: Subject) -> Driven:
    """Drive the tool into the middle of the abdomen with the stiffest spring that the protocol allows.

    The target moves at the protocol's speed limit. It ends so deep that the robot, wherever the tool stops, pushes with
    all of the protocol's ``force_clamp_n``.
    Raises SceneError if the tool leaves the region.
    """
    protocol, simulation = subject.protocol, subject.hovering(REGION)
    impedance, physics = protocol.impedance, protocol.physics
    top = surface_point(simulation, REGION)
    move_to(simulation, top + [0, 0, ABOVE_M], seconds=1.5)
    stiffest = impedance.translational_bounds[1]
    simulation.set_stiffness(stiffest, impedance.rotational_bounds[1])
    below = subject.tissue(REGION).thickness_m + impedance.force_clamp_n / stiffest
    seconds = (ABOVE_M + below) / physics.max_tcp_speed_m_s
    simulation.set_goal(np.r_[in_base(simulation, top - [0, 0, below]), DOWN], seconds)
    return _watch(simulation, protocol.scene.tool, float(top[2]), seconds + HOLD_S)


def _watch(simulation: Simulation, tool: str, top_m: float, seconds: float) -> Driven:
    protocol, tip = simulation.protocol, EMBODIMENTS[simulation.protocol.scene.tool].tip
    cut_n = protocol.phases.truncation_over_pain * protocol.limits.f_pain_n[REGION]
    speed, peak, deepest, sunk, lost_n = 0.0, 0.0, 0.0, 0.0, None
    for _ in range(round(seconds / (STEPS * simulation.model.opt.timestep))):
        samples = simulation.advance(STEPS)[-1]
        force = float(lengths(samples.force).max())
        if peak == 0.0:
            speed = float(samples.tcp_speed[0])
        simulation.refresh()
        share = _sunk(simulation, tip)
        if share > 1 and lost_n is None:
            lost_n = peak
        peak, sunk = max(peak, force), max(sunk, share)
        deepest = max(deepest, top_m - float(simulation.data.site(PANDA.tcp_site).xpos[2]))
        if force > cut_n:
            break
    return Driven(tool=tool, speed_m_s=speed, peak_n=peak, deepest_m=deepest, sunk=sunk, lost_n=lost_n)


def _sunk(simulation: Simulation, tip: Tip) -> float:
    """Return how far the skin lies inside the tool, over half of the tool's thickness; 0 while it is outside."""
    corners = skin_points(simulation, REGION)[simulation.scene.regions[REGION].shell.triangles]
    out: Array = simulation.data.site(PANDA.tcp_site).xmat.reshape(3, 3)[:, 2]
    behind = simulation.data.geom(tip.geom).xpos - BEHIND_M * out
    ahead = float(Triangles(corners).first_hits(behind[None], out[None])[0]) - BEHIND_M
    return max(0.0, 1.0 - ahead / tip.half_m[2])
