"""Draws person and base together, rejects persons that no base can serve, and maps what was rejected."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from carecontact.cache import Arrays, cached, source_sha256
from carecontact.episode.base_placement import (
    REFUSALS,
    Base,
    LyingPerson,
    PlacementCheck,
    Refusal,
    base_draws,
    farthest_wrist_m,
    lying_person,
)
from carecontact.errors import SceneError, SettleError
from carecontact.human.library import load_body
from carecontact.plotting import plain_figures
from carecontact.protocol.gates import Vec3
from carecontact.protocol.person import Alive
from carecontact.protocol.protocol import Protocol
from carecontact.protocol.sections import Variation
from carecontact.tissue.plugin import loaded_sha256
from carecontact.world.draws import Posture, body_of, place_of, posture_of, streams
from carecontact.world.room import BED_HALF_M

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PACKAGE = Path(__file__).parents[1]
MOST_PERSONS = 40
"""Most persons that are drawn for one seed; after them, the seed counts as not feasible."""
DECIDES = (
    *("place_along_m", "place_across_m", "place_yaw_deg", "place_toward_head_m"),
    *("overhead_shift_m", "overhead_turn_deg", "parking"),
)
"""Fields of a level's variation that decide whether a base serves."""


@dataclass(frozen=True, kw_only=True)
class Rejected:
    """A person who was drawn and rejected."""

    posture: Posture
    region: str
    """The region for which no base was found on one of the levels; empty if the person did not come to rest."""
    refused: tuple[Refusal, ...]
    """Why each draw of a base for that region was refused."""


@dataclass(frozen=True, kw_only=True)
class PlacedPerson:
    """The result for one seed: the accepted person and, for one level, where the robot stands for each region."""

    body: str
    posture: Posture
    rejected: tuple[Rejected, ...]
    """The persons who were drawn before this one."""
    laid: LyingPerson
    """The person, settled in the protocol's own place with the robot far away."""
    bases: dict[str, Base]
    refused: dict[str, tuple[Refusal, ...]]
    """Region -> why each draw of a base before the one that serves was refused."""


def placed_person(protocol: Protocol, seed: int, *, salt: str = "") -> PlacedPerson:
    """Return a seed's person and the robot's bases beside them, for a protocol whose variation parks the robot.

    A seed has the same person on every level of the protocol. A person is therefore rejected if, on any level, some
    region has no base, also after the arm has moved as far as any level allows.

    Raises SceneError, naming the seed, if none of MOST_PERSONS persons suits.
    """
    variations, body = _variations(protocol), body_of(protocol, seed, salt)
    facts = {
        "protocol": _decisive(protocol, variations),
        "seed": seed,
        "salt": salt,
        "versions": [mujoco.__version__, np.__version__, loaded_sha256()],
        "sources": [source_sha256(PACKAGE / part) for part in ("episode", "human", "tissue", "world")],
        "body": load_body(body).sha256,
    }
    kept = cached("parked", facts, lambda: _search(protocol, variations, seed, salt))
    found = json.loads(str(kept["found"]))
    rejected = tuple(
        Rejected(posture=posture_of(protocol, seed, salt, number), region=region, refused=tuple(refused))
        for number, (region, refused) in enumerate(found["rejected"])
    )
    if not found["levels"]:
        raise SceneError(
            f"seed {seed} of {protocol.id}: none of {MOST_PERSONS} draws of {body} lies so that the robot can stand "
            f"beside it for every region; widen variation.parking (last region: {rejected[-1].region or 'unsettled'})"
        )
    level = found["levels"][variations.index(_decisive_part(protocol.variation))]
    return PlacedPerson(
        body=body,
        posture=posture_of(protocol, seed, salt, len(rejected)),
        rejected=rejected,
        laid=LyingPerson(**{field.name: kept[field.name] for field in fields(LyingPerson)}),
        bases={region: Base(position_m=(x, y, z), yaw_deg=yaw) for region, ((x, y, z), yaw, _) in level.items()},
        refused={region: tuple(refused) for region, (_, _, refused) in level.items()},
    )


