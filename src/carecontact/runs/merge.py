"""Makes one run, or one sweep, of parts that ran on several machines."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from carecontact.errors import ConfigError
from carecontact.recording import read_header, stored_sha256
from carecontact.recording.file import replace_file
from carecontact.recording.schema import RANKED
from carecontact.runs.identity import Identity
from carecontact.runs.lock import LOCK, folder_lock
from carecontact.runs.manifest import MANIFEST, Manifest, read_manifest, store_manifest
from carecontact.runs.pooling import not_ranked
from carecontact.runs.sweep import CELLS


@dataclass(frozen=True, kw_only=True)
class Merged:
    copied: int
    already: int
    """Recordings that an earlier merge into the same folder had copied."""
    missing: tuple[str, ...]
    """Trials of the whole run that no part has a recording of."""


def merge_runs(out: Path, runs: Sequence[Path]) -> Merged:
    """Copy the recordings, logs and plans of ``runs`` into ``out``; the same command continues an interrupted merge."""
    check_places(out, runs)
    with ExitStack() as held:
        for run in runs:
            held.enter_context(folder_lock(run))
        held.enter_context(folder_lock(out, make=True))
        folders: dict[Path, Manifest] = {}
        for run in (*runs, out):
            manifest = read_manifest(run)
            if manifest is not None:
                folders[run] = manifest
            elif run in runs:
                named = "name the --out of `carecontact run --shard`"
                raise ConfigError(f"{run} is not a run: it holds no {MANIFEST}; {named}")
            elif any(path.name != LOCK for path in out.iterdir()):
                raise ConfigError(f"{out} is not a run, and it is not empty; name a new folder")
        first = runs[0]
        for run, manifest in folders.items():
            _check_same(first, folders[first], run, manifest)
        files = _recordings(folders)
        trials = sorted({trial for part in folders.values() for trial in (*part.trials, *part.elsewhere)})
        # First, so that the same command knows the folder again after an interruption.
        revealed = next((manifest.salt for manifest in folders.values() if manifest.salt), "")
        store_manifest(folders[first].model_copy(update={"trials": trials, "elsewhere": [], "salt": revealed}), out=out)
        copied = [trial for trial, file in files.items() if file.parent != out]
        for trial in copied:
            for source in (files[trial].with_suffix(".log"), files[trial]):
                if source.is_file():
                    replace_file(out / source.name, source.read_bytes())
    missing = tuple(trial for trial in trials if trial not in files)
    return Merged(copied=len(copied), already=len(files) - len(copied), missing=missing)


def check_places(out: Path, runs: Sequence[Path]) -> None:
    """Raises ConfigError for a folder to write that is a file or one of the parts, and for a part given twice."""
    if out.exists() and not out.is_dir():
        raise ConfigError(f"{out}: this is a file; name a folder first, then the parts")
    places = [run.resolve() for run in runs]
    if twice := next((run for run, place in zip(runs, places, strict=True) if places.count(place) > 1), None):
        raise ConfigError(f"{twice} is given twice; name each part once")
    if out.resolve() in places:
        raise ConfigError(f"{out} is the folder to write and one of the parts; name a new folder first, then the parts")


def _check_same(first: Path, one: Manifest, run: Path, other: Manifest) -> None:
    pairs = [
        ("policies", one.policy, other.policy),
        ("protocols", *(f"{held.protocol.id} {held.protocol.sha256[:12]}" for held in (one, other))),
        ("salts", *(held.salt_sha256[:12] or "none" for held in (one, other))),
        ("noise salts", one.noise_salt[:6] or "none", other.noise_salt[:6] or "none"),
        *((what, getattr(one.identity, name), getattr(other.identity, name)) for name, what in IDENTITY.items()),
    ]
    for what, a, b in pairs:
        if a != b:
            both = (_differing(a, b), _differing(b, a)) if isinstance(a, dict) and isinstance(b, dict) else (a, b)
            raise ConfigError(f"{first} and {run} are not parts of one run: different {what}, {both[0]} and {both[1]}")


IDENTITY = {name: name for name in Identity.model_fields} | {
    "policy_sha256": "sources of the policy",
    "card": "cards of the policy's server",
    "language": "language backends",
    "argument_files": "contents of policy arguments",
    "environment": "policy variables",
    "arguments": "policy arguments",
    "world": "declared versions of the simulation",
    "sha256": "assets",
}
"""Field of an identity -> what it is, as messages name it."""


def _differing(one: dict[str, object], other: dict[str, object]) -> str:
    rows = [f"{name} {str(value)[:12]}" for name, value in one.items() if other.get(name) != value]
    return ", ".join(rows) or "nothing"


def _recordings(folders: dict[Path, Manifest]) -> dict[str, Path]:
    """Trial -> its file; that of the last folder where several have the same recording."""
    found: dict[str, Path] = {}
    for folder, manifest in folders.items():
        for trial in manifest.trials:
            path = folder / f"{trial}.h5"
            if not path.is_file():
                continue
            header = read_header(path)
            held = header.spec.trial_id
            if header.origin not in RANKED or header.spec.trains:
                raise not_ranked(str(path), header.origin)
            if held != trial:
                raise ConfigError(f"{path} holds trial {held}; remove it and run that part again")
            if trial in found and stored_sha256(found[trial]) != stored_sha256(path):
                raise ConfigError(
                    f"{found[trial]} and {path} are different recordings of one trial; leave out or remove one of them"
                )
            found[trial] = path
    return dict(sorted(found.items()))


def is_sweep(folder: Path) -> bool:
    return (folder / CELLS).is_dir()


def merge_sweeps(out: Path, sweeps: Sequence[Path]) -> dict[str, Merged]:
    """Merge every cell of ``sweeps`` into the same cell of ``out``, where the parts of a cell become one run."""
    check_places(out, sweeps)
    found: dict[str, list[Path]] = {}
    for sweep in sweeps:
        if not is_sweep(sweep):
            raise ConfigError(f"{sweep} is not a sweep: it holds no folder {CELLS}; name the --out of a sweep's parts")
        for cell in sorted((sweep / CELLS).iterdir()):
            if (cell / MANIFEST).is_file():
                found.setdefault(cell.name, []).append(cell)
    return {name: merge_runs(out / CELLS / name, folders) for name, folders in found.items()}
