"""Who lies on the bed, and how the soft regions answer a press."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from carecontact.contract.protocol.alive import Alive
from carecontact.contract.protocol.section import Length, Positive, Section
from carecontact.contract.protocol.task import RegionName

LARGEST_CONTACT = 300
"""Largest ratio of ``contact_n_m3`` to ``a_n_m3``."""


class Calibration(Section):
    """What ``carecontact calibrate`` found of a row. Errors are those on held-out trials; None if there are none."""

    verdict: Literal["accepted", "rejected"]
    nrmse: float | None = None
    tangent_error: float | None = None
    work_error: float | None = None
    """Of the work that all trials lose together."""
    reasons: tuple[str, ...] = ()
    """Why it was rejected."""


class Tissue(Section):
    """One region's shell. Area-specific anchor law p = a x + b x |x| + c x^3 for inward displacement x."""

    a_n_m3: Positive
    """[N/m per m^2 of shell]"""
    b_n_m4: float
    """Below zero the law is softer at first than a straight line; see ``_convex``."""
    c_n_m5: Annotated[float, Field(ge=0)]
    damping_ns_m3: Positive
    """[N s/m per m^2]"""
    damping_growth_ns_m4: Annotated[float, Field(ge=0)] = 0.0
    """How much the damping grows with a metre of indentation, as in Hunt and Crossley's contact (1975, J Appl Mech
    42:440)."""
    coupling_length_m: Annotated[float, Field(ge=0, le=0.02)]
    """How far f_int spreads a load along the surface: a gradient of the indentation is resisted with G = a l^2 [N/m]
    (Pasternak's foundation). 0: neighbours act alone."""
    membrane_n_m: Annotated[float, Field(ge=0, le=20_000)] = 0.0
    """In-plane stiffness of the skin (Young's modulus times thickness): a patch that the tool drags along pulls its
    neighbours with it. 0: no membrane; neighbouring patches move independently."""
    contact_n_m3: Positive
    """[N/m per m^2] of the layer between the shell and the tool, which stands for skin compressed across its thickness:
    its pressure over the depth by which the tool's surface lies in it, for small depths (``kernel.region.LAYER_M``)."""
    areal_mass_kg_m2: Positive
    spacing_m: Length
    """Vertex spacing on the patch that the tool can reach."""
    coarse_spacing_m: Length
    """Largest spacing away from it."""
    thickness_m: Length
    """Depth of the rigid core under the surface; less where a thin limb's axis is nearer."""
    measured_depth_m: Length
    """Anchor displacement that the presses to which the law was fitted reach on this mesh: deeper is extrapolated. The
    indenter's travel is more, since the contact gives way too."""
    friction: Annotated[float, Field(gt=0, le=2)]
    bmi_kg_m2: Annotated[float, Field(ge=10, le=80)] | None = None
    """Body mass index of the person whom thickness and law are of: on another body they change with its own
    (``world.human.build``). None: they are the same on every body."""
    source: Annotated[str, Field(min_length=1)]
    calibration: Calibration | None = None
    """None for a row that ``carecontact calibrate`` did not write."""

    @model_validator(mode="after")
    def _solvable(self) -> Self:
        """The solver was tried with a layer of contact up to LARGEST_CONTACT times as stiff as the anchors."""
        if self.contact_n_m3 > LARGEST_CONTACT * self.a_n_m3:
            raise ValueError(
                f"contact_n_m3 {self.contact_n_m3:g} is too stiff to be solved with a_n_m3 {self.a_n_m3:g}: expected "
                f"at most {LARGEST_CONTACT} a = {LARGEST_CONTACT * self.a_n_m3:g}"
            )
        return self

    @model_validator(mode="after")
    def _convex(self) -> Self:
        """The tangent a + 2 b x + 3 c x^2 must be positive at every depth."""
        if self.b_n_m4 < 0 and self.b_n_m4**2 >= 3 * self.a_n_m3 * self.c_n_m5:
            raise ValueError(
                f"b_n_m4 {self.b_n_m4:g} makes the law soften under load: expected b^2 < 3 a c = "
                f"{3 * self.a_n_m3 * self.c_n_m5:g}"
            )
        return self

    @model_validator(mode="after")
    def _measured_above_the_bone(self) -> Self:
        if self.measured_depth_m > self.thickness_m:
            raise ValueError(
                f"measured_depth_m {self.measured_depth_m:g} is more than thickness_m {self.thickness_m:g}: no press "
                "went into the bone"
            )
        return self


class Person(Section):
    body: str
    tissue_set: str
    tissue: dict[RegionName, Tissue]
    """One row for each soft region of the protocol, and no other (``Protocol.soft_regions``)."""
    alive: Alive = Alive()
    shoulder_rotation_deg: Annotated[float, Field(ge=-80, le=0)] = 0.0
    """How far the right upper arm is turned outward in the lying pose (below zero), which bends the elbow along the
    arm board."""
    palm_deg: Annotated[float, Field(ge=-90, le=60)] = 0.0
    """How far the right forearm is turned from palm up: above zero farther in supination, below zero toward the
    thumb up."""

    @property
    def rejected_tissue(self) -> str:
        """The regions with a rejected calibration, each with the first reason for it; empty if there are none."""
        rows = {name: row.calibration for name, row in self.tissue.items() if row.calibration is not None}
        return "; ".join(
            f"{name.replace('_', ' ')} ({', '.join(found.reasons[:1]) or 'no reason given'})"
            for name, found in rows.items() if found.verdict == "rejected"
        )  # fmt: skip
