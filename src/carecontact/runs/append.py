"""Adds metrics to an existing result without changing a digit of what the result already holds."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast

from carecontact.errors import ConfigError
from carecontact.recording import read_recording
from carecontact.recording.versions import versions_of
from carecontact.runs.results_content import RESULTS_SCHEMA
from carecontact.runs.results_file import RESULTS_NAME, write_results
from carecontact.scoring.contact import find_contact
from carecontact.scoring.metrics.metric import METRICS
from carecontact.scoring.score import check_finite
from carecontact.scoring.validity.streams import check_streams
from carecontact.stats import median

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
