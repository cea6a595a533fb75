"""The manifest of a run's folder: its plan and identity, the releases that it cannot be mixed with, and its salt."""

from __future__ import annotations

import json
import os
import secrets
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, FailFast, Field, ValidationError

from carecontact import __version__
from carecontact.errors import ConfigError, RecordingError, counted
from carecontact.protocol.protocol import TrialSpec, commitment, protocol_title
from carecontact.recording import read_header, read_recording
from carecontact.recording.file import replace_file
from carecontact.recording.reason import ended_text
from carecontact.recording.schema import FAILED, KILLED, POLICY_KILLED, EndReason, Header
from carecontact.runs.identity import Identity
from carecontact.runs.plan import SALT_DIGITS
from carecontact.runs.results_file import first_error, parse, read_bounded, skipped_before

ANOTHER = "use another folder"
ELSEWHERE = f"{ANOTHER}, or move this one aside, as --restart of `carecontact run` does"


def install_line(*, held: Mapping[str, str], now: Mapping[str, str]) -> str:
    """Return the line that installs what a folder was started with, as far as it differs; empty where nothing does."""
    differ = [name for name, version in held.items() if now.get(name, version) != version]
    if not differ:
        return ""
    needed = [f"{name}=={held[name]}" for name in differ]
    if "carecontact" in differ:
        # A release of carecontact brings the packages that it needs.
        needed = [f"carecontact-{held['carecontact']}-*.whl"]
    return f"to continue it: python -m pip install {' '.join(needed)}"


def damaged(content: bytes) -> str:
    """Describe a manifest that cannot be read: by the release that wrote it, where it names another one."""
    with suppress(ValueError, KeyError, TypeError, RecursionError):
        version = str(json.loads(content)["identity"]["versions"]["carecontact"])
        if version != __version__:
            line = install_line(held={"carecontact": version}, now={"carecontact": __version__})
            return f"was written by carecontact {version}, and this is {__version__}; {line}"
    return "is damaged or of another release"


def lost_trials(out: Path, *, failed: tuple[str, ...]) -> str:
    """Return what of a folder cannot be kept because the policy's source changed. ``failed``: ends of failed trials."""
    ends: list[str] = []
    for path in out.glob("*.h5"):
        with suppress(RecordingError):
            ends.append(read_header(path).ended)
    n_failed = sum(end in failed for end in ends)
    trials = counted(len(ends), "trial")
    return f"none of its {trials}, {n_failed} of them failed, can be kept beside trials of the new source"


BY_CHANCE = (("harness_error", KILLED), ("process_failure", POLICY_KILLED))
"""End and kind of failure of a trial of which chance, such as a machine out of memory, may have ended a process."""
MANIFEST = "manifest.json"
MAX_BYTES = 16 << 20
"""Largest size: more than half a million trials."""
Purpose = Literal["run", "demo"]


