"""Makes trials from columns: checks what a file of presses must satisfy, and names each fault by line and column."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt

from carecontact.calibration.reader import Columns, read_columns
from carecontact.calibration.trial import PHASES, SHAPES, Condition, Trial
from carecontact.errors import ConfigError

CONSTANT = ("site", "subject", "indenter_shape", "filter", "speed_mm_s", "indenter_size_mm", "preload_N", "along_mm",
            "across_mm", "tilt_deg")  # fmt: skip
"""Columns that must have one value for each trial."""
MIN_SAMPLES = 12
MAX_SAMPLES = 2000
"""Most samples of a trial; more are averaged in blocks before anything is computed."""
LIMITS = {
    "speed_mm_s": (0.05, 500.0), "indenter_size_mm": (1.0, 100.0), "preload_N": (0.0, 20.0),
    "along_mm": (-300.0, 300.0), "across_mm": (-300.0, 300.0), "tilt_deg": (-45.0, 45.0),
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class TrialFile:
    trials: tuple[Trial, ...]
    sha256: str
    notes: tuple[str, ...]
    """What was left out or averaged, as sentences for people."""


def read_trials(path: Path, *, region: str) -> TrialFile:
    """Read the trials of one region: the rows whose ``site`` begins with the region's name.

    Raises ConfigError naming file, line, column and what would be valid.
    """
    columns = read_columns(path)
    notes: list[str] = []
    sites = np.array([_plain(site).startswith(region) for site in columns.text["site"]])
    if not sites.any():
        found = ", ".join(sorted({str(site) for site in columns.text["site"]})[:8])
        raise ConfigError(
            f"{path}, column site: no row belongs to the {region} (found: {found}); let the site of its rows begin "
            f"with {region}"
        )
    if not sites.all():
        notes.append(f"{int((~sites).sum())} rows of other sites left out")
    rows = np.flatnonzero(sites)
    ids = columns.text["trial_id"][rows]
    starts = np.r_[0, np.flatnonzero(ids[1:] != ids[:-1]) + 1, len(ids)]
    seen: dict[str, int] = {}
    trials = []
    for begin, end in pairwise(starts):
        part = rows[begin:end]
        name, line = str(ids[begin]), int(columns.line[part[0]])
        if name in seen:
            raise ConfigError(
                f"{path}, line {line}, column trial_id: {name!r} appeared already from line {seen[name]} on, with "
                "other trials between; give each trial its own id and keep its rows together"
            )
        seen[name] = line
        trials.append(_trial(columns, part, name))
    _check_units(trials, path)
    reduced = [_averaged(trial) for trial in trials]
    averaged = sum(len(a.time_s) != len(b.time_s) for a, b in zip(trials, reduced, strict=True))
    if averaged:
        notes.append(f"{averaged} trials of more than {MAX_SAMPLES} samples averaged in blocks to at most that many")
    return TrialFile(trials=tuple(reduced), sha256=columns.sha256, notes=tuple(notes))


def _plain(site: str) -> str:
    return "_".join(site.lower().replace("-", " ").replace("_", " ").split())


def _trial(columns: Columns, rows: npt.NDArray[np.int64], name: str) -> Trial:
    fault = _Fault(path=columns.path, lines=columns.line[rows], trial=name)
    if not name:
        raise fault(0, "trial_id", "it is empty; each trial needs an id")
    if len(rows) < MIN_SAMPLES:
        raise fault(0, "trial_id", f"it has {len(rows)} rows; a press needs at least {MIN_SAMPLES}")
    text, number = _constants(columns, rows, fault)
    time = columns.number["t_s"][rows]
    late = np.flatnonzero(np.diff(time) <= 0)
    if len(late):
        k = int(late[0]) + 1
        raise fault(k, "t_s", f"{time[k]:g} s after {time[k - 1]:g} s; time must increase within a trial")
    phase = _phases(columns.text["phase"][rows], fault)
    cap = text["indenter_shape"] == "cap"
    return Trial(
        trial_id=name,
        site=text["site"],
        subject=text["subject"],
        condition=Condition(
            indenter_shape=text["indenter_shape"],
            indenter_size_m=None if cap else number["indenter_size_mm"] / 1000,
            speed_m_s=number["speed_mm_s"] / 1000,
            along_m=number["along_mm"] / 1000,
            across_m=number["across_mm"] / 1000,
            tilt_deg=number["tilt_deg"],
        ),
        preload_n=number["preload_N"],
        filter=text["filter"],
        time_s=time,
        indentation_m=columns.number["indentation_mm"][rows] / 1000,
        force_n=columns.number["force_N"][rows],
        phase=phase,
        line=int(fault.lines[0]),
    )


@dataclass(frozen=True, kw_only=True)
class _Fault:
    """Makes the error message for one row of a trial."""

    path: Path
    lines: npt.NDArray[np.int64]
    """(n,) line in the file of each row"""
    trial: str

    def __call__(self, row: int, column: str, message: str) -> ConfigError:
        return ConfigError(f"{self.path}, line {self.lines[row]}, column {column}: {message} (trial {self.trial!r})")


def _constants(columns: Columns, rows: npt.NDArray[np.int64], fault: _Fault) -> tuple[dict[str, str], dict[str, float]]:
    """Return the checked texts and numbers of the columns in CONSTANT."""
    for column in CONSTANT:
        values = (columns.text if column in columns.text else columns.number)[column][rows]
        other = np.flatnonzero(values != values[0])
        if len(other):
            k = int(other[0])
            raise fault(k, column, f"{values[k]} after {values[0]}; one value per trial: start another trial_id")
    text = {column: str(columns.text[column][rows[0]]) for column in CONSTANT if column in columns.text}
    number = {column: float(columns.number[column][rows[0]]) for column in CONSTANT if column in columns.number}
    if text["indenter_shape"] not in SHAPES:
        raise fault(0, "indenter_shape", f"{text['indenter_shape']!r}; valid: {', '.join(SHAPES)}")
    for column, (low, high) in LIMITS.items():
        if column == "indenter_size_mm" and text["indenter_shape"] == "cap":
            continue
        if not low <= number[column] <= high:
            raise fault(0, column, f"{number[column]:g} is not between {low:g} and {high:g}")
    return text, number


def _phases(words: npt.NDArray[np.object_], fault: _Fault) -> npt.NDArray[np.int64]:
    """(n,) index into PHASES"""
    unknown = np.flatnonzero(~np.isin(words, PHASES))
    if len(unknown):
        k = int(unknown[0])
        raise fault(k, "phase", f"{words[k]!r}; valid: {', '.join(PHASES)}")
    phase = np.array([PHASES.index(word) for word in words])
    back = np.flatnonzero(np.diff(phase) < 0)
    if len(back):
        k = int(back[0]) + 1
        raise fault(k, "phase", f"{words[k]} after {words[k - 1]}; a trial is one press: load, then hold, then unload")
    if (phase == 0).sum() < MIN_SAMPLES:
        raise fault(0, "phase", f"{(phase == 0).sum()} rows of load; a press needs at least {MIN_SAMPLES}")
    return phase


def _check_units(trials: list[Trial], path: Path) -> None:
    """Raise ConfigError for magnitudes that only another unit or sign can explain."""
    depth_mm = 1000 * max(float(np.ptp(trial.indentation_m)) for trial in trials)
    if depth_mm < 0.2:
        raise ConfigError(
            f"{path}, column indentation_mm: the deepest press spans {depth_mm:.3g} mm; that looks like metres: "
            "multiply the column by 1000"
        )
    if depth_mm > 150:
        raise ConfigError(
            f"{path}, column indentation_mm: the deepest press spans {depth_mm:.4g} mm; that looks like micrometres: "
            "divide the column by 1000"
        )
    for trial in trials:
        where = f"{path}, trial {trial.trial_id!r} from line {trial.line}"
        load = trial.phase == 0
        depth, force, time = trial.indentation_m[load], trial.force_n[load], trial.time_s[load]
        travel = depth[-1] - depth[0]
        if travel <= 0:
            raise ConfigError(f"{where}, column indentation_mm: it falls during load; inward must be positive")
        rise = float(np.median(force[-max(3, len(force) // 20) :]) - np.median(force[: max(3, len(force) // 20)]))
        if rise < 0:
            raise ConfigError(
                f"{where}, column force_N: it falls by {-rise:.3g} N during load; compression is positive"
            )
        if rise < 0.05:
            raise ConfigError(f"{where}, column force_N: it rises by {rise:.2g} N during load; is it in newtons?")
        if rise > 1000:
            raise ConfigError(f"{where}, column force_N: it rises by {rise:.4g} N during load; is it in newtons?")
        # A trial may wait before it moves, so that only the moving part gives the speed.
        moving = (depth > depth[0] + 0.1 * travel) & (depth < depth[0] + 0.9 * travel)
        if moving.sum() < 3:
            raise ConfigError(f"{where}: fewer than 3 samples while moving in; record faster")
        speed = float(np.polyfit(time[moving], depth[moving], 1)[0])
        if not 0.5 < speed / trial.condition.speed_m_s < 2.0:
            raise ConfigError(
                f"{where}: indentation_mm moves at {1000 * speed:.3g} mm per unit of t_s, column speed_mm_s says "
                f"{1000 * trial.condition.speed_m_s:.3g}; check the units of t_s (seconds) and speed_mm_s (mm/s)"
            )


def _averaged(trial: Trial) -> Trial:
    """Average a trial in blocks of equal length within each phase, so that at most MAX_SAMPLES samples are left."""
    if len(trial.time_s) <= MAX_SAMPLES:
        return trial
    block = int(np.ceil(len(trial.time_s) / (MAX_SAMPLES - len(PHASES))))
    group = np.concatenate([np.arange((trial.phase == p).sum()) // block + p * len(trial.time_s) for p in range(3)])
    _, index = np.unique(group, return_inverse=True)
    count = np.bincount(index)

    def mean(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        return np.bincount(index, values) / count

    return Trial(
        **{**vars(trial), "time_s": mean(trial.time_s), "indentation_m": mean(trial.indentation_m),
           "force_n": mean(trial.force_n), "phase": np.rint(mean(trial.phase.astype(float))).astype(np.int64)}
    )  # fmt: skip
