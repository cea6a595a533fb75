"""Draws a seed's person until the robot can serve all their regions on every level, and keeps what was found."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.contract.protocol import Alive, Protocol, Variation
from carecontact.episode.draws import Posture, body_of, overhead_of, posture_of, streams
from carecontact.episode.parking.bases import Search, search
from carecontact.episode.parking.grounds import REFUSALS, Base, Ground, Refusal
from carecontact.episode.parking.laid import Laid, lay_down
from carecontact.errors import SceneError, SettleError
from carecontact.kernel.found import sha256 as kernel_sha256
from carecontact.world.human.library import load_body
from carecontact.world.kept import Arrays, kept
from carecontact.world.place import place_of

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
class Parked:
    """The result for one seed: the accepted person and, for one level, where the robot stands for each region."""

    body: str
    posture: Posture
    rejected: tuple[Rejected, ...]
    """The persons who were drawn before this one."""
    laid: Laid
    """The person, settled in the protocol's own place with the robot far away."""
    bases: dict[str, Base]
    refused: dict[str, tuple[Refusal, ...]]
    """Region -> why each draw of a base before the one that serves was refused."""


def parked(protocol: Protocol, seed: int, *, salt: str = "") -> Parked:
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
    found = kept("parked", facts, lambda: _search(protocol, variations, seed, salt))
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
    return Parked(
        body=body, posture=posture_of(protocol, seed, salt, taken), rejected=rejected, bases=bases,
        laid=Laid(**{field.name: found[f"laid_{field.name}"] for field in fields(Laid)}),
        refused={name: _reasons(row) for name, row in zip(regions, found["refused"][level], strict=True)},
    )  # fmt: skip


def grounds_of(protocol: Protocol, seed: int, salt: str, laid: Laid, posture: Posture) -> Ground:
    """Return the surroundings of a person on this level, for a person who was laid in the protocol's own place."""
    place = place_of(posture.place, protocol.variation)
    here = laid.at(place)
    wrist = max((level.reposition_m for level in protocol.levels.values()), default=0.0)
    moved = tuple(here.repositioned(way * wrist, protocol.regions) for way in (-1.0, 1.0)) if wrist else ()
    low, high = (np.array([*corner, 0.0]) for corner in (protocol.scene.board_low_m, protocol.scene.board_high_m))
    turn = place.moved(np.eye(3)) - place.moved(np.zeros(3))
    return Ground(
        protocol=protocol, laid=here, moved=moved, overhead=overhead_of(protocol, seed, salt),
        board_turn=turn.T, board_middle=place.moved((low + high) / 2),
    )  # fmt: skip


def _search(protocol: Protocol, variations: Sequence[Variation], seed: int, salt: str) -> Arrays:
    """Search a seed's person and bases, and return them as arrays that can be stored.

    ``taken`` is the number of the accepted person or -1. Of that person there are ``bases`` (V, R, 4), ``refused``
    (V, R, n) and the fields of ``Laid``; of the k persons before, ``rejected_region`` (k,) and ``rejected_refused``
    (k, n). V counts levels and R regions. Reasons are indices into REFUSALS, padded with -1.
    """
    lost: list[tuple[str, Search]] = []
    body = body_of(protocol, seed, salt)
    for number in range(MOST_PERSONS):
        posture = posture_of(protocol, seed, salt, number)
        try:
            laid = lay_down(_still(posed(protocol, body, posture)), posture.comfort_arm_deg)
        except SettleError:
            lost.append(("", Search(base=None, refused=())))
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


def _lost(persons: Sequence[tuple[str, Search]]) -> Arrays:
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


def _bases(protocol: Protocol, seed: int, salt: str, laid: Laid, posture: Posture) -> list[Search]:
    """Return one search for each region, up to the first region that has no base."""
    ground, out = grounds_of(protocol, seed, salt, laid, posture), []
    parking = protocol.variation.parking
    assert parking is not None
    for region in protocol.regions:
        drawn = streams(protocol, seed, salt)
        out.append(search(ground, region, parking, place=drawn["park"], height=drawn["bed_height"]))
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
    world = Path(__file__).parents[2] / "world"
    files = [*sorted(Path(__file__).parent.glob("*.py")), *sorted(world.rglob("*.py"))]
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()
