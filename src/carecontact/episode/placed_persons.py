"""Draws person and base together, rejects persons that no base can serve, and maps what was rejected."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cache
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.cache import Arrays, cached
from carecontact.episode.base_placement import (
    REFUSALS,
    Base,
    BaseSearch,
    LyingPerson,
    PlacementCheck,
    Refusal,
    base_draws,
    lying_person,
    search_base,
)
from carecontact.errors import SceneError, SettleError
from carecontact.human.library import load_body
from carecontact.plotting import plain_figures
from carecontact.protocol.person import Alive
from carecontact.protocol.protocol import Protocol
from carecontact.protocol.sections import Variation
from carecontact.tissue.binary_lookup import binary_sha256 as kernel_sha256
from carecontact.world.randomization import Posture, body_of, overhead_of, place_of, posture_of, streams
from carecontact.world.room import BED_HALF_M

if TYPE_CHECKING:
    from matplotlib.axes import Axes


# Draws a seed's person until the robot can serve all their regions on every level, and keeps what was found.

MOST_PERSONS = 40
"""Most persons that are drawn for one seed; after them, the seed counts as not feasible."""
DECIDES = ("place_along_m", "place_across_m", "place_yaw_deg", "place_toward_head_m", "overhead_shift_m",
           "overhead_turn_deg", "parking")  # fmt: skip
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
    variations, regions = _variations(protocol), protocol.regions
    facts = {
        "protocol": _decisive(protocol, variations), "seed": seed, "salt": salt, "mujoco": mujoco.__version__,
        "numpy": np.__version__, "kernel": kernel_sha256(), "source": _source_sha256(),
        "body": load_body(body_of(protocol, seed, salt)).sha256,
    }  # fmt: skip
    found = cached("parked", facts, lambda: _search(protocol, variations, seed, salt))
    body, taken = body_of(protocol, seed, salt), int(found["taken"])
    level = variations.index(_decisive_part(protocol.variation))
    rejected = tuple(
        Rejected(posture=posture_of(protocol, seed, salt, number), region=str(region), refused=_reasons(refused))
        for number, (region, refused) in enumerate(
            zip(found["rejected_region"], found["rejected_refused"], strict=True)
        )
    )
    if taken < 0:
        raise SceneError(
            f"seed {seed} of {protocol.id}: none of {MOST_PERSONS} draws of {body} lies so that the robot can stand "
            f"beside it for every region; widen variation.parking (last region: {rejected[-1].region or 'unsettled'})"
        )
    bases = {
        region: Base(position_m=(float(x), float(y), float(z)), yaw_deg=float(yaw))
        for region, (x, y, z, yaw) in zip(regions, found["bases"][level], strict=True)
    }
    return PlacedPerson(
        body=body, posture=posture_of(protocol, seed, salt, taken), rejected=rejected, bases=bases,
        laid=LyingPerson(**{field.name: found[f"laid_{field.name}"] for field in fields(LyingPerson)}),
        refused={name: _reasons(row) for name, row in zip(regions, found["refused"][level], strict=True)},
    )  # fmt: skip


def placement_check_of(protocol: Protocol, seed: int, salt: str, laid: LyingPerson, posture: Posture) -> PlacementCheck:
    """Return the surroundings of a person on this level, for a person who was laid in the protocol's own place."""
    place = place_of(posture.place, protocol.variation)
    here = laid.at(place)
    wrist = max((level.reposition_m for level in protocol.levels.values()), default=0.0)
    moved = tuple(here.repositioned(way * wrist, protocol.regions) for way in (-1.0, 1.0)) if wrist else ()
    low, high = (np.array([*corner, 0.0]) for corner in (protocol.scene.board_low_m, protocol.scene.board_high_m))
    turn = place.moved(np.eye(3)) - place.moved(np.zeros(3))
    return PlacementCheck(
        protocol=protocol, laid=here, moved=moved, overhead=overhead_of(protocol, seed, salt),
        board_turn=turn.T, board_middle=place.moved((low + high) / 2),
    )  # fmt: skip