def _search(protocol: Protocol, variations: Sequence[Variation], seed: int, salt: str) -> Arrays:
    """``found`` has the region and refusals of each rejected person, and the base of each region for each variation."""
    rejected: list[tuple[str, list[Refusal]]] = []
    for number in range(MOST_PERSONS):
        posture = posture_of(protocol, seed, salt, number)
        still = _still(posed(protocol, body_of(protocol, seed, salt), posture))
        try:
            laid = lying_person(still, posture.comfort_arm_deg)
        except SettleError:
            rejected.append(("", []))
            continue
        levels: list[dict[str, tuple[Vec3, float, list[Refusal]]]] = [{} for _ in variations]
        for level, (region, base, refused) in _bases(protocol, variations, seed, salt, laid, posture):
            if base is None:
                rejected.append((region, refused))
                break
            levels[level][region] = (base.position_m, base.yaw_deg, refused)
        else:
            return {"found": np.array(json.dumps({"rejected": rejected, "levels": levels})), **laid.arrays()}
    return {"found": np.array(json.dumps({"rejected": rejected, "levels": []}))}


def _bases(
    protocol: Protocol, variations: Sequence[Variation], seed: int, salt: str, laid: LyingPerson, posture: Posture
) -> Iterator[tuple[int, tuple[str, Base | None, list[Refusal]]]]:
    """Yield, for each variation and region, the first base that serves, or None, and why those before were refused."""
    for level, variation in enumerate(variations):
        check = PlacementCheck(protocol.model_copy(update={"variation": variation}), seed, salt, laid, posture)
        for region in protocol.regions:
            refused: list[Refusal] = []
            for base in _draws(check.protocol, region, seed, salt):
                if (reason := check.refusal(base, region)) is None:
                    yield level, (region, base, refused)
                    break
                refused.append(reason)
            else:
                yield level, (region, None, refused)


def _draws(protocol: Protocol, region: str, seed: int, salt: str) -> Iterator[Base]:
    """Yield the bases that a seed draws for a region, in their order."""
    drawn, parking = streams(protocol, seed, salt), protocol.variation.parking
    assert parking is not None
    return base_draws(parking, region, place=drawn["park"], height=drawn["bed_height"])


def posed(protocol: Protocol, body: str, posture: Posture) -> Protocol:
    """Return the protocol with this body and the turn of the arm of this posture."""
    turn = {"shoulder_rotation_deg": posture.shoulder_rotation_deg, "palm_deg": posture.palm_deg}
    return protocol.model_copy(update={"person": protocol.person.model_copy(update={"body": body, **turn})})


def _still(protocol: Protocol) -> Protocol:
    return protocol.model_copy(update={"person": protocol.person.model_copy(update={"alive": Alive()})})


def _variations(protocol: Protocol) -> list[Variation]:
    """Return the distinct variations of all levels that park the robot, reduced to fields that decide about bases."""
    every = [*(level.variation for level in protocol.levels.values()), protocol.variation]
    found = [_decisive_part(variation) for variation in every if variation.parking is not None]
    return [variation for number, variation in enumerate(found) if variation not in found[:number]]


def _decisive_part(variation: Variation) -> Variation:
    return Variation(**{name: getattr(variation, name) for name in DECIDES})


def _decisive(protocol: Protocol, variations: Sequence[Variation]) -> dict[str, object]:
    """Return everything in a protocol that decides who is drawn and which bases serve."""
    sections = {"physics", "phases", "scene", "impedance", "cameras"}
    drawn = {"bodies", "shoulder_rotation_deg", "palm_deg"}
    return {
        # How large a camera's pictures are decides nothing.
        **protocol.model_dump(mode="json", include=sections, exclude={"cameras": {"__all__": {"width", "height"}}}),
        "drawn_as": protocol.drawn_as,
        "person": _still(protocol).person.model_dump(mode="json"),
        "comfort_arm_deg": protocol.randomization.comfort_arm_deg,
        "regions": protocol.regions,
        "variations": [variation.model_dump(mode="json") for variation in variations],
        "reposition_m": farthest_wrist_m(protocol),
        "drawn": protocol.variation.model_dump(mode="json", include=drawn),
    }


@dataclass(frozen=True, kw_only=True)
class PlacementSurvey:
    """Whether the robot can serve one seed on one level, and what had to be drawn again for that."""

    seed: int
    salt: str
    found: PlacedPerson | None
    """The person and the bases; None if the seed is not feasible."""
    why: str = ""

    @property
    def draws(self) -> dict[str, int]:
        """Region -> number of draws of a base, including the one that serves."""
        return {} if self.found is None else {name: len(row) + 1 for name, row in self.found.refused.items()}

    @property
    def refused(self) -> Counter[str]:
        """Reason -> number of bases that were refused for it beside the accepted person."""
        return Counter() if self.found is None else Counter(chain.from_iterable(self.found.refused.values()))


