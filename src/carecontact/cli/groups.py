"""Options that several commands share, with the heading of their box in the help, and what they name: one trial, a
place, stored scores."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import tyro

from carecontact.errors import ConfigError, did_you_mean

if TYPE_CHECKING:
    from carecontact.protocol.protocol import Protocol
    from carecontact.runs.pooling import RunScores


EXAM, DEVELOPMENT_SEEDS = "bathing-wide-v2", "0-2"
"""Defaults of ``protocol.load``, which costs too much time to import for a page of help; a test compares them."""
Switch = Annotated[bool, tyro.conf.FlagCreatePairsOff]
Verbose = Annotated[bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(aliases=["-v"])]


@dataclass(frozen=True, kw_only=True)
class JsonGroup:
    heading: ClassVar = "output"
    json: Switch = False
    """For programs: print JSON on standard output, one object a line, and everything else on standard error (see
    docs/python.md)."""


@dataclass(frozen=True, kw_only=True)
class VerboseGroup(JsonGroup):
    verbose: Verbose = False
    """Also print medians, counts, limits, speed and the files that were written."""


@dataclass(frozen=True, kw_only=True)
class ProtocolGroup:
    heading: ClassVar = "protocol"
    protocol: str = EXAM
    """Id of a shipped protocol (see `carecontact list protocols`) or a .toml file."""
    level: str | None = None
    """Level of the protocol, where it has any: the exam has L0, L1, L2 and L3; default: L2."""


@dataclass(frozen=True, kw_only=True)
class ChangedProtocolGroup(ProtocolGroup):
    """Which protocol, and which of its fields are replaced."""

    changes: Annotated[
        tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(name="set", metavar="FIELD=VALUE")
    ] = ()
    """Replace a field of the protocol, such as physics.dt_s=0.004 or gates.touch.duration_s=1; repeat the option for
    more. Every output names the change. If a field does not exist, the error lists those that do."""
    allow_rejected: Switch = False
    """Use tissue whose calibration was rejected (see docs/person.md). Every report then says so."""

    def load(self) -> Protocol:
        from carecontact.protocol.load import load_protocol

        return self.changed(load_protocol(self.protocol, level=self.level))

    def changed(self, protocol: Protocol, **options: Mapping[str, object]) -> Protocol:
        """Return ``protocol`` with these changes and those of other options, by the option's name."""
        from carecontact.protocol.overrides import check_accepted, overridden

        changes: dict[str, object] = {}
        for option, given in {"set": self._set(), **self._others(), **options}.items():
            for path in given:
                if path in changes:
                    raise ConfigError(f"--{option}: another option replaces {path}, too; give only one of them")
            changes |= given
        rules = overridden(protocol, changes)
        check_accepted(rules, allowed=self.allow_rejected)
        return rules

    def _set(self) -> dict[str, object]:
        found: dict[str, object] = {}
        for text in self.changes:
            path, equals, value = text.partition("=")
            if not path or not equals:
                raise ConfigError(f"--set {text}: expected FIELD=VALUE, for example --set physics.dt_s=0.004")
            if path in found:
                raise ConfigError(f"--set: {path} is replaced twice; give it once")
            found[path] = value
        return found

    def _others(self) -> dict[str, Mapping[str, object]]:
        return {}


@dataclass(frozen=True, kw_only=True)
class RulesGroup(ChangedProtocolGroup):
    """Which protocol, and which person in place of the protocol's own."""

    body: str | None = None
    """Person in place of the protocol's: a name from `carecontact list bodies` or smplx:FILE.npz?sex=F (or M). Every
    output names this change, and carecontact never pools such trials with those of the unchanged protocol."""

    def _others(self) -> dict[str, Mapping[str, object]]:
        if self.body is None:
            return {}
        check_body(self.body)
        return {"body": {"person.body": self.body}}


def check_body(name: str) -> None:
    from carecontact.human.library import load_body

    try:
        load_body(name)
    except ConfigError as error:
        raise ConfigError(f"--body: {error}") from None


@dataclass(frozen=True, kw_only=True)
class PhysicsGroup:
    heading: ClassVar = "physics"
    tissue: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """Tissue in place of the protocol's: a name from `carecontact list tissue` or a .toml file that `carecontact
    calibrate` wrote. Repeat the option for files of other regions."""
    friction: str | None = None
    """Coefficient of friction between tool and skin in place of the tissue's: a number, or dry (0.5), wet (1.0) or
    soapy (0.2); see docs/person.md for the sources. Every output names this change."""
    tool: str | None = None
    """What the robot's hand wears in place of the protocol's: rigid `caps` over the fingertips, or a soft wash `mitt`.
    Every output names this change."""
    fast: Switch = False
    """Use physics steps of 4 ms in place of the protocol's. This is faster and less exact: use it for development."""

    def changes(self, rules: Protocol) -> dict[str, Mapping[str, object]]:
        """The option's name -> the fields of ``rules`` that it replaces, for ``ChangedProtocolGroup.changed``."""
        from carecontact.protocol.overrides import FAST_DT_S, friction_changes

        changes: dict[str, Mapping[str, object]] = {}
        if self.tissue:
            changes["tissue"] = {"person.tissue_set": self.tissue}
        if self.friction is not None:
            changes["friction"] = friction_changes(rules, self.friction)
        if self.tool is not None:
            changes["tool"] = {"scene.tool": self.tool}
        if self.fast:
            changes["fast"] = {"physics.dt_s": FAST_DT_S}
        return changes