def _search(protocol: Protocol, variations: Sequence[Variation], seed: int, salt: str) -> Arrays:
    """Search a seed's person and bases, and return them as arrays that can be stored.

    ``taken`` is the number of the accepted person or -1. Of that person there are ``bases`` (V, R, 4), ``refused``
    (V, R, n) and the fields of ``Laid``; of the k persons before, ``rejected_region`` (k,) and ``rejected_refused``
    (k, n). V counts levels and R regions. Reasons are indices into REFUSALS, padded with -1.
    """
    lost: list[tuple[str, BaseSearch]] = []
    body = body_of(protocol, seed, salt)
    for number in range(MOST_PERSONS):
        posture = posture_of(protocol, seed, salt, number)
        try:
            laid = lying_person(_still(posed(protocol, body, posture)), posture.comfort_arm_deg)
        except SettleError:
            lost.append(("", BaseSearch(base=None, refused=())))
            continue
        rows = [
            _bases(protocol.model_copy(update={"variation": varied}), seed, salt, laid, posture)
            for varied in variations
        ]  # fmt: skip
        lacking = [(name, s) for row in rows for name, s in zip(protocol.regions, row, strict=False) if s.base is None]
        if not lacking:
            bases = [[(*s.base.position_m, s.base.yaw_deg) for s in row if s.base is not None] for row in rows]
            refused = [[s.refused for s in row] for row in rows]
            return {
                "taken": np.array(number), "bases": np.array(bases), "refused": _numbers(refused),
                **{f"laid_{name}": values for name, values in laid.arrays().items()}, **_lost(lost),
            }  # fmt: skip
        lost.append(lacking[0])
    return {"taken": np.array(-1), **_lost(lost)}


def _lost(persons: Sequence[tuple[str, BaseSearch]]) -> Arrays:
    return {
        "rejected_region": np.array([region for region, _ in persons], dtype="U64"),
        "rejected_refused": _numbers([[search.refused for _, search in persons]])[0],
    }


def _numbers(refused: Sequence[Sequence[Sequence[Refusal]]]) -> npt.NDArray[np.int8]:
    """Return indices (V, R, n) into REFUSALS, padded with -1."""
    longest = max((len(reasons) for row in refused for reasons in row), default=0)
    out = np.full((len(refused), max(len(row) for row in refused), longest), -1, np.int8)
    for v, row in enumerate(refused):
        for r, reasons in enumerate(row):
            out[v, r, : len(reasons)] = [REFUSALS.index(reason) for reason in reasons]
    return out


def _reasons(numbers: npt.NDArray[np.int8]) -> tuple[Refusal, ...]:
    return tuple(REFUSALS[number] for number in numbers.tolist() if number >= 0)


def _bases(protocol: Protocol, seed: int, salt: str, laid: LyingPerson, posture: Posture) -> list[BaseSearch]:
    """Return one search for each region, up to the first region that has no base."""
    ground, out = placement_check_of(protocol, seed, salt, laid, posture), []
    parking = protocol.variation.parking
    assert parking is not None
    for region in protocol.regions:
        drawn = streams(protocol, seed, salt)
        out.append(search_base(ground, region, parking, place=drawn["park"], height=drawn["bed_height"]))
        if out[-1].base is None:
            break
    return out


def posed(protocol: Protocol, body: str, posture: Posture) -> Protocol:
    """Return the protocol with this body and the turn of the arm of this posture."""
    person = protocol.person.model_copy(update={
        "body": body, "shoulder_rotation_deg": posture.shoulder_rotation_deg, "palm_deg": posture.palm_deg
    })  # fmt: skip
    return protocol.model_copy(update={"person": person})


def _still(protocol: Protocol) -> Protocol:
    return protocol.model_copy(update={"person": protocol.person.model_copy(update={"alive": Alive()})})


def _variations(protocol: Protocol) -> list[Variation]:
    """Return the variations of this level and of all levels that park the robot, each once, reduced to the fields that
    decide about bases.
    """
    every = [*(level.variation for level in protocol.levels.values()), protocol.variation]
    found = [_decisive_part(variation) for variation in every if variation.parking is not None]
    return [variation for number, variation in enumerate(found) if variation not in found[:number]]


def _decisive_part(variation: Variation) -> Variation:
    return Variation(**{name: getattr(variation, name) for name in DECIDES})


def _decisive(protocol: Protocol, variations: Sequence[Variation]) -> dict[str, object]:
    """Return everything in a protocol that decides who is drawn and which bases serve."""
    sections = ("physics", "phases", "scene", "impedance", "cameras")
    wrist = max((level.reposition_m for level in protocol.levels.values()), default=0.0)
    return {
        **{name: protocol.model_dump(mode="json")[name] for name in sections},
        "drawn_as": protocol.drawn_as, "person": _still(protocol).person.model_dump(mode="json"),
        "comfort_arm_deg": protocol.randomization.comfort_arm_deg, "regions": protocol.regions,
        "variations": [variation.model_dump(mode="json") for variation in variations], "reposition_m": wrist,
        "bodies": protocol.variation.bodies,
        "arm": [protocol.variation.shoulder_rotation_deg, protocol.variation.palm_deg],
    }  # fmt: skip


@cache
def _source_sha256() -> str:
    """Return the hash of this folder's source and of all source that shapes a person or the robot's arm."""
    package = Path(__file__).parents[1]
    parts = ("episode", "human", "tissue", "world")
    files = [path for part in parts for path in sorted((package / part).rglob("*.py"))]
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()


# Whether the robot can serve every seed of a protocol, and what had to be drawn again for that.


