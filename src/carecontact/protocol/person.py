"""The person of a protocol: body, posture, tissue, and what they do on their own."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from carecontact.protocol.gates import Length, Positive, RegionName, Section

# What the person does by itself: breathing, changes of posture, withdrawal, and how it bears being moved.
#
# A table that a protocol leaves out is something that its persons do not do. A range is (low, high), from which a seed
# draws uniformly.

Range = tuple[float, float]


def _within(low: float, high: float, unit: str) -> AfterValidator:
    """Checks that a range is one, and lies between two values."""

    def check(pair: Range) -> Range:
        if not low <= pair[0] <= pair[1] <= high:
            raise ValueError(
                f"expected [low, high] {unit} with low at most high, both in {low:g} to {high:g}, got "
                f"[{pair[0]:g}, {pair[1]:g}]"
            )
        return pair

    return AfterValidator(check)


class Breathing(Section):
    """The abdomen's wall and the front of the chest rise and fall; the visible skin goes with them.

    Only the abstracts of Ragnarsdottir and De Groote were read; neither gives the movement of a lying person's abdomen.
    """

    frequency_hz: Annotated[Range, _within(0.05, 1.0, "Hz")] = (0.20, 0.33)
    """12 to 20 breaths a minute; quiet breathing has 14 (Ragnarsdottir and Kristinsdottir 2006, Respiration 73:48, 100
    healthy people)."""
    abdomen_m: Annotated[Range, _within(0.0, 0.03, "m")] = (0.005, 0.015)
    """How far the abdomen's wall moves outward from the end of a breath out to that of a breath in (assumed)."""
    chest_m: Annotated[Range, _within(0.0, 0.02, "m")] = (0.002, 0.005)
    """The same of the chest: 3 to 5 mm in five seated people (De Groote et al. 1997, J Appl Physiol 83:1531); less in
    people who lie (assumed)."""
    inspiration_share: Annotated[float, Field(ge=0.2, le=0.8)] = 0.455
    """Share of a breath in which the person breathes in: in to out as 1 to 1.2 (Ragnarsdottir and Kristinsdottir 2006:
    1.21 in men, 1.14 in women)."""


class Repositioning(Section):
    """The person moves the right arm to another place on its board, now and then (all assumed).

    A change of posture begins from where the arm lies then, wherever it was pushed.
    """

    per_minute: Annotated[float, Field(gt=0, le=20)] = 4.0
    """Mean number of onsets. They come at a constant rate over the whole trial, whatever the robot does, but never
    before the movement before has ended."""
    wrist_m: Annotated[Range, _within(0.01, 0.15, "m")] = (0.04, 0.08)
    """How far the wrist moves along the board."""
    duration_s: Annotated[Range, _within(0.4, 5.0, "s")] = (0.9, 1.2)


class Withdrawal(Section):
    """The person pulls the right arm away from a force on it that lasts (all assumed).

    The force is the largest of those on upper arm, forearm and hand, as vector sums. At most three withdrawals happen
    in a trial, at least 2 s apart. A withdrawal ends a change of posture, and none begins during one.
    """

    force_n: Annotated[Range, _within(1.0, 200.0, "N")] = (20.0, 30.0)
    for_s: Annotated[float, Field(gt=0, le=5)] = 0.05
    """How long the force must last without a break."""
    delay_s: Annotated[float, Field(gt=0, le=2)] = 0.1
    """Time from then until the arm begins to move."""
    duration_s: Annotated[float, Field(ge=0.2, le=5)] = 0.5
    wrist_m: Annotated[float, Field(gt=0, le=0.15)] = 0.08
    """How far the wrist moves along the board, toward the trunk."""


class Alive(Section):
    """What the person does by itself; by default, nothing."""

    breathing: Breathing | None = None
    repositioning: Repositioning | None = None
    withdrawal: Withdrawal | None = None
    manner: Literal["passive", "helps", "holds"] = "passive"
    """How the right arm bears being moved. People with dementia often resist movement without wanting to, or go along
    with it (oppositional and facilitatory paratonia; Drenth et al. 2020, J Alzheimers Dis 78:1615, abstract): ``holds``
    keeps muscles tense, ``helps`` takes most of the passive joints' resistance away. Their sizes are assumed
    (``world.draws.TONE``, ``HELP``)."""

    @property
    def uses_the_arm(self) -> bool:
        """Whether the arm needs muscles."""
        return self.repositioning is not None or self.withdrawal is not None or self.manner != "passive"


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
    """Below zero the law is softer at first than a straight line; see ``_solvable``."""
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
    its pressure over the depth by which the tool's surface lies in it, for small depths (``LAYER_M``)."""
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
    (``human.soft_region.tissue_of``). None: they are the same on every body."""
    source: Annotated[str, Field(min_length=1)]
    calibration: Calibration | None = None
    """None for a row that ``carecontact calibrate`` did not write."""

    @model_validator(mode="after")
    def _solvable(self) -> Self:
        # The solver was tried with a layer of contact up to so many times as stiff as the anchors.
        if self.contact_n_m3 > LARGEST_CONTACT * self.a_n_m3:
            raise ValueError(
                f"contact_n_m3 {self.contact_n_m3:g} is too stiff to be solved with a_n_m3 {self.a_n_m3:g}: expected "
                f"at most {LARGEST_CONTACT} a = {LARGEST_CONTACT * self.a_n_m3:g}"
            )
        # The tangent a + 2 b x + 3 c x^2 must be positive at every depth.
        if self.b_n_m4 < 0 and self.b_n_m4**2 >= 3 * self.a_n_m3 * self.c_n_m5:
            raise ValueError(
                f"b_n_m4 {self.b_n_m4:g} makes the law soften under load: expected b^2 < 3 a c = "
                f"{3 * self.a_n_m3 * self.c_n_m5:g}"
            )
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
        rejected: list[str] = []
        for name, row in self.tissue.items():
            if row.calibration is not None and row.calibration.verdict == "rejected":
                reason = (*row.calibration.reasons, "")[0] or "no reason given"
                rejected.append(f"{name.replace('_', ' ')} ({reason})")
        return "; ".join(rejected)