@dataclass(frozen=True, kw_only=True)
class VisionGroup:
    heading: ClassVar = "vision"
    segmenter: Literal["mediapipe", "grounded-sam"] | None = None
    """Model that makes the masks of the person; default: the one in the protocol (shipped protocols: mediapipe).
    Landmarks always come from mediapipe. See docs/evidence/perception.md."""
    weights: Path | None = None
    """Folder with the weights of --segmenter grounded-sam. carecontact never downloads weights."""


@dataclass(frozen=True, kw_only=True)
class EngineGroup:
    heading: ClassVar = "engine"
    engine: Literal["local", "ray"] = "local"
    """Where the trials run: on this machine, or on the nodes of the Ray cluster that RAY_ADDRESS names (see
    docs/machines.md)."""
    jobs: int | None = None
    """Number of trials that run at once; default: one per core, of this machine or of the cluster. A policy's server
    gets as many connections."""
    gpus: float = 0.0
    """Share of a GPU that a Ray cluster reserves for each trial, such as 0.25, for a policy that runs beside its
    trial."""


@dataclass(frozen=True, kw_only=True)
class SaltGroup:
    heading: ClassVar = "salt"
    salt_file: Path | None = None
    """File with a secret from `carecontact protocol salt make`, on which every draw of every trial then depends, so
    that no one knows beforehand which person a seed has. A run states the secret's sha256 before its first trial; its
    parts, if it has any, need the same file."""

    @property
    def salt(self) -> str:
        """The salt, which is empty without a file."""
        from carecontact.runs.manifest import read_salt

        return "" if self.salt_file is None else read_salt(self.salt_file)

    @property
    def closed(self) -> tuple[str, ...]:
        return () if self.salt_file is None else (str(self.salt_file.resolve()),)


@dataclass(frozen=True, kw_only=True)
class ArgumentsGroup:
    heading: ClassVar = "policy"
    policy_arg: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="NAME=VALUE")] = ()
    """Argument for the policy's constructor; `carecontact list policies` shows those of registered policies. Repeat the
    option for more. The recordings of a run store name and value."""
    policy_env: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="NAME")] = ()
    """Environment variable of this shell to pass on to the policy's process. Repeat the option for more. The recordings
    of a run store its name, not its value."""
    policy_read: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="PATH")] = ()
    """File or folder that the isolated policy may read besides its own folder, its arguments and the installed
    packages. Repeat the option for more. The recordings of a run name it (see docs/trust.md)."""
    policy_write: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="PATH")] = ()
    """File or folder that the isolated policy may read and write besides its temporary folder. Repeat the option for
    more. The recordings of a run name it."""


@dataclass(frozen=True, kw_only=True)
class PolicyGroup(ArgumentsGroup):
    language: str | None = None
    """Language backend: rules-v1, replay:FILE.jsonl or live:MODEL, as far as the policy supports it (see
    docs/evidence/methods.md); default: the policy's own choice."""
    record: Path | None = None
    """File to which carecontact appends the answers of the model of --language live:MODEL, so that --language
    replay:FILE.jsonl can repeat them."""


def chosen_trial(rules: Protocol, *, seed: int | None, task: str | None = None) -> tuple[str, int]:
    """Return --task and --seed, which a protocol has to have; by default its first ones."""
    from carecontact.runs.plan import compact

    ids, seeds = [row.id for row in rules.tasks], rules.randomization.seeds
    if task is not None and task not in ids:
        meant = did_you_mean(task, ids)
        raise ConfigError(f"--task: {task!r} is not a task of {rules.id}{meant}; valid: {', '.join(ids)}")
    if seed is not None and seed not in seeds:
        raise ConfigError(f"--seed: {seed} is not a seed of {rules.id}; valid: {compact(seeds)}")
    return task or ids[0], seed if seed is not None else next(iter(seeds), 0)


def check_folder(out: Path | None) -> None:
    if out is not None and out.exists() and not out.is_dir():
        raise ConfigError(f"--out {out}: this is a file; name a folder")


def make_folder_of(target: Path) -> None:
    if target.is_dir():
        raise ConfigError(f"{target}: this is a folder; name a file")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        why = "this is a file" if isinstance(error, FileExistsError) else error.strerror
        raise ConfigError(f"{target}: no folder can be made for it: {error.filename}: {why}") from None


def need_recordings(folder: Path) -> None:
    if folder.is_file():
        raise ConfigError(f"{folder}: this is a file; name the --out of a run")
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such folder; name the --out of a run")
    if not any(folder.glob("*.h5")):
        from carecontact.runs.scoring import misnamed

        other = "".join(f"; {path.name} does not end in .h5" for path in misnamed(folder)[:1])
        raise ConfigError(f"{folder}: holds no recordings (*.h5); name the --out of a run{other}")


def read_run(run: Path, *, rescore: bool | None = None) -> RunScores:
    """Read the scores; of a folder of recordings, also print which registered metrics they lack."""
    from carecontact.runs.scoring import lacking, read_scores

    scores = read_scores(run, rescore=bool(rescore), otherwise="" if rescore is None else ", or add --rescore")
    if any(run.glob("*.h5")) and (absent := lacking(scores)):
        command = f"carecontact report --rescore {shlex.quote(str(run))} --append"
        print(f"{run} was scored without {', '.join(absent)}; `{command}` adds what is missing")
    return scores
