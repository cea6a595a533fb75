"""The trials of a run as a table of pandas, polars or pyarrow. No library is imported before it is asked for."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Literal, get_args

from carecontact.errors import ConfigError, DependencyError, did_you_mean
from carecontact.reports.trial_table import trial_table

if TYPE_CHECKING:
    from carecontact.scoring.result import TrialScore

FrameLibrary = Literal["pandas", "polars", "pyarrow"]
LIBRARIES: tuple[FrameLibrary, ...] = get_args(FrameLibrary)


def frame(scores: Sequence[TrialScore], *, library: FrameLibrary | None = None) -> Any:
    """Return one row for each trial; see ``Run.trials``.

    Raises DependencyError if the library or pyarrow is not installed, and ConfigError for another library's name.
    """
    chosen = library or _installed()
    if chosen not in LIBRARIES:
        raise ConfigError(
            f"there is no table for {chosen!r}{did_you_mean(str(chosen), LIBRARIES)}; valid: {', '.join(LIBRARIES)}"
        )
    table = trial_table(scores)
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
    return table.to_pandas(types_mapper=_nullable(made))


def _installed() -> FrameLibrary:
    if find_spec("pandas"):
        return "pandas"
    if find_spec("polars"):
        return "polars"
    raise DependencyError("neither pandas nor polars is installed: pip install 'carecontact[tables]'")


def _nullable(pandas: Any) -> Any:
    arrow = import_module("pyarrow")
    return {
        arrow.int64(): pandas.Int64Dtype(),
        arrow.bool_(): pandas.BooleanDtype(),
        arrow.string(): pandas.StringDtype(),
    }.get
