"""``carecontact protocol``: what the rules are, whether they equal their lock, whether the robot can serve every seed,
and the secret of a salted run."""

from __future__ import annotations

import secrets
import shlex
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from carecontact.cli.console import print_answer
from carecontact.cli.groups import EXAM, JsonGroup
from carecontact.errors import ConfigError, counted

if TYPE_CHECKING:
    from carecontact.episode.placed_persons import PlacementSurvey
    from carecontact.protocol.protocol import Protocol


@dataclass(frozen=True, kw_only=True)
class ListProtocols:
    """List the shipped protocols, whether they are drafts, and their hashes."""

    output: JsonGroup = field(default_factory=JsonGroup)

    def __call__(self) -> int:
        from carecontact.cli.answers import Listed, ProtocolListAnswer
        from carecontact.cli.names import List
        from carecontact.protocol.load import load_levels, shipped_protocols

        if not self.output.json:
            return List(what="protocols")()
        loaded = [rules for name in shipped_protocols() for rules in load_levels(name).values()]
        rows = [Listed(id=p.name, sha256=p.sha256, frozen=p.frozen, description=p.description) for p in loaded]
        print_answer(ProtocolListAnswer(protocols=rows))
        return 0


@dataclass(frozen=True, kw_only=True)
class _OfProtocol:
    name: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="[NAME|FILE.toml]")] = EXAM
    """Id of a shipped protocol, or a .toml file."""
    level: str | None = None
    """Level of the protocol, where it has any; default: all of them."""
    output: JsonGroup = field(default_factory=JsonGroup)

    def levels(self) -> list[Protocol]:
        """Return the level that was named, or all levels; for a protocol without levels, return the protocol alone."""
        from carecontact.protocol.load import load_levels, load_protocol

        if self.level is not None:
            return [load_protocol(self.name, level=self.level)]
        return list(load_levels(self.name).values())


@dataclass(frozen=True, kw_only=True)
class Show(_OfProtocol):
    """Print a protocol as it was written, under its hash, its lock and its tissue laws; of a file with a base, print
    the whole protocol that comes out."""

    def __call__(self) -> int:
        from carecontact.cli.answers import ProtocolShowAnswer
        from carecontact.protocol.load import ancestry, by_level, merged_table, protocol_file, toml_text
        from carecontact.protocol.lock import lock_path, read_lock

        levels = self.levels()
        for protocol in levels:
            held = read_lock(self.name, level=protocol.level)
            lock = None if held is None else lock_path(self.name, level=protocol.level).name
            if self.output.json:
                print_answer(
                    ProtocolShowAnswer(
                        id=protocol.name,
                        sha256=protocol.sha256,
                        frozen=protocol.frozen,
                        lock=lock,
                        fields=protocol.model_dump(mode="json"),
                    )
                )
            else:
                print(f"# {protocol.name}, sha256 {protocol.sha256}")
                print(f"# {'frozen' if protocol.frozen else 'draft'}, {lock or 'no lock'}")
        if self.output.json:
            return 0
        for region, row in levels[0].person.tissue.items():
            law = " + ".join(f"{v:g} x^{k}" for k, v in enumerate((row.a_n_m3, row.b_n_m4, row.c_n_m5), 1) if v)
            print(f"# {levels[0].person.tissue_set}, {region}: {law} [Pa], {row.damping_ns_m3:g} N s/m^3")
        print()
        bases = [place for place, _ in ancestry(self.name)][:-1]
        one = levels[0].level if len(levels) == 1 else ""
        if not bases and not one:
            print(protocol_file(self.name).read_text(encoding="utf-8"), end="")
            return 0
        table, what = merged_table(self.name), f"level {one} of {self.name}" if one else self.name
        if one:
            table = by_level(self.name, table)[one]
        over = f" over its base {', over '.join(reversed(bases))}" if bases else ""
        print(f"# {what}{over}; comments are left out\n")
        print(toml_text(table), end="")
        return 0


@dataclass(frozen=True, kw_only=True)
class Verify(_OfProtocol):
    """Check that a protocol still equals its lock, the file with its hashes."""

    def __call__(self) -> int:
        return max(verify(self.name, rules, json=self.output.json) for rules in self.levels())


def verify(name: str, protocol: Protocol, *, json: bool = False) -> int:
    from carecontact.cli.answers import ProtocolVerifyAnswer
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


@dataclass(frozen=True, kw_only=True)
class Lock(_OfProtocol):
    """Write the lock of your own protocol, FILE.lock.json, beside its file."""

    def __call__(self) -> int:
        for rules in self.levels():
            self._lock(rules)
        return 0

    def _lock(self, protocol: Protocol) -> None:
        from carecontact.cli.answers import ProtocolLockAnswer
        from carecontact.protocol.load import shipped_protocols
        from carecontact.protocol.lock import lock_path, write_lock
        from carecontact.runs.identity import make_lock

        name, path = self.name, lock_path(self.name, level=protocol.level)
        if name in shipped_protocols():
            raise ConfigError(f"{name} is a shipped protocol; copy its file, give it an id of its own and lock that")
        if not protocol.frozen:
            raise ConfigError(f"{name} has frozen = false; set frozen = true, then lock it")
        if protocol.id in shipped_protocols():
            raise ConfigError(f"{name} has the id of a shipped protocol; a frozen file needs an id of its own")
        if path.exists():
            raise ConfigError(
                f"{path} exists already; if you changed the protocol, give it a new id (or, if no one has run it yet, "
                "delete the lock)"
            )
        write_lock(make_lock(protocol), path)
        print(path)
        if self.output.json:
            print_answer(ProtocolLockAnswer(id=protocol.name, lock=str(path)))


