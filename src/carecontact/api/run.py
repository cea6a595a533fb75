"""A finished run as an object: its scores, trials as a table, and its comparison with another."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from carecontact.errors import ConfigError, DependencyError, UnknownNameError, did_you_mean
from carecontact.report.comparison import Comparison, check_different, compare_runs
from carecontact.report.trial_table import trial_table
from carecontact.runs.scoring import read_scores

if TYPE_CHECKING:
    from carecontact.recording.schema import Recording
    from carecontact.runs.pooling import RunScores
    from carecontact.scoring.result import TrialScore


FrameLibrary = Literal["pandas", "polars", "pyarrow"]
LIBRARIES: tuple[FrameLibrary, ...] = get_args(FrameLibrary)


def load(path: str | Path, *, rescore: bool = False) -> Run:
    """Open a finished run.

    Args:
        path: the folder that `carecontact run --out` named, or a results file alone (``results.json``, also packed as
            ``.json.gz``).
        rescore: compute the scores again from the recordings instead of reading ``results.json``. Nothing is written.

    Raises ConfigError if the path is no run, if its scores cannot be read, or if they do not belong to the recordings
    beside them.
    """
    if not isinstance(path, str | Path):
        raise ConfigError(f"{path!r} is no place of a run; name its folder, or its results.json, as a text or a Path")
    path = Path(path)
    if path.suffix == ".h5":
        raise ConfigError(
            f"{path}: this names the recording of one trial; load the run's folder, then read the recording with "
            f"run.recordings[{path.stem!r}]"
        )
    if path.is_file() and not path.name.endswith((".json", ".json.gz")):
        raise ConfigError(f"{path}: this is no run; name the folder of a run, or its results.json")
    return Run(path=path, scored=read_scores(path, rescore=rescore, otherwise=", or load it with rescore=True"))


@dataclass(frozen=True, kw_only=True)
class Run:
    """One run of one policy. ``load`` and ``evaluate`` make it."""

    path: Path
    """Folder of the run, or its results file."""
    scored: RunScores
    """What was read: scores, and which trials or files are left out."""

    def __repr__(self) -> str:
        policy = self.scores[0].policy_title if self.scores else "no policy"
        trials = self.incomplete or f"{len(self.scores)} trial{'' if len(self.scores) == 1 else 's'}"
        return f"Run({str(self.path)!r}: {policy}, {trials})"

    @property
    def scores(self) -> list[TrialScore]:
        """One score for each trial, in the order of the files; SI units; None is NA (docs/scores.md)."""
        return self.scored.scores

    @property
    def missing(self) -> tuple[str, ...]:
        """Trials that were planned and have no score."""
        return self.scored.missing

    @property
    def unjudged(self) -> dict[str, str]:
        """Planned trial -> why it has no verdict; empty for a complete run. Every rate is open by as many trials."""
        return self.scored.unjudged

    @property
    def incomplete(self) -> str:
        """``incomplete, 15 of 18 planned trials have a verdict``; empty for a complete run."""
        return self.scored.incomplete

    @property
    def skipped(self) -> dict[str, str]:
        """File name -> why the file was not scored."""
        return self.scored.skipped

    @cached_property
    def results(self) -> dict[str, Any]:
        """What ``results.json`` holds: ``overall``, ``per_task``, ``per_region``, ``sweeps``, ``trials`` and
        provenance, with rates in percent."""
        from carecontact.runs.results_file import results

        return _Results(results(self.scored))

    @cached_property
    def recordings(self) -> Recordings:
        """Trial id -> recording. A recording is read and verified each time that it is asked for."""
        return Recordings(self.path if self.path.is_dir() else self.path.parent)

    def trials(self, library: FrameLibrary | None = None) -> Any:
        """Return one row for each trial, with the columns of ``results.parquet`` (docs/scores.md), ordered by task and
        seed.

        Args:
            library: ``"pandas"``, ``"polars"`` or ``"pyarrow"``; by default pandas if it is installed, else polars.

        Raises DependencyError if the library or pyarrow is not installed, and ConfigError for another name.
        """
        chosen = library or _installed()
        if chosen not in LIBRARIES:
            raise ConfigError(
                f"there is no table for {chosen!r}{did_you_mean(str(chosen), LIBRARIES)}; valid: {', '.join(LIBRARIES)}"
            )
        table = trial_table(self.scores)
        if chosen == "pyarrow":
            return table
        try:
            made = import_module(chosen)
        except ModuleNotFoundError:
            package = "'carecontact[tables]'" if chosen == "pandas" else chosen
            raise DependencyError(f"{chosen} is not installed: pip install {package}") from None
        if chosen == "polars":
            return made.from_arrow(table)
        # Whole numbers, truths and texts with NA keep their types; without this, pandas makes them floats and objects.
        arrow = import_module("pyarrow")
        types = {
            arrow.int64(): made.Int64Dtype(),
            arrow.bool_(): made.BooleanDtype(),
            arrow.string(): made.StringDtype(),
        }
        return table.to_pandas(types_mapper=types.get)


def _installed() -> FrameLibrary:
    if find_spec("pandas"):
        return "pandas"
    if find_spec("polars"):
        return "polars"
    raise DependencyError("neither pandas nor polars is installed: pip install 'carecontact[tables]'")


class _Results(dict[str, Any]):
    """The content of a results file, which answers an unknown name with the known ones."""

    def __missing__(self, name: object) -> Any:
        raise UnknownNameError("part of the results", str(name), self)


class NoRecordingError(ConfigError, KeyError):
    """A trial that has no recording in a folder. Also a KeyError, as ``get`` of a mapping expects."""

    __str__ = Exception.__str__  # KeyError would show the message in quotes


class Recordings(Mapping[str, "Recording"]):
    """The recordings of a folder by trial id."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def __getitem__(self, trial_id: str) -> Recording:
        """Return the trial's header and its arrays by path, such as ``["scorer/normal_force"]`` (docs/python.md).

        Raises NoRecordingError, which is a ConfigError and a KeyError, for a trial that has no recording here, and
        RecordingError for a file that is damaged.
        """
        from carecontact.recording import read_recording

        if trial_id not in self:
            known = list(self)
            has = f"it has {known[0]} to {known[-1]}" if known else "it has no recordings"
            meant = did_you_mean(str(trial_id), known)
            raise NoRecordingError(f"{self._folder} has no recording of {trial_id!r}{meant}; {has}")
        return read_recording(self._folder / f"{trial_id}.h5")

    def __contains__(self, trial_id: object) -> bool:
        return trial_id in set(self)

    def __iter__(self) -> Iterator[str]:
        return iter(sorted(path.stem for path in self._folder.glob("*.h5")))

    def __len__(self) -> int:
        return sum(1 for _ in self)


# Two runs compared from Python, as `carecontact compare` compares them.


def compare(
    a: Run | str | Path, b: Run | str | Path, *, per_task: bool = False, allow_incomplete: bool = False
) -> Comparison:
    """Compare two runs trial by trial; every difference is a minus b (docs/comparing.md).

    Args:
        a: a run, or the place of one.
        b: the other run.
        per_task: whether to compare each task alone as well.
        allow_incomplete: whether to compare runs of which planned trials have no verdict, over those that there are.

    Returns what the command prints: ``overall`` has one line for each rate and score, ``per_task`` the lines of each
    task, and ``as_json()`` gives the content of ``comparison.json``.

    Raises ConfigError, naming what differs, if the runs must not be compared, are one run, or have no trial in common.
    """
    check_different([run.path if isinstance(run, Run) else Path(run) for run in (a, b)])
    of_a, of_b = (run if isinstance(run, Run) else load(run) for run in (a, b))
    return compare_runs(of_a.scored, of_b.scored, per_task=per_task, allow_incomplete=allow_incomplete)