@dataclass(frozen=True, kw_only=True)
class PlacementSurvey:
    """The result for one seed on one level."""

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
        rows = () if self.found is None else self.found.refused.values()
        return Counter(reason for row in rows for reason in row)


def survey_placement(protocol: Protocol, seed: int, *, salt: str = "") -> PlacementSurvey:
    """Draw the person and the bases of one seed, for a protocol whose variation parks the robot."""
    try:
        return PlacementSurvey(seed=seed, salt=salt, found=placed_person(protocol, seed, salt=salt))
    except SceneError as error:
        return PlacementSurvey(seed=seed, salt=salt, found=None, why=str(error))


# The bed from above: where the people lie, where the robot stands beside them, and which places were refused.

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Colours of the regions, in their order (those of Okabe and Ito, which people with any colour vision can
distinguish)."""
REASONS = dict(zip(REFUSALS, ("#bbbbbb", "#8c6d31", "#e377c2", "#7f7f7f", "#bcbd22", "#17becf", "#000000", "#9467bd",
                              "#d62728", "#ff9896"), strict=True))  # fmt: skip
ARROW_M = 0.09
MOST_REFUSED = 40
"""Most refused draws that the map shows for one search: the last ones before the draw that serves."""


@plain_figures()
def draw_map(path: Path, rows: Sequence[tuple[Protocol, Sequence[PlacementSurvey]]]) -> None:
    """Write a PNG or SVG picture, by the file's name, with one row of panels for each level.

    The left panel shows the places that serve, the right one the places that were refused beside the same people.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 5.6 * len(rows)), layout="constrained")
    panels = np.atleast_2d(figure.subplots(len(rows), 2))
    for (protocol, found), (taken, refused) in zip(rows, panels, strict=True):
        _ground(taken, protocol, f"{protocol.name}: where people lie and where the robot stands")
        _ground(refused, protocol, f"{protocol.name}: places that were refused")
        for each in found:
            _people(taken, protocol, each)
            _refused(refused, protocol, each)
        _legend(taken, {name: COLOURS[k % len(COLOURS)] for k, name in enumerate(protocol.regions)})
        shown = {reason for each in found for reason in each.refused}
        _legend(refused, {reason: colour for reason, colour in REASONS.items() if reason in shown})
    figure.savefig(path, dpi=110)


def _ground(axes: Axes, protocol: Protocol, title: str) -> None:
    from matplotlib.patches import Rectangle

    length, width = BED_HALF_M
    axes.add_patch(Rectangle((-width, -length), 2 * width, 2 * length, facecolor="#e8eef2", edgecolor="#8899a0"))
    axes.text(0.0, length - 0.1, "head end", ha="center", color="#667780", fontsize=8)
    axes.set(xlim=(1.15, -0.5), ylim=(-0.75, 1.05), aspect="equal", title=title, xlabel="y, to the person's right [m]",
             ylabel="x, to the head [m]")  # fmt: skip
    axes.title.set_fontsize(10)


def _people(axes: Axes, protocol: Protocol, each: PlacementSurvey) -> None:
    if each.found is None:
        return
    laid = each.found.laid.at(place_of(each.found.posture.place, protocol.variation))
    axes.plot(laid.limb[:, 1], laid.limb[:, 0], color="#555555", linewidth=0.5, alpha=0.6)
    for number, name in enumerate(protocol.regions):
        colour, base = COLOURS[number % len(COLOURS)], each.found.bases[name]
        axes.plot(laid.skin[number, :, 1], laid.skin[number, :, 0], color=colour, linewidth=1.6, alpha=0.6)
        x, y, _ = base.position_m
        ahead = ARROW_M * base.turn[:2, 0]
        axes.annotate(
            "", xy=(y + ahead[1], x + ahead[0]), xytext=(y, x),
            arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 0.8, "alpha": 0.8},
        )  # fmt: skip


def _refused(axes: Axes, protocol: Protocol, each: PlacementSurvey) -> None:
    parking = protocol.variation.parking
    if each.found is None or parking is None:
        return
    for region, reasons in each.found.refused.items():
        drawn = streams(protocol, each.seed, each.salt)
        bases = list(islice(base_draws(parking, region, place=drawn["park"], height=drawn["bed_height"]), len(reasons)))
        for base, reason in list(zip(bases, reasons, strict=True))[-MOST_REFUSED:]:
            axes.plot(base.position_m[1], base.position_m[0], ".", color=REASONS[reason], markersize=3, alpha=0.6)


def _legend(axes: Axes, colours: dict[str, str]) -> None:
    for name, colour in colours.items():
        axes.plot([], [], "s", color=colour, label=name.replace("_", " "))
    if colours:
        axes.legend(loc="lower right", fontsize=8, framealpha=0.9)
