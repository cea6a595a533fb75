"""``carecontact protocol feasible``: whether the robot can serve every seed of a protocol that parks it."""

from __future__ import annotations

import secrets
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from carecontact.errors import ConfigError

if TYPE_CHECKING:
    from carecontact.contract.protocol import Protocol
    from carecontact.episode.parking.survey import Surveyed


def feasible(levels: Sequence[Protocol], *, seeds: str, salts: int, picture: Path | None, json: bool) -> int:
    """Survey every seed on every level that parks the robot, and print a line for each level.

    Args:
        seeds: as ``--seeds`` of ``carecontact run``.
        salts: how many salted seeds besides, each with a fresh salt.
        picture: file for the map; None draws no map.

    Returns 1 if a seed is not feasible. Raises ConfigError for levels of which none parks the robot.
    """
    from carecontact.episode.parking.map import draw_map
    from carecontact.episode.parking.survey import survey
    from carecontact.runs.plan import parse_seeds

    if salts < 0:
        raise ConfigError(f"--salts {salts}: expected 0 or more")
    parking = [rules for rules in levels if rules.variation.parking is not None]
    if not parking:
        names = ", ".join(rules.name for rules in levels)
        raise ConfigError(f"{names}: the robot stands at scene.robot_base_m in every trial; nothing is drawn")
    if picture is not None and picture.suffix not in (".png", ".svg"):
        raise ConfigError(f"--picture {picture}: expected a .png or .svg file")
    wanted = [(seed, "") for seed in parse_seeds(seeds, protocol=parking[0])]
    wanted += [(number, secrets.token_hex(16)) for number in range(salts)]
    rows: list[tuple[Protocol, list[Surveyed]]] = []
    for rules in parking:
        found = [survey(rules, seed, salt=salt) for seed, salt in wanted]
        rows.append((rules, found))
        _print(rules, found)
        if json:
            _say(rules, found)
    if picture is not None:
        draw_map(picture, rows)
        print(f"map: {picture}")
    return 0 if all(each.found is not None for _, found in rows for each in found) else 1


def _print(rules: Protocol, found: Sequence[Surveyed]) -> None:
    served = [each for each in found if each.found is not None]
    print(f"{rules.name}: {len(served)} of {len(found)} seeds feasible")
    for each in found:
        if each.found is None:
            print(f"  not feasible: {each.why}")
    again: Counter[str] = Counter()
    for each in served:
        assert each.found is not None
        for lost in each.found.rejected:
            again[f"{each.found.body}, {lost.region.replace('_', ' ') or 'does not come to rest'}"] += 1
    print(f"  persons drawn again: {sum(again.values())}" + "".join(f"; {n} {what}" for what, n in again.most_common()))
    for region in rules.regions:
        draws = sorted(each.draws[region] for each in served)
        if draws:
            print(f"  {region}: bases drawn, median {draws[len(draws) // 2]}, most {draws[-1]}")
    refused: Counter[str] = sum((each.refused for each in served), Counter())
    print("  bases refused: " + (", ".join(f"{n} {reason}" for reason, n in refused.most_common()) or "none"))


def _say(rules: Protocol, found: Sequence[Surveyed]) -> None:
    from carecontact.cli.answers.protocol import FeasibleSeed, ProtocolFeasibleAnswer, RejectedPerson
    from carecontact.cli.json_lines import say

    def part(each: Surveyed) -> FeasibleSeed:
        lost = [] if each.found is None else each.found.rejected
        return FeasibleSeed(
            seed=each.seed, salted=bool(each.salt), feasible=each.found is not None,
            body=None if each.found is None else each.found.body, draws=each.draws, refused=dict(each.refused),
            rejected=[
                RejectedPerson(
                    comfort_arm_deg=one.posture.comfort_arm_deg, palm_deg=one.posture.palm_deg,
                    shoulder_rotation_deg=one.posture.shoulder_rotation_deg, region=one.region,
                    refused=dict(Counter(one.refused)),
                )
                for one in lost
            ],
        )  # fmt: skip

    served = all(each.found is not None for each in found)
    say(ProtocolFeasibleAnswer(id=rules.name, feasible=served, seeds=[part(each) for each in found]))
