"""Scores the recordings of a folder on several processes, keeps the scores, and appends metrics to stored ones."""

from __future__ import annotations

import json
import os
import shlex
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from threading import local
from typing import Any, cast

from carecontact.errors import ConfigError, RecordingError
from carecontact.recording import read_recording, stored_sha256
from carecontact.recording.provenance import versions_of
from carecontact.runs.manifest import read_manifest
from carecontact.runs.pooling import RunScores, check_one_run, with_names
from carecontact.runs.results_file import RESULTS_NAME, RESULTS_SCHEMA, read_results, write_results
from carecontact.scoring.contact import find_contact
from carecontact.scoring.metrics.metric import METRICS
from carecontact.scoring.result import TrialScore
from carecontact.scoring.score import check_finite, score_recording
from carecontact.scoring.validity import check_streams
from carecontact.stats import median
from carecontact.system import is_exhausted

# Score recordings file by file, on one core or several.


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


# Processes that score recordings, each at the end of a socket.
#
# The pools of the standard library lose all work if one process dies, and a killed command leaves their named
# semaphores in ``/dev/shm``.

COMMAND = (sys.executable, "-P", "-m", "carecontact.runs.scoring_process")


class ScoringLostError(Exception):
    """A scoring process died or could not be started; the next recording gets a new one."""


class ScoringPool:
    """Threads, each with a process that scores one recording after another. Its maker closes it."""

    def __init__(self, processes: int) -> None:
        """A thread starts its process when there is work for it. With 0 processes, a thread of this process scores."""
        self._inside = processes == 0
        self._threads = ThreadPoolExecutor(max(1, processes))
        self._own = local()
        self._started: list[_Process] = []

    def submit(
        self, path: Path, *, then: Callable[[ScoredFile | str], None] = lambda found: None
    ) -> Future[ScoredFile | str]:
        """Return what will have the result of ``score_file``, or ScoringLostError.

        ``then``: called with the result before the future has it, in the pool's thread.
        """

        def score() -> ScoredFile | str:
            found = self._score(path)
            then(found)
            return found

        try:
            return self._threads.submit(score)
        except RuntimeError as error:
            if not is_exhausted(error):
                raise
            lost: Future[ScoredFile | str] = Future()
            lost.set_exception(ScoringLostError())
            return lost

    def close(self) -> None:
        """Leave unscored what is not scored yet, and end the processes."""
        self._threads.shutdown(wait=False, cancel_futures=True)
        for process in self._started:
            process.end()
        self._threads.shutdown()
        # Those that a thread was just about to start.
        for process in self._started:
            process.end()

    def _score(self, path: Path) -> ScoredFile | str:
        if self._inside:
            return score_file(path)
        process: _Process | None = getattr(self._own, "process", None)
        try:
            if process is None:
                process = self._own.process = _Process()
                self._started.append(process)
            return process.score(path)
        except (EOFError, OSError):
            if process is not None:
                process.end()
            self._own.process = None
            raise ScoringLostError from None


class _Process:
    def __init__(self) -> None:
        near, far = socket.socketpair()
        with far:
            # In a session of its own, so that Ctrl-C reaches the parent alone.
            self._process = subprocess.Popen(
                (*COMMAND, str(os.getpid())), stdin=far.fileno(), stdout=subprocess.DEVNULL, start_new_session=True
            )
        self._line: Connection = Connection(near.detach())
        self._line.send(sys.path)

    def score(self, path: Path) -> ScoredFile | str:
        """Raises EOFError or OSError if the process is gone, and whatever scoring raises."""
        self._line.send(path)
        found: ScoredFile | str | Exception = self._line.recv()
        if isinstance(found, Exception):
            raise found
        return found

    def end(self) -> None:
        self._process.kill()
        self._process.wait()


# Score every recording of a folder.


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


# The scores of a run as its ``results.json`` has them, once it is known to belong to the recordings beside it.


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


# Adds metrics to an existing result without changing a digit of what the result already holds.

Row = dict[str, Any]
NEEDED = {"trial_id", "task_id", "region", "action", "ended", "recording_sha256", "metric_versions"}
"""Keys of a trial in ``results.json`` that appending reads."""


@dataclass(frozen=True, kw_only=True)
class Appended:
    path: Path
    metrics: list[str]
    """Ids that some trial did not have yet; empty if there was nothing to do, and then nothing was written."""
    trials: int
    """Trials that got one or more."""
    not_listed: list[str]
    """Recordings in the folder that the result does not contain; appending adds no trials."""
    gone: list[str]
    """Trials of the result whose recordings are not in the folder."""


def append_metrics(folder: Path | str) -> Appended:
    """Compute the registered metrics that a run's ``results.json`` lacks and add them, per trial and as medians.

    Every trial gets them or none: nothing is written on an error. Raises ConfigError if there is no result to add to
    or if a recording is not the one that was scored; RecordingError if one cannot be read.
    """
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
    content = cast("Row", data) if isinstance(data, dict) else {}
    if content.get("schema") != RESULTS_SCHEMA:
        raise ConfigError(f"{path}: schema {content.get('schema')!r}; --append adds to {RESULTS_SCHEMA!r}")
    rows: Any = content.get("trials")
    if not isinstance(rows, list) or not isinstance(content.get("overall"), dict):
        raise ConfigError(f"{path}: holds no trials; score the run without --append first")
    for number, row in enumerate(cast("list[Any]", rows)):
        absent = NEEDED - cast("Row", row).keys() if isinstance(row, dict) else NEEDED
        if absent:
            raise ConfigError(f"{path}: trials[{number}] lacks {', '.join(sorted(absent))}")
    return content


def _compute(folder: Path, trial: Row, ids: Sequence[str]) -> dict[str, float | None]:
    path = folder / f"{trial['trial_id']}.h5"
    recording = read_recording(path)
    if recording.stored_sha256 != trial["recording_sha256"]:
        raise ConfigError(
            f"{path}: differs from the recording that was scored (sha256 {recording.stored_sha256[:12]} and not "
            f"{trial['recording_sha256'][:12]}); score the run without --append"
        )
    check_streams(recording)
    contact = find_contact(recording)
    values = {id_: METRICS[id_].compute(contact) for id_ in ids}
    check_finite(str(path), values)
    return values
