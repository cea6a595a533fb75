"""The scores of a run as its ``results.json`` has them, once it is known to belong to the recordings beside it."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path

from carecontact.errors import ConfigError, RecordingError
from carecontact.recording import stored_sha256
from carecontact.runs.manifest import read_manifest
from carecontact.runs.results_file import RESULTS_NAME, read_results
from carecontact.runs.run_scores import RunScores
from carecontact.runs.score_files import score_file
from carecontact.runs.score_folder import misnamed, score_run
from carecontact.scoring.metrics.metric import METRICS


def read_scores(run: Path, *, rescore: bool = False, jobs: int = 1, otherwise: str = "") -> RunScores:
    """Return the scores of a run, with the trials that its manifest plans and nobody scored.

    Args:
        run: the folder of a run, or a results file, packed or not, which is read as it is.
        rescore: compute the scores of the recordings in a folder again instead of reading ``results.json``; nothing is
            written.
        jobs: processes that compute.
        otherwise: what else than to score anew the caller offers, for messages: ``", or add --rescore"``.

    Raises ConfigError for a folder or file that is not there or cannot be read, and for a ``results.json`` that
    ``stale`` finds something about; the message names the command that writes a new one.
    """
    if run.is_file():
        _check_is_results(run)
        return read_results(run)
    if not run.is_dir():
        raise ConfigError(f"{run}: no such folder; name the --out of a run, or its {RESULTS_NAME}")
    results, recorded = run / RESULTS_NAME, any(run.glob("*.h5"))
    if recorded and rescore:
        return beside_plan(run, score_run(run, jobs=jobs))
    if not results.is_file():
        raise ConfigError(
            f"{run}: holds recordings but no {RESULTS_NAME}; run `carecontact score {shlex.quote(str(run))}`{otherwise}"
            if recorded
            else f"{run}: holds neither recordings (*.h5) nor {RESULTS_NAME}; name the --out of a run"
        )
    scores = read_results(results)
    if not recorded:
        return scores
    if found := stale(run, scores):
        more = f" and {len(found) - 1} more" if len(found) > 1 else ""
        raise ConfigError(
            f"{results} does not match the recordings beside it ({found[0]}{more}); "
            f"run `carecontact score {shlex.quote(str(run))}`{otherwise}"
        )
    return beside_plan(run, scores)


def _check_is_results(file: Path) -> None:
    """Raises ConfigError for a file that is a recording, or nothing that could hold scores."""
    valid = f"name the folder of a run, or its {RESULTS_NAME}"
    if file.suffix == ".h5":
        raise ConfigError(f"{file}: this is the recording of one trial; {valid}, such as {file.parent}")
    if not file.name.endswith((".json", ".json.gz")):
        raise ConfigError(f"{file}: this is no run; {valid}")


def stale(folder: Path, run: RunScores) -> list[str]:
    """Return how the recordings in a folder differ from those that were scored, a few words for each; empty if they
    agree.

    Every recording must be one that was scored, with the canonical hash that it had then, and none may be gone. The
    hash is the one that each file says it has: arrays are not read, so damage inside them stays for those who read
    them. A recording that was skipped must still be one that cannot be scored.
    """
    hashes = {f"{score.trial_id}.h5": score.recording_sha256 for score in run.scores}
    files = {path.name: path for path in (*sorted(folder.glob("*.h5")), *misnamed(folder))}
    found = [why for path in files.values() if (why := _difference(path, hashes, run))]
    return found + [f"{name} is missing" for name in (*hashes, *run.skipped) if name not in files]


def lacking(run: RunScores) -> list[str]:
    """Return ids of the registered metrics that some trial was scored without."""
    without = [row.id for row in METRICS.values() if row.field is None]
    return [id_ for id_ in without if any(id_ not in score.additional for score in run.scores)]


def beside_plan(folder: Path, run: RunScores) -> RunScores:
    """Return the run with the trials that its manifest plans, here and in other parts of the run, and nobody scored;
    unchanged where there is no manifest."""
    manifest = read_manifest(folder)
    if manifest is None:
        return run
    scored = {score.trial_id for score in run.scores}
    missing, elsewhere = (
        tuple(trial_id for trial_id in trials if trial_id not in scored)
        for trials in (manifest.trials, manifest.elsewhere)
    )
    return replace(run, missing=missing, elsewhere=elsewhere)


def _difference(path: Path, hashes: dict[str, str], run: RunScores) -> str | None:
    if path.name in run.skipped:
        again = path.suffix == ".h5" and not isinstance(score_file(path), str)
        return f"{path.name} was skipped and can be scored now" if again else None
    if path.name not in hashes:
        return f"{path.name} was added"
    try:
        return None if stored_sha256(path) == hashes[path.name] else f"{path.name} was changed"
    except RecordingError:
        return f"{path.name} cannot be read"
