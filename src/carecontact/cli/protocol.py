"""``carecontact protocol``: what the rules are, whether they equal their lock, and whether the robot can serve every
seed."""

from __future__ import annotations

import secrets
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import tyro

from carecontact.cli.groups import FLAT, JsonGroup
from carecontact.errors import ConfigError

if TYPE_CHECKING:
    from carecontact.episode.placed_persons import PlacementSurvey
    from carecontact.protocol.protocol import Protocol


# ``carecontact protocol feasible``: whether the robot can serve every seed of a protocol that parks it.


def feasible(levels: Sequence[Protocol], *, seeds: str, salts: int, picture: Path | None, json: bool) -> int:
    """Survey every seed on every level that parks the robot, and print a line for each level.

    Args:
        seeds: as ``--seeds`` of ``carecontact run``.
        salts: how many salted seeds besides, each with a fresh salt.
        picture: file for the map; None draws no map.

    Returns 1 if a seed is not feasible. Raises ConfigError for levels of which none parks the robot.
    """
    from carecontact.episode.placed_persons import draw_map, survey_placement
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
    rows: list[tuple[Protocol, list[PlacementSurvey]]] = []
    for rules in parking:
        found = [survey_placement(rules, seed, salt=salt) for seed, salt in wanted]
        rows.append((rules, found))
        _print(rules, found)
        if json:
            _say(rules, found)
    if picture is not None:
        draw_map(picture, rows)
        print(f"map: {picture}")
    return 0 if all(each.found is not None for _, found in rows for each in found) else 1


def _print(rules: Protocol, found: Sequence[PlacementSurvey]) -> None:
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


def _say(rules: Protocol, found: Sequence[PlacementSurvey]) -> None:
    from carecontact.cli.answers import FeasibleSeed, ProtocolFeasibleAnswer, RejectedPerson
    from carecontact.cli.console import print_answer

    def part(each: PlacementSurvey) -> FeasibleSeed:
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
    print_answer(ProtocolFeasibleAnswer(id=rules.name, feasible=served, seeds=[part(each) for each in found]))


# ``carecontact protocol``: what the rules are, and whether they equal their lock.


@dataclass(frozen=True, kw_only=True)
class Protocols:
    """List protocols, show one, verify that one still equals its lock (the file with its hashes), write the lock of
    your own protocol file, or check that the robot can serve every person that a protocol draws."""

    what: Annotated[Literal["list", "show", "verify", "lock", "feasible"], tyro.conf.Positional]
    """What to do: list all protocols, show one, verify it against its lock, write its lock, or check that the robot can
    serve every seed of it."""
    name: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="[NAME|FILE.toml]")] = "bathing-v3-draft"
    """Id of a shipped protocol, or a .toml file; `list` needs none."""

    level: str | None = None
    """Level of the protocol, where it has any; default: all of them."""
    seeds: str = "all"
    """For feasible: seeds to check, one (3), a list (0,4,7), a range (0-19), or all."""
    salts: int = 0
    """For feasible: how many salted seeds to check besides, each with a fresh salt."""
    picture: Path | None = None
    """For feasible: .png or .svg file for the map of the bed from above, with every place where the robot stands;
    default: feasible.png, and no map with --json."""
    output: Annotated[JsonGroup, FLAT] = field(default_factory=JsonGroup)

    after_interrupt: ClassVar[str] = ""

    def __call__(self) -> int:
        if self.what == "list" and not self.output.json:
            from carecontact.cli.names import List

            return List(what="protocols")()
        if self.output.json and self.what in ("list", "show"):
            say_list() if self.what == "list" else say_fields(self.name, self._levels())
            return 0
        if self.what == "show":
            return show(self.name, self._levels())
        if self.what == "feasible":
            picture = self.picture or (None if self.output.json else Path("feasible.png"))
            return feasible(self._levels(), seeds=self.seeds, salts=self.salts, picture=picture, json=self.output.json)
        each = {"verify": verify, "lock": lock}[self.what]
        return max(each(self.name, rules, json=self.output.json) for rules in self._levels())

    def _levels(self) -> list[Protocol]:
        """Return the level that was named, or all levels; for a protocol without levels, return the protocol alone."""
        from carecontact.protocol.load import load_levels, load_protocol

        if self.level is not None:
            return [load_protocol(self.name, level=self.level)]
        return list(load_levels(self.name).values())


def say_list() -> None:
    from carecontact.cli.answers import Listed, ProtocolListAnswer
    from carecontact.cli.console import print_answer
    from carecontact.protocol.load import load_levels, shipped_protocols

    loaded = [rules for name in shipped_protocols() for rules in load_levels(name).values()]
    rows = [Listed(id=p.name, sha256=p.sha256, frozen=p.frozen, description=p.description) for p in loaded]
    print_answer(ProtocolListAnswer(protocols=rows))


