"""Score every recording of a folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from carecontact.errors import ConfigError
from carecontact.recording.versions import versions_of
from carecontact.runs.pooling import check_one_run, with_names
from carecontact.runs.run_scores import RunScores
from carecontact.runs.score_files import ScoredFile, score_files
from carecontact.scoring.metrics.metric import METRICS
from carecontact.scoring.result import TrialScore


def score_run(
    folder: Path | str, *, jobs: int = 1, scored: Callable[[Path], ScoredFile | None] = lambda path: None
) -> RunScores:
    """Score every ``*.h5`` of a run's folder; writes nothing. The result does not depend on ``jobs``
    and ``scored``.

    A file that cannot be read or scored is skipped with the reason, and so is one that is not named after its trial or
    ends in ``.H5``. Raises ConfigError if the folder does not exist, or if the trials are of more than one protocol,
    policy or world; RecordingError if a process that scored died.

    Args:
        jobs: processes; more than one are started afresh, so that a script needs its ``__main__`` guarded and metrics
            of another package have to come by its entry points.
        scored: the score that a recording has already got, or None to compute it.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such folder; name the --out of a run")
    scores: list[TrialScore] = []
    why = "ignored, because the name of a recording must end in .h5"
    skipped = {path.name: f"{path}: {why}" for path in misnamed(folder)}
    versions: dict[str, set[str]] = {}
    paths = sorted(folder.glob("*.h5"))
    known = {path: found for path in paths if (found := scored(path)) is not None}
    others = score_files([path for path in paths if path not in known], jobs=jobs)
    for path in paths:
        found = known[path] if path in known else next(others)
        if isinstance(found, str):
            skipped[path.name] = found
            continue
        scores.append(found.score)
        _add(versions, found.versions)
    if scores:
        _add(versions, versions_of(map(METRICS.package, METRICS)))
    scores = with_names(scores)
    check_one_run(scores)
    return RunScores(scores=scores, skipped=skipped, versions={k: sorted(v) for k, v in sorted(versions.items())})


def _add(versions: dict[str, set[str]], further: Mapping[str, str]) -> None:
    for package, version in further.items():
        versions.setdefault(package, set()).add(version)


def misnamed(folder: Path) -> list[Path]:
    """Files that end as a recording does but for the case, by name."""
    return sorted(path for path in folder.iterdir() if path.suffix != ".h5" and path.suffix.lower() == ".h5")
