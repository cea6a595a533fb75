"""Makes trials from columns: checks what files of presses must satisfy, and names each fault by line and column."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt

from carecontact.errors import ConfigError
from carecontact.lab.calibration.reader import NUMBERS, Columns, read_columns
from carecontact.lab.calibration.trial import LIMITS, PHASES, SHAPES, Array, Condition, Setup, Trial

CONSTANT = ("site", "subject", "indenter_shape", "filter", "speed_mm_s", "indenter_size_mm", "preload_N", "along_mm",
            "across_mm", "tilt_deg")  # fmt: skip
"""Columns that must have one value for each trial."""
DEFAULTS: dict[str, str | float] = {
    "subject": "not stated", "filter": "not stated", "preload_N": 0.0, "along_mm": 0.0, "across_mm": 0.0,
    "tilt_deg": 0.0,
}  # fmt: skip
"""Values of columns that neither the file nor the setup has."""
WORDS = {"loading": "load", "holding": "hold", "unloading": "unload"}
MIN_SAMPLES = 12
MAX_SAMPLES = 2000
"""Most samples of a trial; more are averaged in blocks before anything is computed."""
SAME_SPEED = 1.15
"""Speeds that are found from paths count as one nominal speed if they differ by less than this factor."""
BACK = 0.1
"""A path that turns by more than this share of its travel before or after its deepest point is more than one press."""
TURN = 0.02
"""Share of the travel below the deepest point within which a path may be holding."""


@dataclass(frozen=True, kw_only=True)
class TrialFile:
    trials: tuple[Trial, ...]
    sha256: str
    """Hash of the only file's bytes; else of all files' hashes."""
    notes: tuple[str, ...]
    """What was left out, derived or averaged, as sentences for people."""


def read_trials(paths: Path | Sequence[Path], *, region: str, setup: Setup | None = None) -> TrialFile:
    """Read the trials of one region: the rows whose ``site`` begins with the region's name.

    Args:
        setup: values of columns that the files do not have. Without a ``site``, every trial is of ``region``.

    Raises ConfigError naming file, line, column and what would be valid.
    """
    files = _columns(paths, setup or Setup(), region=region)
    notes: list[str] = []
    kept = [np.array([_plain(site).startswith(region) for site in columns.text["site"]]) for columns in files]
    if not any(part.any() for part in kept):
        found = ", ".join(sorted({str(site) for columns in files for site in columns.text["site"]})[:8])
        raise ConfigError(
            f"{_named(files)}, column site: no row belongs to the {region} (found: {found}); let the site of its rows "
            f"begin with {region}"
        )
    if others := sum(int((~part).sum()) for part in kept):
        notes.append(f"{others} rows of other sites left out")
    seen: dict[str, Trial] = {}
    for columns, part in zip(files, kept, strict=True):
        rows = np.flatnonzero(part)
        ids = columns.text["trial_id"][rows]
        starts = np.r_[0, np.flatnonzero(ids[1:] != ids[:-1]) + 1, len(ids)] if len(ids) else []
        for begin, end in pairwise(starts):
            name, line = str(ids[begin]), int(columns.line[rows[begin]])
            if name in seen:
                before = seen[name]
                where = f"line {before.line}" if before.path == columns.path else f"{before.path}, line {before.line},"
                raise ConfigError(
                    f"{columns.path}, line {line}, column trial_id: {name!r} appeared already from {where} on, with "
                    "other trials between; give each trial its own id and keep its rows together"
                )
            seen[name] = _trial(columns, rows[begin:end], name)
    trials = list(seen.values())
    if any("phase" not in columns.text for columns in files):
        notes.append("loading and unloading derived from the path, where the file has no column phase")
    trials = _with_speeds(trials)
    _check_units(trials)
    reduced = [_averaged(trial) for trial in trials]
    averaged = sum(len(a.time_s) != len(b.time_s) for a, b in zip(trials, reduced, strict=True))
    if averaged:
        notes.append(f"{averaged} trials of more than {MAX_SAMPLES} samples averaged in blocks to at most that many")
    sums = [columns.sha256 for columns in files]
    sha256 = sums[0] if len(sums) == 1 else hashlib.sha256("".join(sums).encode()).hexdigest()
    return TrialFile(trials=tuple(reduced), sha256=sha256, notes=tuple(notes))


def regions_of(paths: Path | Sequence[Path], setup: Setup, *, valid: Sequence[str]) -> tuple[str, ...]:
    """Return the valid regions that occur at the start of a site in the files. Raises ConfigError if none does."""
    files = _columns(paths, setup, region=None)
    sites = {_plain(str(site)) for columns in files for site in set(columns.text["site"])}
    found = tuple(name for name in valid if any(site.startswith(name) for site in sites))
    if not found:
        raise ConfigError(
            f"{_named(files)}, column site: expected {', '.join(valid)}, got {', '.join(sorted(sites)[:8])}"
        )
    return found


def _named(files: Sequence[Columns]) -> str:
    return f"{files[0].path}" if len(files) == 1 else f"{len(files)} files"


def _columns(paths: Path | Sequence[Path], setup: Setup, *, region: str | None) -> list[Columns]:
    """Read the files in the order of their names, each with the columns that the setup and DEFAULTS add."""
    several = sorted({paths} if isinstance(paths, Path) else set(paths), key=lambda path: (path.name, str(path)))
    unknown = sorted(set(setup.files) - {path.name for path in several})
    if unknown:
        raise ConfigError(
            f"setup: files.{unknown[0]}: no such file was given; given: {', '.join(p.name for p in several)}"
        )
    return [_completed(read_columns(path), setup.of(path), region=region) for path in several]


def _completed(columns: Columns, stated: dict[str, str | float], *, region: str | None) -> Columns:
    count = len(columns.line)
    text, number = dict(columns.text), dict(columns.number)
    if both := [name for name in stated if name in text or name in number]:
        raise ConfigError(
            f"{columns.path}: it has a column {both[0]}, and the setup or an option states it; give only one"
        )
    stated = {"trial_id": columns.path.stem, **DEFAULTS, **({"site": region} if region else {}), **stated}
    if stated.get("indenter_shape", text.get("indenter_shape", [""])[0]) == "cap":
        stated.setdefault("indenter_size_mm", 1.0)  # The cap has its own size.
    for name, value in stated.items():
        if name not in text and name not in number:
            (number if name in NUMBERS else text)[name] = (  # pyright: ignore[reportArgumentType]
                np.full(count, value) if name in NUMBERS else np.full(count, value, object)
            )
    for name, option in (("site", "--region"), ("indenter_shape", "--indenter"), ("indenter_size_mm", "--indenter")):
        if name not in text and name not in number:
            example = {"--region": "--region forearm", "--indenter": "--indenter flat:10.7 (its radius in mm)"}[option]
            raise ConfigError(f"{columns.path}: no column {name}; add it, or give {example}")
    return replace(columns, text=text, number=number)


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
    indentation, force = columns.number["indentation_mm"][rows] / 1000, columns.number["force_N"][rows]
    if "phase" in columns.text:
        phase = _phases(columns.text["phase"][rows], fault)
    else:
        phase = _phases_of_path(time, indentation, force, fault)
    if (phase == 0).sum() < MIN_SAMPLES:
        raise fault(0, "phase", f"{(phase == 0).sum()} rows of load; a press needs at least {MIN_SAMPLES}")
    cap = text["indenter_shape"] == "cap"
    return Trial(
        trial_id=name,
        site=text["site"],
        subject=text["subject"],
        condition=Condition(
            indenter_shape=text["indenter_shape"],
            indenter_size_m=None if cap else number["indenter_size_mm"] / 1000,
            speed_m_s=number.get("speed_mm_s", 0.0) / 1000,
            along_m=number["along_mm"] / 1000,
            across_m=number["across_mm"] / 1000,
            tilt_deg=number["tilt_deg"],
        ),
        preload_n=number["preload_N"],
        filter=text["filter"],
        time_s=time - time[0],
        indentation_m=indentation,
        force_n=force,
        phase=phase,
        path=columns.path,
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
    there = [column for column in CONSTANT if column in columns.text or column in columns.number]
    for column in there:
        values = (columns.text if column in columns.text else columns.number)[column][rows]
        other = np.flatnonzero(values != values[0])
        if len(other):
            k = int(other[0])
            raise fault(k, column, f"{values[k]} after {values[0]}; one value per trial: start another trial_id")
    text = {column: str(columns.text[column][rows[0]]) for column in there if column in columns.text}
    number = {column: float(columns.number[column][rows[0]]) for column in there if column in columns.number}
    if text["indenter_shape"] not in SHAPES:
        raise fault(0, "indenter_shape", f"{text['indenter_shape']!r}; valid: {', '.join(SHAPES)}")
    for column, (low, high) in LIMITS.items():
        if column not in number or (column == "indenter_size_mm" and text["indenter_shape"] == "cap"):
            continue
        if not low <= number[column] <= high:
            raise fault(0, column, f"{number[column]:g} is not between {low:g} and {high:g}")
    return text, number


def _phases(words: npt.NDArray[np.object_], fault: _Fault) -> npt.NDArray[np.int64]:
    """(n,) index into PHASES"""
    words = np.array([WORDS.get(word.lower(), word.lower()) for word in words], object)
    unknown = np.flatnonzero(~np.isin(words, PHASES))
    if len(unknown):
        k = int(unknown[0])
        raise fault(k, "phase", f"{words[k]!r}; valid: {', '.join(PHASES)}")
    phase = np.array([PHASES.index(word) for word in words])
    back = np.flatnonzero(np.diff(phase) < 0)
    if len(back):
        k = int(back[0]) + 1
        raise fault(k, "phase", f"{words[k]} after {words[k - 1]}; a trial is one press: load, then hold, then unload")
    return phase


def _phases_of_path(time: Array, depth: Array, force: Array, fault: _Fault) -> npt.NDArray[np.int64]:
    """(n,) index into PHASES, from where the path is deepest: before it the press loads, after it it unloads. A path
    that stays within TURN of there for several times as long as the turn takes holds meanwhile.

    Raises ConfigError for a path that goes in more than once, or along which the force falls.
    """
    window = max(1, len(depth) // 60)
    smooth = np.convolve(np.pad(depth, window, mode="edge"), np.ones(2 * window + 1) / (2 * window + 1), "valid")
    travel = float(np.ptp(smooth))
    turn = int(smooth.argmax())
    rise = force[turn] - np.median(force[smooth < smooth.min() + 0.1 * travel]) if travel > 0 else 0.0
    outside = np.median(force[: max(3, len(force) // 50)])
    if rise < 0 and abs(force.min() - outside) >= abs(force.max() - outside):
        raise fault(turn, "force_N", "it falls while the indentation grows; compression and inward must be positive")
    if rise < 0 or turn == 0:
        raise fault(turn, "indentation_mm", "it falls while the force grows; inward must be positive")
    if turn < len(smooth) - 1:
        falls = np.maximum.accumulate(smooth[: turn + 1]) - smooth[: turn + 1]
        rises = smooth[turn:] - np.minimum.accumulate(smooth[turn:])
        for part, start in ((falls, 0), (rises, turn)):
            if part.max() > BACK * travel:
                raise fault(start + int(part.argmax()), "indentation_mm", "the path goes in more than once; give each "
                            "press a trial_id, or a file of its own")  # fmt: skip
    phase = np.where(np.arange(len(depth)) > turn, PHASES.index("unload"), PHASES.index("load"))
    near = np.flatnonzero(smooth >= smooth[turn] - TURN * travel)
    moving = (smooth[: turn + 1] > smooth[0] + 0.1 * travel) & (smooth[: turn + 1] < smooth[0] + 0.9 * travel)
    if moving.sum() >= 3:
        speed = abs(float(np.polyfit(time[: turn + 1][moving], smooth[: turn + 1][moving], 1)[0]))
        if time[near[-1]] - time[near[0]] > 6 * TURN * travel / max(speed, 1e-9):
            phase[near[0] : near[-1] + 1] = PHASES.index("hold")
    return phase


def _with_speeds(trials: list[Trial]) -> list[Trial]:
    """Return the trials with the nominal speed of those for which none is stated: the middle of all that are alike,
    with two digits."""
    missing = {k: _speed(trial) for k, trial in enumerate(trials) if not trial.condition.speed_m_s}
    out, order = list(trials), sorted(missing, key=lambda k: missing[k])
    while order:
        alike = [k for k in order if missing[k] <= SAME_SPEED * missing[order[0]]]
        order = order[len(alike) :]
        nominal = float(f"{1000 * float(np.median([missing[k] for k in alike])):.2g}") / 1000
        for k in alike:
            out[k] = replace(out[k], condition=replace(out[k].condition, speed_m_s=nominal))
    return out


def _speed(trial: Trial) -> float:
    """Return the speed of the moving part of the loading [m/s]; a trial may wait before it moves."""
    load = trial.phase == 0
    depth, time = trial.indentation_m[load], trial.time_s[load]
    travel = depth[-1] - depth[0]
    moving = (depth > depth[0] + 0.1 * travel) & (depth < depth[0] + 0.9 * travel)
    if moving.sum() < 3:
        raise ConfigError(
            f"{trial.path}, trial {trial.trial_id!r} from line {trial.line}: fewer than 3 samples while moving in; "
            "record faster"
        )
    return float(np.polyfit(time[moving], depth[moving], 1)[0])


def _check_units(trials: list[Trial]) -> None:
    """Raise ConfigError for magnitudes that only another unit or sign can explain."""
    deepest = max(trials, key=lambda trial: float(np.ptp(trial.indentation_m)))
    depth_mm = 1000 * float(np.ptp(deepest.indentation_m))
    if depth_mm < 0.2:
        raise ConfigError(
            f"{deepest.path}, column indentation_mm: the deepest press spans {depth_mm:.3g} mm; that looks like "
            "metres: multiply the column by 1000"
        )
    if depth_mm > 150:
        raise ConfigError(
            f"{deepest.path}, column indentation_mm: the deepest press spans {depth_mm:.4g} mm; that looks like "
            "micrometres: divide the column by 1000"
        )
    for trial in trials:
        where = f"{trial.path}, trial {trial.trial_id!r} from line {trial.line}"
        load = trial.phase == 0
        depth, force = trial.indentation_m[load], trial.force_n[load]
        if depth[-1] - depth[0] <= 0:
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
        speed, low, high = _speed(trial), *LIMITS["speed_mm_s"]
        if not low <= 1000 * speed <= high:
            raise ConfigError(f"{where}: indentation_mm moves at {1000 * speed:.3g} mm per unit of t_s, which is not "
                              f"between {low:g} and {high:g} mm/s; check the units of t_s (seconds)")  # fmt: skip
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
