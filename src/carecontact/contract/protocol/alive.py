"""What the person does by itself: breathing, changes of posture, withdrawal, and how it bears being moved.

A table that a protocol leaves out is something that its persons do not do. A range is (low, high), from which a seed
draws uniformly.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from carecontact.contract.protocol.section import Section

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
    (``world.life``)."""

    @property
    def uses_the_arm(self) -> bool:
        """Whether the arm needs muscles."""
        return self.repositioning is not None or self.withdrawal is not None or self.manner != "passive"
