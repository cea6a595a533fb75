"""The scores of a run: computed from recordings, read where they are stored, and metrics appended to stored ones."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from carecontact.errors import ConfigError, RecordingError
from carecontact.recording import read_recording, stored_sha256
from carecontact.recording.provenance import versions_of
from carecontact.runs.manifest import read_manifest
from carecontact.runs.pooling import RunScores, check_one_run, with_names
from carecontact.runs.results_file import RESULTS_NAME, RESULTS_SCHEMA, read_results, write_results
from carecontact.runs.scorer import ScoredFile, score_file, score_files
from carecontact.scoring.contact import find_contact
from carecontact.scoring.metrics.metric import METRICS
from carecontact.scoring.score import check_finite
from carecontact.scoring.validity import check_streams
from carecontact.stats import median


def score_run(
    folder: Path | str, *, jobs: int = 1, scored: Callable[[Path], ScoredFile | None] = lambda path: None
) -> RunScores:
    """Score every ``*.h5`` of a run's folder; writes nothing. The result does not depend on ``jobs`` and ``scored``. A
    file that cannot be read or scored is skipped with the reason, and so is one that is not named after its trial or
    ends in ``.H5``."""
    folder = Path(folder)
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such folder; name the --out of a run")
    why = "ignored, because the name of a recording must end in .h5"
    skipped = {path.name: f"{path}: {why}" for path in misnamed(folder)}
    paths = sorted(folder.glob("*.h5"))
    known = {path: found for path in paths if (found := scored(path)) is not None}
    others = score_files([path for path in paths if path not in known], jobs=jobs)
    found = {path: known[path] if path in known else next(others) for path in paths}
    skipped |= {path.name: why for path, why in found.items() if isinstance(why, str)}
    files = [file for file in found.values() if isinstance(file, ScoredFile)]
    versions: dict[str, set[str]] = {}
    for named in [*(file.versions for file in files), versions_of(map(METRICS.package, METRICS)) if files else {}]:
        for package, version in named.items():
            versions.setdefault(package, set()).add(version)
    scores = with_names(file.score for file in files)
    check_one_run(scores)
    return RunScores(scores=scores, skipped=skipped, versions={k: sorted(v) for k, v in sorted(versions.items())})


def misnamed(folder: Path) -> list[Path]:
    """Files that end as a recording does but for the case, by name."""
    return sorted(path for path in folder.iterdir() if path.suffix != ".h5" and path.suffix.lower() == ".h5")


def read_scores(run: Path, *, rescore: bool = False, jobs: int = 1, otherwise: str = "") -> RunScores:
    """Return the scores of a run, with the trials that its manifest plans and that have no score.

    Args:
        run: the folder of a run, or a results file, packed or not, which is read as it is.
        rescore: compute the scores of the recordings in a folder again instead of reading ``results.json``; nothing is
            written.
        jobs: processes that compute.
        otherwise: what else than to score again the caller offers, for messages: ``", or add --rescore"``.
    """
    results, remedy = run / RESULTS_NAME, f"run `carecontact report --rescore {shlex.quote(str(run))}`{otherwise}"
    if run.is_file():
        valid = f"name the folder of a run, or its {RESULTS_NAME}"
        if run.suffix == ".h5":
            raise ConfigError(f"{run}: this is the recording of one trial; {valid}, such as {run.parent}")
        if not run.name.endswith((".json", ".json.gz")):
            raise ConfigError(f"{run}: this is no run; {valid}")
        return read_results(run)
    if not run.is_dir():
        raise ConfigError(f"{run}: no such folder; name the --out of a run, or its {RESULTS_NAME}")
    recorded = any(run.glob("*.h5"))
    if recorded and rescore:
        return beside_plan(run, score_run(run, jobs=jobs))
    if not results.is_file() and recorded:
        raise ConfigError(f"{run}: holds recordings but no {RESULTS_NAME}; {remedy}")
    if not results.is_file():
        raise ConfigError(f"{run}: holds neither recordings (*.h5) nor {RESULTS_NAME}; name the --out of a run")
    scores = read_results(results)
    if not recorded:
        return scores
    if found := stale(run, scores):
        more = f" and {len(found) - 1} more" if len(found) > 1 else ""
        raise ConfigError(f"{results} does not match the recordings beside it ({found[0]}{more}); {remedy}")
    return beside_plan(run, scores)


def stale(folder: Path, run: RunScores) -> list[str]:
    """Return how the recordings in a folder differ from those that were scored, a few words for each; empty if they
    agree. Every recording must be one that was scored, with the canonical hash that it had then, and none may be gone.
    The hash is the one that each file says it has: arrays are not read, so damage inside them stays for those who read
    them. A recording that was skipped must still be one that cannot be scored."""
    hashes = {f"{score.trial_id}.h5": score.recording_sha256 for score in run.scores}
    files = {path.name: path for path in (*sorted(folder.glob("*.h5")), *misnamed(folder))}
    found = [f"{name} {why}" for name, path in files.items() if (why := _difference(path, hashes, run))]
    return found + [f"{name} is missing" for name in (*hashes, *run.skipped) if name not in files]


def _difference(path: Path, hashes: Mapping[str, str], run: RunScores) -> str:
    if path.name in run.skipped:
        again = path.suffix == ".h5" and not isinstance(score_file(path), str)
        return "was skipped and can be scored now" if again else ""
    if path.name not in hashes:
        return "was added"
    try:
        return "" if stored_sha256(path) == hashes[path.name] else "was changed"
    except RecordingError:
        return "cannot be read"


def lacking(run: RunScores) -> list[str]:
    """Return ids of the registered metrics that some trial was scored without."""
    without = [row.id for row in METRICS.values() if row.field is None]
    return [id_ for id_ in without if any(id_ not in score.additional for score in run.scores)]


def beside_plan(folder: Path, run: RunScores) -> RunScores:
    """Return the run with the trials that its manifest plans, here and in other parts, and that have no score."""
    manifest = read_manifest(folder)
    if manifest is None:
        return run
    scored = {score.trial_id for score in run.scores}
    missing, elsewhere = (
        tuple(trial_id for trial_id in trials if trial_id not in scored)
        for trials in (manifest.trials, manifest.elsewhere)
    )
    return replace(run, missing=missing, elsewhere=elsewhere)


Row = dict[str, Any]
NEEDED = {"trial_id", "task_id", "region", "action", "ended", "recording_sha256", "metric_versions"}
"""Keys of a trial in ``results.json`` that appending reads."""


@dataclass(frozen=True, kw_only=True)
class Appended:
    path: Path
    metrics: list[str]
    """Ids that some trial did not have yet; empty if there was nothing to do, and then nothing was written."""
    trials: int
    not_listed: list[str]
    """Recordings in the folder that the result does not contain; appending adds no trials."""
    gone: list[str]
    """Trials of the result whose recordings are not in the folder."""


def append_metrics(folder: Path | str) -> Appended:
    """Compute the registered metrics that a run's ``results.json`` lacks and add them, per trial and as medians; no
    digit of what it holds already changes. Every trial gets them or none: nothing is written on an error."""
    folder = Path(folder)
    path = folder / RESULTS_NAME
    data = _read(path)
    trials: list[Row] = data["trials"]
    added: set[str] = set()
    grown = 0
    for trial in trials:
        present = {*trial.setdefault("additional", {}), *trial["metric_versions"].values()}
        lacking = [row.id for row in METRICS.values() if row.field is None and row.id not in present]
        if lacking:
            trial["additional"].update(_compute(folder, trial, lacking))
            added.update(lacking)
            grown += 1
    if added:
        _add_medians(data, added)
        for package, version in versions_of(map(METRICS.package, added)).items():
            listed = data.setdefault("versions", {}).setdefault(package, [])
            data["versions"][package] = sorted({*listed, version})
        write_results(folder, data)
    listed = {trial["trial_id"] for trial in trials}
    return Appended(
        path=path,
        metrics=sorted(added),
        trials=grown,
        not_listed=sorted(p.name for p in folder.glob("*.h5") if p.stem not in listed),
        gone=sorted(name for name in listed if not (folder / f"{name}.h5").exists()),
    )


def _add_medians(data: Row, added: set[str]) -> None:
    """Add the medians of the metrics that were added to every part of the result that does not have them yet."""
    for part, rows in _parts(data):
        medians = part.setdefault("additional", {})
        for metric in (METRICS[id_] for id_ in added - medians.keys()):
            pooled = [row for row in rows if metric.actions is None or row["action"] in metric.actions]
            if metric.median:
                medians[metric.id] = asdict(median(row["additional"].get(metric.id) for row in pooled))


def _parts(data: Row) -> Iterator[tuple[Row, Sequence[Row]]]:
    """Each summary in a result, with the trials that it counts."""
    judged = [trial for trial in data["trials"] if trial["ended"] != "harness_error"]
    yield data["overall"], judged
    for name, key in (("per_task", "task_id"), ("per_region", "region")):
        for value, part in data.get(name, {}).items():
            yield part, [trial for trial in judged if trial[key] == value]


def _read(path: Path) -> Row:
    try:
        data: Any = json.loads(path.read_bytes())
    except FileNotFoundError:
        raise ConfigError(
            f"{path}: does not exist, so there is nothing to append to; score the run without --append first"
        ) from None
    except (ValueError, RecursionError, OSError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from None
    schema = data.get("schema") if isinstance(data, dict) else None
    if schema != RESULTS_SCHEMA:
        raise ConfigError(f"{path}: schema {schema!r}; --append adds to {RESULTS_SCHEMA!r}")
    if not isinstance(data.get("trials"), list) or not isinstance(data.get("overall"), dict):
        raise ConfigError(f"{path}: holds no trials; score the run without --append first")
    for number, row in enumerate(data["trials"]):
        if absent := NEEDED - (row.keys() if isinstance(row, dict) else set()):
            raise ConfigError(f"{path}: trials[{number}] lacks {', '.join(sorted(absent))}")
    return data


def _compute(folder: Path, trial: Row, ids: Sequence[str]) -> dict[str, float | None]:
    path = folder / f"{trial['trial_id']}.h5"
    recording, scored = read_recording(path), trial["recording_sha256"]
    if recording.stored_sha256 != scored:
        raise ConfigError(
            f"{path}: differs from the recording that was scored (sha256 {recording.stored_sha256[:12]} and not "
            f"{scored[:12]}); score the run without --append"
        )
    check_streams(recording)
    contact = find_contact(recording)
    values = {id_: METRICS[id_].compute(contact) for id_ in ids}
    check_finite(str(path), values)
    return values