def say_fields(name: str, levels: Sequence[Protocol]) -> None:
    """Write one answer for each level."""
    from carecontact.cli.answers import ProtocolShowAnswer
    from carecontact.cli.console import print_answer
    from carecontact.protocol.lock import lock_path, read_lock

    for protocol in levels:
        held = read_lock(name, level=protocol.level)
        print_answer(
            ProtocolShowAnswer(
                id=protocol.name,
                sha256=protocol.sha256,
                frozen=protocol.frozen,
                lock=None if held is None else lock_path(name, level=protocol.level).name,
                fields=protocol.model_dump(mode="json"),
            )
        )


def show(name: str, levels: Sequence[Protocol]) -> int:
    """Print the file as it was written, with its comments, under a summary of its hashes, locks and tissue; of a file
    with a base, print the protocol that comes out. Of a single level of several, print that level's own table."""
    from carecontact.protocol.load import ancestry, merged_table, protocol_file, split, tables, toml_text
    from carecontact.protocol.lock import lock_path, read_lock

    for protocol in levels:
        held = read_lock(name, level=protocol.level)
        locked = "no lock" if held is None else lock_path(name, level=protocol.level).name
        print(f"# {protocol.name}, sha256 {protocol.sha256}")
        print(f"# {'frozen' if protocol.frozen else 'draft'}, {locked}")
    for region, row in levels[0].person.tissue.items():
        law = " + ".join(f"{v:g} x^{k}" for k, v in enumerate((row.a_n_m3, row.b_n_m4, row.c_n_m5), 1) if v)
        print(f"# {levels[0].person.tissue_set}, {region}: {law} [Pa], {row.damping_ns_m3:g} N s/m^3")
    print()
    bases = [place for place, _ in ancestry(name)][:-1]
    one = levels[0].level if len(levels) == 1 else ""
    if bases or one:
        table, what = merged_table(name), f"level {one} of {name}" if one else name
        if one:
            table = tables(*split(name, table))[one]
        over = f" over its base {', over '.join(reversed(bases))}" if bases else ""
        print(f"# {what}{over}; comments are left out\n")
        print(toml_text(table), end="")
        return 0
    print(protocol_file(name).read_text(encoding="utf-8"), end="")
    return 0


def verify(name: str, protocol: Protocol, *, json: bool = False) -> int:
    """Return 1 if anything differs from the lock, including the compiled worlds, or if there is no lock."""
    from carecontact.cli.answers import ProtocolVerifyAnswer
    from carecontact.cli.console import print_answer
    from carecontact.protocol.lock import lock_path
    from carecontact.runs.identity import drift, is_borrowed, lock_of, make_lock

    lock = lock_of(name, protocol)
    differences = [] if lock is None else drift(lock, make_lock(protocol))
    if lock is None and protocol.frozen:
        missing = lock_path(name, level=protocol.level).name
        print(
            f"{protocol.name} has frozen = true but no lock: {missing} is missing; restore it, or write one with: "
            "carecontact protocol lock FILE.toml"
        )
    elif lock is None:
        print(f"{protocol.name} has no lock: a draft, which may change with every release")
    else:
        if is_borrowed(name, protocol):
            print(f"{name} has the id of a shipped protocol, so it must equal the lock of that protocol")
        for line in differences:
            print(line)
        print(f"{protocol.name}: {'differs from its lock' if differences else 'equals its lock'}")
    equal = lock is not None and not differences
    if json:
        print_answer(ProtocolVerifyAnswer(id=protocol.name, equal=equal, differences=differences))
    return 0 if equal else 1


def lock(name: str, protocol: Protocol, *, json: bool = False) -> int:
    """Write FILE.lock.json beside the user's own protocol file."""
    from carecontact.protocol.load import shipped_protocols
    from carecontact.protocol.lock import lock_path, write_lock
    from carecontact.runs.identity import make_lock

    path = lock_path(name, level=protocol.level)
    if name in shipped_protocols():
        raise ConfigError(f"{name} is a shipped protocol; copy its file, give it an id of its own and lock that")
    if not protocol.frozen:
        raise ConfigError(f"{name} has frozen = false; set frozen = true, then lock it")
    if protocol.id in shipped_protocols():
        raise ConfigError(f"{name} has the id of a shipped protocol; a frozen file needs an id of its own")
    if path.exists():
        raise ConfigError(
            f"{path} exists already; if you changed the protocol, give it a new id (or, if nobody has run it yet, "
            "delete the lock)"
        )
    write_lock(make_lock(protocol), path)
    print(path)
    if json:
        from carecontact.cli.answers import ProtocolLockAnswer
        from carecontact.cli.console import print_answer

        print_answer(ProtocolLockAnswer(id=protocol.name, lock=str(path)))
    return 0
