"""The answers of the finite elements, from geometry, materials and one published force: nothing here simulates."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator

from carecontact.errors import CarecontactError
from carecontact.validation.fem.answer import Answer, Curve, Drag, rings
from carecontact.validation.fem.cases import DEPTHS_M, TRAVEL_M, WAYS_M, Case
from carecontact.validation.fem.contact import balance
from carecontact.validation.fem.glide import glide, stuck_stiffness
from carecontact.validation.fem.ground import Medium
from carecontact.validation.fem.kernel import Kernel, Spectrum, finest
from carecontact.validation.fem.materials import FRICTION, MATCHED_M, Skin
from carecontact.validation.fem.surface import PRESS, Surface, around
from carecontact.validation.fem.tools import Tool
from carecontact.validation.result import Array

SOLVED_M = np.r_[np.linspace(0.0, 0.001, 11), np.linspace(0.00125, 0.002, 4), np.linspace(0.0024, TRAVEL_M, 10)]
"""Travels past geometric touch at which a press is solved; between them, the force is interpolated."""
TOLD_M = np.linspace(0.0, TRAVEL_M, 241)
PATCHES, FINEST_M, COARSEST_M = 18, 0.00045, 0.0010
"""Number of patches over a tool's reach, and bounds of their side. If a test halves the side, forces change by at most
1 %."""
GLIDING_M = 0.0012
"""Side of the patches under a gliding tool, which needs many more of them."""
MARGIN = 1.05
FIRST_GUESS_PA = 15e3
MATCHED, MOST_SOLVES = 0.001, 15


class Sample:
    """A medium in which presses are solved; kernels are computed once for each size of patch."""

    def __init__(self, medium: Medium, *, refined: float = 1.0) -> None:
        """``refined``: how many times finer the patches are than usual."""
        self.medium, self._refined = medium, refined
        self._kernels: dict[float, Kernel] = {}

    @cached_property
    def _spectrum(self) -> Spectrum:
        return Spectrum(self.medium, finest(FINEST_M / self._refined))

    def press(self, tool: Tool, travels_m: ArrayLike) -> Array:
        """Return the force (n,) [N] of a frictionless press at increasing travels past geometric touch."""
        surface = self._under(tool)
        joint, active, forces = surface.compliance((PRESS,), (PRESS,)), None, []
        for travel in np.asarray(travels_m):
            push, active = balance(joint, surface.gap(tool, float(travel)), active)
            forces.append(surface.count * push.sum())
            active = active if active.any() else None
        return np.array(forces)

    def curve(self, tool: Tool) -> Curve:
        force = PchipInterpolator(SOLVED_M, self.press(tool, SOLVED_M))(TOLD_M)
        return Curve(presses=((TOLD_M, force),))

    def dimple(self, tool: Tool, travel_m: float) -> tuple[Array, Array]:
        """Return the share of the travel by which the surface moves along it at RINGS_M, and by which it sinks around
        the limb (``Answer``).
        """
        surface = self._under(tool)
        push, _ = balance(surface.compliance((PRESS,), (PRESS,)), surface.gap(tool, travel_m))
        places, inward, sunk = surface.everywhere(push)
        return rings(places, inward) / travel_m, rings(places, sunk, beside=True) / travel_m

    def drag(self, tool: Tool, travel_m: float, friction: float) -> Drag:
        step = GLIDING_M / self._refined
        radius, reach = self.medium.ground.limb_radius_m, MARGIN * tool.reach_m(travel_m) + 2 * step
        stiffness, contact = stuck_stiffness(around(self._kernel(step), radius, reach, glides=True), tool, travel_m)
        way = around(self._kernel(step), radius, reach, glides=True, ahead_m=float(WAYS_M[-1]))
        found = glide(way, tool, travel_m, WAYS_M, friction)
        return Drag(
            way_m=WAYS_M, force_n=found.tangential_n, normal_n=found.normal_n, stuck_n_m=stiffness,
            contact_radius_m=contact,
        )  # fmt: skip

    def _under(self, tool: Tool) -> Surface:
        reach = tool.reach_m(TRAVEL_M)
        step = float(np.clip(reach / PATCHES, FINEST_M, COARSEST_M)) / self._refined
        return around(self._kernel(step), self.medium.ground.limb_radius_m, MARGIN * reach + 2 * step)

    def _kernel(self, step_m: float) -> Kernel:
        if step_m not in self._kernels:
            self._kernels[step_m] = Kernel(self._spectrum, step_m)
        return self._kernels[step_m]


def answer(case: Case, skin: Skin) -> Answer:
    """Return how the case's ground with this skin responds, with the tissue's modulus fitted to the reference's middle
    curve.

    Raises CarecontactError if no modulus fits.
    """
    found = matched(case, skin)
    curves = {name: found.curve(tool) for name, tool in case.tools().items()}
    drags = {
        tool.name: found.drag(tool, curves[tool.name].touch_m() + float(DEPTHS_M[-1]), FRICTION)
        for tool in case.gliding()
    }
    dimple, beside = found.dimple(case.main, MATCHED_M)
    return Answer(curves=curves, dimple=dimple, beside=beside, drags=drags, modulus_pa=found.medium.tissue_pa)


def sample(case: Case, skin: Skin, answered: Answer) -> Sample:
    """Return the medium of an answer, to compute more of it."""
    return Sample(Medium(ground=case.ground, skin=skin, tissue_pa=answered.modulus_pa))


def matched(case: Case, skin: Skin) -> Sample:
    """Return the medium whose tissue gives the reference's force at MATCHED_M past touch.

    It uses the secant method on the logarithms of modulus and force. Raises CarecontactError if it finds none.
    """
    wanted = float(np.interp(MATCHED_M, case.reference.depth_m, case.reference.force_n))
    modulus, power, last = FIRST_GUESS_PA, 0.6, None
    for _ in range(MOST_SOLVES):
        tried = Sample(Medium(ground=case.ground, skin=skin, tissue_pa=modulus))
        off = float(np.log(tried.curve(case.main).at(np.array([MATCHED_M]))[0] / wanted))
        if abs(off) < MATCHED:
            return tried
        if last is not None:
            power = (off - last[1]) / (np.log(modulus) - last[0])
        last = float(np.log(modulus)), off
        modulus *= float(np.exp(np.clip(-off / power, -2.0, 2.0)))
    raise CarecontactError(
        f"finite elements: no modulus of the {case.region}'s tissue gives {wanted:.2f} N under a skin of "
        f"{1000 * skin.thickness_m:.1f} mm and {skin.modulus_pa / 1e6:.2f} MPa"
    )
