"""Add metrics to a result that stands: what is there stays as it is, to the last digit."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from math import isfinite
from pathlib import Path
from typing import Any, cast

from carecontact.errors import ConfigError, RecordingError
from carecontact.recording import read_verified
from carecontact.runs.scores import RESULTS_NAME, RESULTS_SCHEMA, write_results
from carecontact.scoring.contact import find_contact
from carecontact.scoring.metrics.metric import METRICS
from carecontact.scoring.validity.streams import check_streams
from carecontact.stats import median


@dataclass(frozen=True, kw_only=True)
class Appended:
    path: Path
    metrics: list[str]
    """Ids that some trial did not have yet; empty if there was nothing to do, and then nothing was written."""
    trials: int
    """Trials that got one or more."""
    not_listed: list[str]
    """Recordings in the folder that the result does not know: appending takes in no new trials."""


def append_metrics(folder: Path | str) -> Appended:
    """Compute the registered metrics that a run's ``results.json`` lacks and add them, per trial and as medians.

    Every trial gets them or none: nothing is written on an error. Raises ConfigError if there is no result to add to
    or if a recording is not the one that was scored; RecordingError if one cannot be read.
    """
    folder = Path(folder)
    path = folder / RESULTS_NAME
    data = _read_results(path)
    trials: list[dict[str, Any]] = data["trials"]
    added: set[str] = set()
    grown = 0
    for trial in trials:
        present = {*trial.setdefault("additional", {}), *trial["metric_versions"].values()}
        lacking = [id_ for id_ in METRICS if id_ not in present]
        if lacking:
            trial["additional"].update(_compute(folder, trial, lacking))
            added.update(lacking)
            grown += 1
    scopes = [(data["overall"], trials)]
    for name, key in (("per_task", "task_id"), ("per_region", "region")):
        scopes += [(scope, [t for t in trials if t[key] == value]) for value, scope in data.get(name, {}).items()]
    for scope, rows in scopes:
        medians = scope.setdefault("additional", {})
        judged = [t for t in rows if t["ended"] != "harness_error"]
        for id_ in added - medians.keys():
            medians[id_] = asdict(median(t["additional"].get(id_) for t in judged))
    if added:
        write_results(folder, data)
    listed = {t["trial_id"] for t in trials}
    return Appended(
        path=path,
        metrics=sorted(added),
        trials=grown,
        not_listed=sorted(p.name for p in folder.glob("*.h5") if p.stem not in listed),
    )


def _read_results(path: Path) -> dict[str, Any]:
    try:
        data: Any = json.loads(path.read_bytes())
    except FileNotFoundError:
        raise ConfigError(f"{path}: no result to append to; score the run without --append first") from None
    except (ValueError, RecursionError, OSError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from None
    content = cast("dict[str, Any]", data) if isinstance(data, dict) else {}
    if content.get("schema") != RESULTS_SCHEMA:
        raise ConfigError(f"{path}: schema {content.get('schema')!r}; --append adds to {RESULTS_SCHEMA!r}")
    needed = {"trial_id", "task_id", "region", "ended", "recording_sha256", "metric_versions"}
    rows: Any = content.get("trials")
    if not isinstance(rows, list) or not isinstance(content.get("overall"), dict):
        raise ConfigError(f"{path}: holds no trials; score the run without --append first")
    for number, row in enumerate(cast("list[Any]", rows)):
        absent = needed - cast("dict[str, Any]", row).keys() if isinstance(row, dict) else needed
        if absent:
            raise ConfigError(f"{path}: trials[{number}] lacks {', '.join(sorted(absent))}")
    return content


def _compute(folder: Path, trial: dict[str, Any], ids: list[str]) -> dict[str, float | None]:
    path = folder / f"{trial['trial_id']}.h5"
    verified = read_verified(path)
    if verified.sha256 != trial["recording_sha256"]:
        raise ConfigError(
            f"{path}: is not the recording that was scored ({verified.sha256[:12]} and not "
            f"{trial['recording_sha256'][:12]}); score the run without --append"
        )
    check_streams(verified.recording)
    contact = find_contact(verified.recording)
    values = {id_: METRICS[id_].compute(contact) for id_ in ids}
    for id_, value in values.items():
        if value is not None and not isfinite(value):
            raise RecordingError(f"{path}: {id_} comes out as {value}; its arrays are out of all range")
    return values
