"""The skin of a region, kicked and left alone: inertia, damper and spring that the compiled tissue computes with.

If all vertices move alike and nothing touches them, neighbours exert no force, and each vertex follows
m w'' + d w' + a w = 0. The kick dies within some m / d, which shows the inertia; what it displaced returns within some
d / a, which shows spring and damper. In slow contact, the inertia shows nowhere.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from carecontact.kernel.readings import Readings
from carecontact.validation.result import Array, Measure
from carecontact.validation.subject import Subject

KICK_M_S = 0.02
"""Speed of the kick; the skin moves by some 10 um, so that its spring is linear."""
KICK_STEPS, RETURN_STEPS, PARTS = 100, 100, 25
"""Physics steps while the kick dies and while the skin returns, and how many of them are in each of the two times."""
SMALLEST_M = 1e-12
"""Change in a sweep below which the solver stops, instead of the 1 um that is enough for contact."""
SWEEPS = 500
LIMIT_PERCENT = 1.0


@dataclass(frozen=True, kw_only=True)
class FreeSkin:
    dies_s: float
    """Time in which a kick dies, m / d."""
    returns_s: float
    """Time in which displaced skin returns, d / a."""


def measures(subject: Subject, region: str) -> Iterator[Measure]:
    found, wanted = free_skin(subject, region), declared(subject, region)
    for name, at, of in (
        ("a kick of the skin dies (its inertia over its damper)", found.dies_s, wanted.dies_s),
        ("displaced skin returns (its damper over its spring)", found.returns_s, wanted.returns_s),
    ):
        yield Measure(name=f"{region}: time in which {name}, off the declared {1000 * of:.3g} ms", unit="%",
                      value=100 * abs(at / of - 1), limit=LIMIT_PERCENT)  # fmt: skip


def declared(subject: Subject, region: str) -> FreeSkin:
    tissue = subject.tissue(region)
    return FreeSkin(
        dies_s=tissue.areal_mass_kg_m2 / tissue.damping_ns_m3, returns_s=tissue.damping_ns_m3 / tissue.a_n_m3
    )  # fmt: skip


def free_skin(subject: Subject, region: str) -> FreeSkin:
    """Kick the skin of the settled person, whom nothing touches, and fit both times to its motion."""
    simulation = subject.at_rest(region)
    model, data, felt = simulation.model, simulation.data, simulation.tissue[region]
    model.numeric(f"{region}/options").data[1:3] = SMALLEST_M, SWEEPS
    wanted = declared(subject, region)
    # Vertices at rest stay out of the solver's window.
    felt.set_motion(data, np.array([SMALLEST_M, 0.0, 0.0]), np.array([KICK_M_S, 0.0, 0.0]))
    rows = [_follow(model, data, felt, time_s / PARTS, steps) for time_s, steps in (
        (wanted.dies_s, KICK_STEPS), (wanted.returns_s, RETURN_STEPS),
    )]  # fmt: skip
    damper, spring = -np.linalg.lstsq(rows[0][:, 1:], rows[0][:, 0], rcond=None)[0]
    # The return says more of the spring, and hardly anything of the inertia.
    late = rows[1]
    spring = -float(late[:, 2] @ (late[:, 0] + damper * late[:, 1]) / (late[:, 2] @ late[:, 2]))
    return FreeSkin(dies_s=float(1 / damper), returns_s=float(damper / spring))


def _follow(model: mujoco.MjModel, data: mujoco.MjData, felt: Readings, dt_s: float, steps: int) -> Array:
    """Return, at each of ``steps`` steps (steps, 3): acceleration [m/s^2], speed [m/s] and displacement [m] inward, as
    medians over the vertices."""
    model.opt.timestep = dt_s
    rows, before = [], float(np.median(felt.rate(data)[:, 0]))
    for _ in range(steps):
        mujoco.mj_step(model, data)
        rate, at = (float(np.median(of(data)[:, 0])) for of in (felt.rate, felt.displacement))
        rows.append(((rate - before) / dt_s, rate, at))
        before = rate
    return np.array(rows)