@dataclass(frozen=True, kw_only=True)
class Feasible(_OfProtocol):
    """Check that the robot can serve every person that a protocol draws, on every level that parks the robot."""

    seeds: str = "all"
    """Seeds to check: one (3), a list (0,4,7), a range (0-19), or all."""
    salts: int = 0
    """How many salted seeds to check besides, each with a fresh salt."""
    picture: Path | None = None
    """The .png or .svg file for the map of the bed from above, with every place where the robot stands; default:
    feasible.png, and no map with --json."""

    def __call__(self) -> int:
        from carecontact.episode.placed_persons import draw_map, survey_placement
        from carecontact.runs.plan import parse_seeds

        levels = self.levels()
        picture = self.picture or (None if self.output.json else Path("feasible.png"))
        if self.salts < 0:
            raise ConfigError(f"--salts {self.salts}: expected 0 or more")
        parking = [rules for rules in levels if rules.variation.parking is not None]
        if not parking:
            names = ", ".join(rules.name for rules in levels)
            raise ConfigError(f"{names}: the robot stands at scene.robot_base_m in every trial; nothing is drawn")
        if picture is not None and picture.suffix not in (".png", ".svg"):
            raise ConfigError(f"--picture {picture}: expected a .png or .svg file")
        wanted = [(seed, "") for seed in parse_seeds(self.seeds, protocol=parking[0])]
        wanted += [(number, secrets.token_hex(16)) for number in range(self.salts)]
        rows: list[tuple[Protocol, list[PlacementSurvey]]] = []
        for rules in parking:
            found = [survey_placement(rules, seed, salt=salt) for seed, salt in wanted]
            rows.append((rules, found))
            _print(rules, found)
            if self.output.json:
                _answer(rules, found)
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


def _answer(rules: Protocol, found: Sequence[PlacementSurvey]) -> None:
    from carecontact.cli.answers import FeasibleSeed, ProtocolFeasibleAnswer, RejectedPerson

    seeds: list[FeasibleSeed] = []
    for each in found:
        rejected = [
            RejectedPerson(
                comfort_arm_deg=one.posture.comfort_arm_deg,
                shoulder_rotation_deg=one.posture.shoulder_rotation_deg,
                palm_deg=one.posture.palm_deg,
                region=one.region,
                refused=dict(Counter(one.refused)),
            )
            for one in (each.found.rejected if each.found else [])
        ]
        seeds.append(
            FeasibleSeed(
                seed=each.seed,
                salted=bool(each.salt),
                feasible=each.found is not None,
                body=each.found.body if each.found else None,
                draws=each.draws,
                refused=dict(each.refused),
                rejected=rejected,
            )
        )
    served = all(each.found is not None for each in found)
    print_answer(ProtocolFeasibleAnswer(id=rules.name, feasible=served, seeds=seeds))


@dataclass(frozen=True, kw_only=True)
class Salt:
    """Make a secret for `carecontact run --salt-file` and print its sha256, to be published before the run; reveal the
    secret in a finished run; or verify that a run was made with the secret that it committed to."""

    what: Annotated[Literal["make", "reveal", "verify"], tyro.conf.Positional]
    """What to do: write a new secret into a file; write the secret into a run's manifest, where everybody can read it;
    or check a run whose secret is revealed."""
    place: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE|RUN")]
    """The file to make, or the folder of the run."""
    salt_file: Path | None = None
    """File with the secret of the run, for `reveal`."""

    def __call__(self) -> int:
        from carecontact.runs.lock import folder_lock
        from carecontact.runs.manifest import make_salt, read_salt, reveal_salt

        if (self.what == "reveal") != (self.salt_file is not None):
            raise ConfigError("--salt-file: `protocol salt reveal RUN` needs it, and only that")
        if self.what == "verify":
            return self._verify()
        if self.salt_file is None:
            print(
                f"{self.place}: keep it secret until every run is done; its sha256, to be published before the first:"
            )
            print(make_salt(self.place))
            return 0
        with folder_lock(self.place):
            reveal_salt(self.place, read_salt(self.salt_file))
        command = f"carecontact protocol salt verify {shlex.quote(str(self.place))}"
        print(f"{self.place}: the salt is revealed; anyone can check it with `{command}`")
        return 0

    def _verify(self) -> int:
        from carecontact.audit.salt import verify_salt

        found = verify_salt(self.place)
        for fault in found.faults:
            print(fault)
        checked = f"{counted(found.recordings, 'recording')}, {counted(found.draws, 'draw')} made again"
        print(f"{'FAILED' if found.faults else 'verified'}: sha256 {found.sha256}, {checked}")
        return 1 if found.faults else 0
