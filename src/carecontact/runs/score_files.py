"""Score recordings file by file, on one core or several."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from carecontact.errors import RecordingError
from carecontact.recording import read_recording
from carecontact.runs.scoring_pool import ScoringLostError, ScoringPool
from carecontact.scoring.result import TrialScore
from carecontact.scoring.score import score_recording


@dataclass(frozen=True, kw_only=True)
class ScoredFile:
    score: TrialScore
    versions: dict[str, str]
    """Package -> version that the recording names."""


def score_file(path: Path) -> ScoredFile | str:
    """Return the score of a file, or in one line why it has none."""
    try:
        recording = read_recording(path)
        header = recording.header
        if path.stem != header.spec.trial_id:
            trial_id = header.spec.trial_id
            raise RecordingError(
                f"{path}: holds trial {trial_id}; rename the file to {trial_id}.h5, or remove it if it is a copy"
            )
        score = score_recording(recording)
    except RecordingError as error:
        return str(error)
    return ScoredFile(score=score, versions=header.versions)


def score_files(paths: Sequence[Path], *, jobs: int) -> Iterator[ScoredFile | str]:
    """Score recordings and return the scores in the order of ``paths``. Raises RecordingError if a process died, which
    no recording should bring about."""
    if jobs <= 1:
        yield from map(score_file, paths)
        return
    with closing(ScoringPool(jobs)) as pool:
        given = [pool.submit(path) for path in paths]
        try:
            yield from (each.result() for each in given)
        except ScoringLostError:
            raise RecordingError(
                f"{paths[0].parent}: a scoring process died; score again with --jobs 1 to see at which recording"
            ) from None
