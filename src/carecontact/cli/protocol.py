"""``carecontact protocol``: what the rules are, and whether they equal their lock."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import tyro

from carecontact.cli.groups import FLAT, JsonGroup
from carecontact.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from carecontact.contract.protocol import Protocol


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
            from carecontact.cli.feasible import feasible

            picture = self.picture or (None if self.output.json else Path("feasible.png"))
            return feasible(self._levels(), seeds=self.seeds, salts=self.salts, picture=picture, json=self.output.json)
        each = {"verify": verify, "lock": lock}[self.what]
        return max(each(self.name, rules, json=self.output.json) for rules in self._levels())

    def _levels(self) -> list[Protocol]:
        """Return the level that was named, or all levels; for a protocol without levels, return the protocol alone."""
        from carecontact.protocols import load_levels, load_protocol

        if self.level is not None:
            return [load_protocol(self.name, level=self.level)]
        return list(load_levels(self.name).values())


def say_list() -> None:
    from carecontact.cli.answers.protocol import Listed, ProtocolListAnswer
    from carecontact.cli.json_lines import say
    from carecontact.protocols import load_levels, shipped_protocols

    loaded = [rules for name in shipped_protocols() for rules in load_levels(name).values()]
    rows = [Listed(id=p.name, sha256=p.sha256, frozen=p.frozen, description=p.description) for p in loaded]
    say(ProtocolListAnswer(protocols=rows))


def say_fields(name: str, levels: Sequence[Protocol]) -> None:
    """Write one answer for each level."""
    from carecontact.cli.answers.protocol import ProtocolShowAnswer
    from carecontact.cli.json_lines import say
    from carecontact.protocols.lock import lock_path, read_lock

    for protocol in levels:
        held = read_lock(name, level=protocol.level)
        say(
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
    from carecontact.protocols import protocol_file
    from carecontact.protocols.inherit import ancestry
    from carecontact.protocols.levels import split, tables
    from carecontact.protocols.load import merged_table
    from carecontact.protocols.lock import lock_path, read_lock
    from carecontact.protocols.toml_text import toml_text

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
    from carecontact.cli.answers.protocol import ProtocolVerifyAnswer
    from carecontact.cli.json_lines import say
    from carecontact.protocols.lock import lock_path
    from carecontact.runs.freeze import drift, is_borrowed, lock_of, make_lock

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
        say(ProtocolVerifyAnswer(id=protocol.name, equal=equal, differences=differences))
    return 0 if equal else 1


def lock(name: str, protocol: Protocol, *, json: bool = False) -> int:
    """Write FILE.lock.json beside the user's own protocol file."""
    from carecontact.protocols import shipped_protocols
    from carecontact.protocols.lock import lock_path, write_lock
    from carecontact.runs.freeze import make_lock

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
        from carecontact.cli.answers.protocol import ProtocolLockAnswer
        from carecontact.cli.json_lines import say

        say(ProtocolLockAnswer(id=protocol.name, lock=str(path)))
    return 0