class ProtocolName(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    id: str
    sha256: str
    overrides: dict[str, str] = {}


class Manifest(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    version: Annotated[Literal["carecontact-run-1"], Field(alias="schema")] = "carecontact-run-1"
    purpose: Purpose
    """Which command started the folder."""
    policy: str
    protocol: ProtocolName
    identity: Identity
    trials: Annotated[list[str], FailFast()]
    """Ids of every trial that any command planned here."""
    elsewhere: Annotated[list[str], FailFast()] = []
    """Ids of the other trials of the run of which this is a part (``run --shard``)."""
    noise_salt: str = ""
    """Salt of the sensor noise of every trial here; empty where the protocol names no sensor noise, and where the run
    has a ``salt_sha256``."""
    salt_sha256: str = ""
    """Hash of the secret on which every draw of every trial here depends, written before the first trial; empty for a
    run on published seeds."""
    salt: str = ""
    """The secret, once its owner has revealed it."""


@dataclass(frozen=True, kw_only=True)
class Survey:
    """The content of a run's folder, compared with the trials that a command wants to run."""

    keep: dict[str, EndReason]
    """Trial id -> how it ended."""
    redo: dict[str, str]
    """Trial id -> why the file that is there does not count."""
    killed: frozenset[str] = frozenset()
    """The trials of ``redo`` that an earlier command lost to a signal."""


def runs_beside(out: Path) -> list[str]:
    """Return this run's folder and those of other runs in the same place: none of them is the policy's business."""
    here = out.resolve()
    # A control lies inside the run of the policy without it.
    run = here.parent if (here.parent / MANIFEST).is_file() else here
    return sorted({str(here), str(run), *(str(manifest.parent) for manifest in run.parent.glob(f"*/{MANIFEST}"))})


def survey(
    specs: Sequence[TrialSpec], *, out: Path, retry_failed: bool, identity: Identity, suspects: Collection[str] = ()
) -> Survey:
    """Sort the wanted trials with a file into those to keep and those to run again. ``suspects`` are read whole."""
    if out.exists() and not out.is_dir():
        raise ConfigError(f"--out {out}: this is a file; name a folder")
    if any((_policy_of(spec), spec.protocol) != (_policy_of(specs[0]), specs[0].protocol) for spec in specs):
        raise ConfigError("a run has one policy, with one set of arguments, and one protocol")
    if len({spec.trial_id for spec in specs}) != len(specs):
        raise ConfigError("the same trial is planned twice")
    manifest = read_manifest(out)
    if manifest is not None:
        if why := _manifest_differs(manifest, specs[0], out=out, identity=identity):
            raise ConfigError(why)
    wanted = {spec.trial_id for spec in specs}
    skipped = {*skipped_before(out), *(f"{trial}.h5" for trial in suspects)}
    keep: dict[str, EndReason] = {}
    redo: dict[str, str] = {}
    killed = set[str]()
    for path in sorted(out.glob("*.h5")):
        try:
            # Damage inside an array is found by the scoring after every run, so what that skipped is read whole here.
            header = read_recording(path).header if path.name in skipped else read_header(path)
        except RecordingError as error:
            if path.stem in wanted:
                redo[path.stem] = str(error)
            continue
        if why := _header_differs(header, specs[0], path=path, identity=identity):
            raise ConfigError(f"{why}: {ANOTHER}")
        if manifest is None and identity.policy_sha256 is not None:
            raise ConfigError(
                f"{out} holds {path.name} but no {MANIFEST}, without which carecontact cannot check whether the "
                "policy's source changed: use another folder"
            )
        if path.stem not in wanted:
            continue
        if header.spec.trial_id != path.stem:
            redo[path.stem] = f"{path.name} holds trial {header.spec.trial_id}"
        elif retry_failed and header.ended in FAILED:
            redo[path.stem] = ended_text(header.ended)
        elif (header.ended, header.failure and header.failure.kind) in BY_CHANCE:
            redo[path.stem] = "a process of it was killed by a signal or could not be started"
            killed.add(path.stem)
        elif header.ended == "harness_error":
            # What the machine caused is no verdict on the policy, so that the same command tries again.
            redo[path.stem] = ended_text(header.ended)
        else:
            keep[path.stem] = header.ended
    return Survey(keep=keep, redo=redo, killed=frozenset(killed))


def write_manifest(
    specs: Sequence[TrialSpec], *, out: Path, identity: Identity, purpose: Purpose, whole: Sequence[str] = ()
) -> None:
    """Write atomically; trials of earlier commands stay. ``whole``: ids of the run of which ``specs`` are a part."""
    protocol, earlier = specs[0].protocol, read_manifest(out)
    trials, elsewhere = {spec.trial_id for spec in specs}, set(whole)
    if earlier:
        purpose, trials, elsewhere = earlier.purpose, trials.union(earlier.trials), elsewhere.union(earlier.elsewhere)
    manifest = Manifest(
        purpose=purpose,
        policy=specs[0].policy,
        protocol=ProtocolName(id=protocol.name, sha256=protocol.sha256, overrides=protocol.overrides),
        identity=identity,
        noise_salt=specs[0].noise_salt,
        salt_sha256=specs[0].commitment,
        salt=earlier.salt if earlier else "",
        trials=sorted(trials),
        elsewhere=sorted(elsewhere - trials),
    )
    store_manifest(manifest, out=out)


def store_manifest(manifest: Manifest, *, out: Path) -> None:
    """Atomically; the same manifest gives the same bytes."""
    empty = {name for name in ("elsewhere", "noise_salt", "salt_sha256", "salt") if not getattr(manifest, name)}
    text = json.dumps(manifest.model_dump(mode="json", by_alias=True, exclude=empty), indent=2)
    replace_file(out / MANIFEST, f"{text}\n".encode("ascii"))


def salted(specs: Sequence[TrialSpec], *, out: Path) -> list[TrialSpec]:
    """Return the trials with the noise salt of the run, a fresh one for a new run, where they need one."""
    if specs[0].salt or not specs[0].protocol.variation.sensor_noise:
        return list(specs)
    earlier, given = read_manifest(out), specs[0].noise_salt
    kept = earlier.noise_salt if earlier else ""
    if given and kept not in ("", given):
        raise ConfigError(f"{out} was started with another --noise-salt: {ELSEWHERE}")
    salt = given or kept or secrets.token_hex(SALT_DIGITS // 2)
    return [spec.model_copy(update={"noise_salt": salt}) for spec in specs]


def read_manifest(out: Path) -> Manifest | None:
    """Return the manifest of a run, or None if the folder has none."""
    path, content = out / MANIFEST, b""
    try:
        content = read_bounded(path, most=MAX_BYTES)
        return Manifest.model_validate(parse(content))
    except (FileNotFoundError, NotADirectoryError):
        return None
    except ValidationError as error:
        why = first_error(error)
    except ValueError as error:
        why = f"not JSON: {error}"
    raise ConfigError(f"{path} {damaged(content)} ({why}): restore it or {ELSEWHERE}")


def _manifest_differs(manifest: Manifest, spec: TrialSpec, *, out: Path, identity: Identity) -> str:
    held, started = manifest.identity, f"{out} was started with"
    if changed := identity.differences(versions=held.versions, sha256={}, world=held.world):
        line = install_line(held=held.versions, now=identity.versions)
        return f"{started} another release ({'; '.join(changed)}): {ELSEWHERE}; {line}"
    if (manifest.policy, manifest.protocol.sha256) != (spec.policy, spec.protocol.sha256):
        title = protocol_title(manifest.protocol.id, manifest.protocol.overrides)
        run = f"policy {manifest.policy}, protocol {title} {manifest.protocol.sha256[:12]}"
        return f"{out} holds another run ({run}); this command runs {_described(spec)}: {ELSEWHERE}"
    if manifest.salt_sha256 != spec.commitment:
        began, given = (f"sha256 {salt[:12]}" if salt else "none" for salt in (manifest.salt_sha256, spec.commitment))
        return f"{started} another --salt-file (its salt: {began}, this command's: {given}): {ELSEWHERE}"
    if held.policy_sha256 != identity.policy_sha256:
        lost = lost_trials(out, failed=FAILED)
        return f"{out}: the policy's source changed since this folder was started, so {lost}: {ELSEWHERE}"
    if held.card and identity.card and held.card != identity.card:
        pairs = [(n, held.card.get(n), identity.card.get(n)) for n in sorted(held.card.keys() | identity.card.keys())]
        values = ", ".join(f"{name} was {old!r}, is {now!r}" for name, old, now in pairs if old != now)
        return f"{out}: the card of {spec.policy} changed ({values}): {ELSEWHERE}"
    before, wanted = (_policy_text(i.arguments, i.environment) for i in (held, identity))
    if before != wanted:
        return f"{started} {before}, this command has {wanted}: {ELSEWHERE}"
    for name, text in identity.arguments.items():
        if held.argument_files.get(name) != identity.argument_files.get(name):
            content = f"the content of {text} (policy argument {name})"
            return f"{out}: {content} changed since this folder was started: {ELSEWHERE}"
    if held.language != identity.language:
        before, wanted = (name or "the policy's own" for name in (held.language, identity.language))
        return f"{started} language backend {before}, this command has {wanted}: {ELSEWHERE}"
    if changed := identity.differences(versions={}, sha256=held.sha256, world={}):
        return f"{started} other assets ({'; '.join(changed)}): {ELSEWHERE}"
    return ""


def _header_differs(header: Header, spec: TrialSpec, *, path: Path, identity: Identity) -> str:
    recorded = f"{path} was recorded with"
    if (header.spec.policy, header.spec.protocol) != (spec.policy, spec.protocol):
        run = f"{path.name} is of {_described(header.spec)}"
        return f"{path.parent} holds another run: {run}; this command runs {_described(spec)}"
    if _policy_of(header.spec) != _policy_of(spec):
        before, wanted = (_policy_text(s.policy_arguments, s.policy_environment) for s in (header.spec, spec))
        return f"{recorded} {before}, this command has {wanted}"
    language = (header.card or {}).get("language_backend", identity.language)
    if identity.language is not None and language != identity.language:
        return f"{recorded} language backend {language}"
    if header.spec.salt_sha256 != spec.commitment:
        return f"{recorded} another --salt-file"
    if changed := identity.differences(versions=header.versions, sha256=header.sha256, world=header.identity):
        return f"{recorded} other package versions or assets ({'; '.join(changed)})"
    return ""


def _policy_of(spec: TrialSpec) -> tuple[object, ...]:
    return spec.policy, spec.policy_arguments, spec.policy_environment


def _policy_text(arguments: Mapping[str, str], environment: Sequence[str]) -> str:
    """Return words such as ``policy arguments steps=3 and policy variables TOKEN``; both may be ``none``."""
    given = " ".join(f"{name}={text}" for name, text in sorted(arguments.items())) or "none"
    return f"policy arguments {given}" + (f" and policy variables {' '.join(environment)}" if environment else "")


def _described(spec: TrialSpec) -> str:
    return f"policy {spec.policy}, protocol {spec.protocol.title} {spec.protocol.sha256[:12]}"


# The salt of a run is a secret, so that its persons are unknown beforehand. The one who ranks methods makes it,
# publishes its sha256, runs the methods, and reveals it when all is done. Then anyone can verify it (``audit.salt``).

DIGITS = 64
"""Number of digits of a salt, in base 16: as many as its hash has."""


def make_salt(path: Path) -> str:
    """Write a new secret, which only its owner may read, and return its sha256, that of the file's bytes."""
    try:
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be made: {error.strerror}; name a new file") from None
    with os.fdopen(handle, "w") as stream:
        stream.write(secrets.token_hex(DIGITS // 2))
    return commitment(read_salt(path))


def read_salt(path: Path) -> str:
    """Return the secret in a file; a line's end after it does not count."""
    try:
        salt = path.read_text(errors="replace").strip()
    except OSError as error:
        raise ConfigError(f"--salt-file {path}: cannot be read: {error.strerror}") from None
    if len(salt) != DIGITS or not set(salt) <= set("0123456789abcdef"):
        raise ConfigError(
            f"--salt-file {path}: expected {DIGITS} hexadecimal digits, as `carecontact protocol salt make` writes them"
        )
    return salt


def with_salt(specs: Sequence[TrialSpec], salt: str) -> list[TrialSpec]:
    """Return the trials with a secret on which every draw depends; as they are where it is empty."""
    return list(specs) if not salt else [spec.model_copy(update={"salt": salt}) for spec in specs]


def reveal_salt(run: Path, salt: str) -> None:
    """Write the secret into a run's manifest, from where anyone may verify it."""
    manifest = committed(run)
    if commitment(salt) != manifest.salt_sha256:
        raise ConfigError(
            f"{run} was run with the salt whose sha256 is {manifest.salt_sha256}, and this one's is {commitment(salt)}"
        )
    store_manifest(manifest.model_copy(update={"salt": salt}), out=run)


def committed(run: Path) -> Manifest:
    manifest = read_manifest(run)
    if manifest is None:
        raise ConfigError(f"{run} is not a run: it holds no {MANIFEST}")
    if not manifest.salt_sha256:
        raise ConfigError(f"{run} was run on published seeds, without --salt-file: there is no salt to reveal")
    return manifest
