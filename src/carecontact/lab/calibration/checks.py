"""Makes trials from columns: checks what files of presses must satisfy, and names each fault by line and column."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from carecontact.errors import ConfigError
from carecontact.lab.calibration.reader import NUMBERS, Columns, read_columns
from carecontact.lab.calibration.trial import LIMITS, PHASES, SHAPES, Array, Condition, Setup, Trial

TEXT_CONSTANTS = ("site", "subject", "indenter_shape", "filter")
CONSTANT = (*TEXT_CONSTANTS, "speed_mm_s", "indenter_size_mm", "preload_N", "along_mm", "across_mm", "tilt_deg")
"""Columns that must have one value for each trial."""
DEFAULTS: dict[str, str | float] = {
    **dict.fromkeys(("subject", "filter"), "not stated"),
    **dict.fromkeys(("preload_N", "along_mm", "across_mm", "tilt_deg"), 0.0),
}
"""Values of columns that neither the file nor the setup has."""
OPTIONS = {
    "site": "--region forearm",
    "indenter_shape": "--indenter flat:10.7 (its radius in mm)",
    "indenter_size_mm": "--indenter flat:10.7 (its radius in mm)",
}
"""Columns without a default -> the option that states them."""
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
        for trial_rows in np.split(rows, np.flatnonzero(ids[1:] != ids[:-1]) + 1) if len(rows) else []:
            trial = _trial(columns, trial_rows)
            if before := seen.get(trial.trial_id):
                where = f"line {before.line}" if before.path == trial.path else f"{before.path}, line {before.line},"
                raise ConfigError(
                    f"{trial.path}, line {trial.line}, column trial_id: {trial.trial_id!r} appeared already from "
                    f"{where} on, with other trials between; give each trial its own id and keep its rows together"
                )
            seen[trial.trial_id] = trial
    if any("phase" not in columns.text for columns in files):
        notes.append("loading and unloading derived from the path, where the file has no column phase")
    trials = _with_speeds(list(seen.values()))
    _check_units(trials)
    if averaged := sum(len(trial.time_s) > MAX_SAMPLES for trial in trials):
        notes.append(f"{averaged} trials of more than {MAX_SAMPLES} samples averaged in blocks to at most that many")
    sums = [columns.sha256 for columns in files]
    sha256 = sums[0] if len(sums) == 1 else hashlib.sha256("".join(sums).encode()).hexdigest()
    return TrialFile(trials=tuple(map(_averaged, trials)), sha256=sha256, notes=tuple(notes))


def regions_of(paths: Path | Sequence[Path], setup: Setup, *, valid: Sequence[str]) -> tuple[str, ...]:
    """Return the valid regions that occur at the start of a site in the files. Raises ConfigError if none does."""
    files = _columns(paths, setup, region=None)
    sites = {_plain(str(site)) for columns in files for site in set(columns.text["site"])}
    found = tuple(name for name in valid if any(site.startswith(name) for site in sites))
    if not found:
        shown = ", ".join(sorted(sites)[:8])
        raise ConfigError(f"{_named(files)}, column site: expected {', '.join(valid)}, got {shown}")
    return found


def _named(files: Sequence[Columns]) -> str:
    return f"{files[0].path}" if len(files) == 1 else f"{len(files)} files"


def _columns(paths: Path | Sequence[Path], setup: Setup, *, region: str | None) -> list[Columns]:
    """Read the files in the order of their names, each with the columns that the setup and DEFAULTS add."""
    several = sorted({paths} if isinstance(paths, Path) else set(paths), key=lambda path: (path.name, str(path)))
    names = [path.name for path in several]
    if unknown := sorted(set(setup.files).difference(names)):
        raise ConfigError(f"setup: files.{unknown[0]}: no such file was given; given: {', '.join(names)}")
    return [_completed(read_columns(path), setup.of(path), region=region) for path in several]


def _completed(columns: Columns, stated: dict[str, str | float], *, region: str | None) -> Columns:
    text, number, path = dict(columns.text), dict(columns.number), columns.path
    if both := [name for name in stated if name in text or name in number]:
        raise ConfigError(f"{path}: it has a column {both[0]}, and the setup or an option states it; give only one")
    stated = {"trial_id": path.stem, **DEFAULTS, **({"site": region} if region else {}), **stated}
    if stated.get("indenter_shape", text.get("indenter_shape", [""])[0]) == "cap":
        stated.setdefault("indenter_size_mm", 1.0)  # The cap has its own size.
    for name, value in stated.items():
        if name in NUMBERS:
            number.setdefault(name, np.full(len(columns.line), value, np.float64))
        else:
            text.setdefault(name, np.full(len(columns.line), value, object))
    for name, option in OPTIONS.items():
        if name not in text and name not in number:
            raise ConfigError(f"{path}: no column {name}; add it, or give {option}")
    return replace(columns, text=text, number=number)


def _plain(site: str) -> str:
    return "_".join(site.lower().replace("-", " ").replace("_", " ").split())


def _trial(columns: Columns, rows: npt.NDArray[np.int64]) -> Trial:
    name = str(columns.text["trial_id"][rows[0]])
    fault = _Fault(path=columns.path, lines=columns.line[rows], trial=name)
    if not name:
        raise fault(0, "trial_id", "it is empty; each trial needs an id")
    if len(rows) < MIN_SAMPLES:
        raise fault(0, "trial_id", f"it has {len(rows)} rows; a press needs at least {MIN_SAMPLES}")
    text, number = _constants(columns, rows, fault)
    time = columns.number["t_s"][rows]
    for k in np.flatnonzero(np.diff(time) <= 0)[:1] + 1:
        raise fault(k, "t_s", f"{time[k]:g} s after {time[k - 1]:g} s; time must increase within a trial")
    indentation, force = columns.number["indentation_mm"][rows] / 1000, columns.number["force_N"][rows]
    if "phase" in columns.text:
        phase = _phases(columns.text["phase"][rows], fault)
    else:
        phase = _phases_of_path(time, indentation, force, fault)
    if (loads := int((phase == 0).sum())) < MIN_SAMPLES:
        raise fault(0, "phase", f"{loads} rows of load; a press needs at least {MIN_SAMPLES}")
    cap = text["indenter_shape"] == "cap"
    condition = Condition(
        indenter_shape=text["indenter_shape"],
        indenter_size_m=None if cap else number["indenter_size_mm"] / 1000,
        speed_m_s=number.get("speed_mm_s", 0.0) / 1000,
        along_m=number["along_mm"] / 1000,
        across_m=number["across_mm"] / 1000,
        tilt_deg=number["tilt_deg"],
    )
    return Trial(
        trial_id=name,
        site=text["site"],
        subject=text["subject"],
        condition=condition,
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
    path: Path
    lines: npt.NDArray[np.int64]
    """(n,) line in the file of each row"""
    trial: str

    def __call__(self, row: int, column: str, message: str) -> ConfigError:
        return ConfigError(f"{self.path}, line {self.lines[row]}, column {column}: {message} (trial {self.trial!r})")


def _constants(columns: Columns, rows: npt.NDArray[np.int64], fault: _Fault) -> tuple[dict[str, str], dict[str, float]]:
    stored = {**columns.text, **columns.number}
    found = {column: stored[column][rows] for column in CONSTANT if column in stored}
    for column, values in found.items():
        for k in np.flatnonzero(values != values[0])[:1]:
            raise fault(k, column, f"{values[k]} after {values[0]}; one value per trial: start another trial_id")
    text = {column: str(found[column][0]) for column in found if column in TEXT_CONSTANTS}
    number = {column: float(found[column][0]) for column in found if column not in TEXT_CONSTANTS}
    shape = text["indenter_shape"]
    if shape not in SHAPES:
        raise fault(0, "indenter_shape", f"{shape!r}; valid: {', '.join(SHAPES)}")
    for column, (low, high) in LIMITS.items():
        free = column not in number or (column == "indenter_size_mm" and shape == "cap")
        if not free and not low <= number[column] <= high:
            raise fault(0, column, f"{number[column]:g} is not between {low:g} and {high:g}")
    return text, number


def _phases(words: npt.NDArray[np.object_], fault: _Fault) -> npt.NDArray[np.int64]:
    """(n,) index into PHASES"""
    words = np.array([WORDS.get(word.lower(), word.lower()) for word in words], object)
    for k in np.flatnonzero(~np.isin(words, PHASES))[:1]:
        raise fault(k, "phase", f"{words[k]!r}; valid: {', '.join(PHASES)}")
    phase = np.array([PHASES.index(word) for word in words])
    for k in np.flatnonzero(np.diff(phase) < 0)[:1] + 1:
        raise fault(k, "phase", f"{words[k]} after {words[k - 1]}; a trial is one press: load, then hold, then unload")
    return phase


def _phases_of_path(time: Array, depth: Array, force: Array, fault: _Fault) -> npt.NDArray[np.int64]:
    """(n,) index into PHASES, from where the path is deepest: before it the press loads, after it it unloads. A path
    that stays within TURN of there for several times as long as the turn takes holds meanwhile.

    Raises ConfigError for a path that goes in more than once, or along which the force falls.
    """
    window = max(1, len(depth) // 60)
    smooth = np.convolve(np.pad(depth, window, mode="edge"), np.ones(2 * window + 1) / (2 * window + 1), "valid")
    travel, turn = float(np.ptp(smooth)), int(smooth.argmax())
    rise = force[turn] - np.median(force[smooth < smooth.min() + 0.1 * travel]) if travel > 0 else 0.0
    outside = np.median(force[: max(3, len(force) // 50)])
    if rise < 0 and abs(force.min() - outside) >= abs(force.max() - outside):
        raise fault(turn, "force_N", "it falls while the indentation grows; compression and inward must be positive")
    if rise < 0 or turn == 0:
        raise fault(turn, "indentation_mm", "it falls while the force grows; inward must be positive")
    several = "the path goes in more than once; give each press a trial_id, or a file of its own"
    falls = np.maximum.accumulate(smooth[: turn + 1]) - smooth[: turn + 1]
    rises = smooth[turn:] - np.minimum.accumulate(smooth[turn:])
    for part, start in ((falls, 0), (rises, turn)):
        if turn < len(smooth) - 1 and part.max() > BACK * travel:
            raise fault(start + int(part.argmax()), "indentation_mm", several)
    phase = np.where(np.arange(len(depth)) > turn, PHASES.index("unload"), PHASES.index("load"))
    near = np.flatnonzero(smooth >= smooth[turn] - TURN * travel)
    way_in = smooth[: turn + 1]
    moving = (way_in > smooth[0] + 0.1 * travel) & (way_in < smooth[0] + 0.9 * travel)
    if moving.sum() >= 3:
        speed = abs(float(np.polyfit(time[: turn + 1][moving], way_in[moving], 1)[0]))
        if time[near[-1]] - time[near[0]] > 6 * TURN * travel / max(speed, 1e-9):
            phase[near[0] : near[-1] + 1] = PHASES.index("hold")
    return phase


def _with_speeds(trials: list[Trial]) -> list[Trial]:
    """Return the trials, without a stated speed with the middle of all that are alike, to two digits."""
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
        raise ConfigError(f"{_where(trial)}: fewer than 3 samples while moving in; record faster")
    return float(np.polyfit(time[moving], depth[moving], 1)[0])


def _where(trial: Trial) -> str:
    return f"{trial.path}, trial {trial.trial_id!r} from line {trial.line}"


def _check_units(trials: list[Trial]) -> None:
    """Raise ConfigError for magnitudes that only another unit or sign can explain."""
    deepest = max(trials, key=lambda trial: float(np.ptp(trial.indentation_m)))
    depth_mm = 1000 * float(np.ptp(deepest.indentation_m))
    spans = f"{deepest.path}, column indentation_mm: the deepest press spans {depth_mm:.4g} mm; that looks like"
    if depth_mm < 0.2:
        raise ConfigError(f"{spans} metres: multiply the column by 1000")
    if depth_mm > 150:
        raise ConfigError(f"{spans} micrometres: divide the column by 1000")
    low, high = LIMITS["speed_mm_s"]
    for trial in trials:
        load, where = trial.phase == 0, _where(trial)
        depth, force = trial.indentation_m[load], trial.force_n[load]
        if depth[-1] - depth[0] <= 0:
            raise ConfigError(f"{where}, column indentation_mm: it falls during load; inward must be positive")
        ends = max(3, len(force) // 20)
        rise = float(np.median(force[-ends:]) - np.median(force[:ends]))
        if rise < 0:
            raise ConfigError(
                f"{where}, column force_N: it falls by {-rise:.3g} N during load; compression is positive"
            )
        if not 0.05 <= rise <= 1000:
            raise ConfigError(f"{where}, column force_N: it rises by {rise:.4g} N during load; is it in newtons?")
        speed, stated = 1000 * _speed(trial), 1000 * trial.condition.speed_m_s
        moves = f"{where}: indentation_mm moves at {speed:.3g} mm per unit of t_s,"
        if not low <= speed <= high:
            raise ConfigError(
                f"{moves} which is not between {low:g} and {high:g} mm/s; check the units of t_s (seconds)"
            )
        if not 0.5 < speed / stated < 2.0:
            raise ConfigError(
                f"{moves} column speed_mm_s says {stated:.3g}; check the units of t_s (seconds) and speed_mm_s (mm/s)"
            )


def _averaged(trial: Trial) -> Trial:
    """Average a trial in blocks of equal length within each phase, so that at most MAX_SAMPLES samples are left."""
    if len(trial.time_s) <= MAX_SAMPLES:
        return trial
    block = int(np.ceil(len(trial.time_s) / (MAX_SAMPLES - len(PHASES))))
    group = np.concatenate([np.arange((trial.phase == p).sum()) // block + p * len(trial.time_s) for p in range(3)])
    _, index = np.unique(group, return_inverse=True)
    count = np.bincount(index)

    def mean(values: Array) -> Array:
        return np.bincount(index, values) / count

    streams = {name: mean(getattr(trial, name)) for name in ("time_s", "indentation_m", "force_n")}
    phase = np.rint(mean(trial.phase.astype(np.float64))).astype(np.int64)
    return replace(trial, phase=phase, **streams)