def survey_placement(protocol: Protocol, seed: int, *, salt: str = "") -> PlacementSurvey:
    """Draw the person and the bases of one seed, for a protocol whose variation parks the robot."""
    try:
        return PlacementSurvey(seed=seed, salt=salt, found=placed_person(protocol, seed, salt=salt))
    except SceneError as error:
        return PlacementSurvey(seed=seed, salt=salt, found=None, why=str(error))


COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Colours of the regions, in their order (those of Okabe and Ito, which people with any colour vision can
distinguish)."""
OF_REASONS = "#bbbbbb #8c6d31 #e377c2 #7f7f7f #bcbd22 #17becf #000000 #9467bd #d62728 #ff9896".split()
REASONS = dict(zip(REFUSALS, OF_REASONS, strict=True))
ARROW_M = 0.09
MOST_REFUSED = 40
"""Most refused draws that the map shows for one search: the last ones before the draw that serves."""


@plain_figures()
def draw_map(path: Path, rows: Sequence[tuple[Protocol, Sequence[PlacementSurvey]]]) -> None:
    """Draw the bed from above, a row for each level: on the left people and bases that serve, on the right refused
    bases."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 5.6 * len(rows)), layout="constrained")
    panels = np.atleast_2d(figure.subplots(len(rows), 2))
    for (protocol, surveys), (taken, refused) in zip(rows, panels, strict=True):
        _draw_bed(taken, f"{protocol.name}: where people lie and where the robot stands")
        _draw_bed(refused, f"{protocol.name}: places that were refused")
        for survey in surveys:
            if survey.found is not None:
                _draw_person(taken, protocol, survey.found)
                _draw_refusals(refused, protocol, survey, survey.found)
        _draw_legend(taken, {name: COLOURS[k % len(COLOURS)] for k, name in enumerate(protocol.regions)})
        shown = {reason for survey in surveys for reason in survey.refused}
        _draw_legend(refused, {reason: colour for reason, colour in REASONS.items() if reason in shown})
    figure.savefig(path, dpi=110)


def _draw_bed(axes: Axes, title: str) -> None:
    from matplotlib.patches import Rectangle

    length, width = BED_HALF_M
    axes.add_patch(Rectangle((-width, -length), 2 * width, 2 * length, facecolor="#e8eef2", edgecolor="#8899a0"))
    axes.text(0.0, length - 0.1, "head end", ha="center", color="#667780", fontsize=8)
    axes.set(xlim=(1.15, -0.5), ylim=(-0.75, 1.05), aspect="equal")
    axes.set(title=title, xlabel="y, to the person's right [m]", ylabel="x, to the head [m]")
    axes.title.set_fontsize(10)


def _draw_person(axes: Axes, protocol: Protocol, found: PlacedPerson) -> None:
    laid = found.laid.at(place_of(found.posture.place, protocol.variation))
    axes.plot(laid.limb[:, 1], laid.limb[:, 0], color="#555555", linewidth=0.5, alpha=0.6)
    for number, name in enumerate(protocol.regions):
        colour, base = COLOURS[number % len(COLOURS)], found.bases[name]
        axes.plot(laid.skin[number, :, 1], laid.skin[number, :, 0], color=colour, linewidth=1.6, alpha=0.6)
        x, y, _ = base.position_m
        ahead = ARROW_M * base.turn[:2, 0]
        arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": 0.8, "alpha": 0.8}
        axes.annotate("", xy=(y + ahead[1], x + ahead[0]), xytext=(y, x), arrowprops=arrow)


def _draw_refusals(axes: Axes, protocol: Protocol, survey: PlacementSurvey, found: PlacedPerson) -> None:
    for region, reasons in found.refused.items():
        draws = _draws(protocol, region, survey.seed, survey.salt)
        for base, reason in list(zip(draws, reasons, strict=False))[-MOST_REFUSED:]:
            axes.plot(base.position_m[1], base.position_m[0], ".", color=REASONS[reason], markersize=3, alpha=0.6)


def _draw_legend(axes: Axes, colours: dict[str, str]) -> None:
    for name, colour in colours.items():
        axes.plot([], [], "s", color=colour, label=name.replace("_", " "))
    if colours:
        axes.legend(loc="lower right", fontsize=8, framealpha=0.9)
