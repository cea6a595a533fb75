"""``results.parquet``: one row per trial, for data frames and SQL. Needs the extra ``tables``."""

from __future__ import annotations

import types
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin

import numpy as np

from carecontact.errors import DependencyError
from carecontact.recording.file import replace_file
from carecontact.report.tables import sorted_scores
from carecontact.scoring.metrics.metric import METRICS
from carecontact.scoring.result import TrialScore

TABLE_NAME = "results.parquet"
UNIT_SUFFIX = {
    "1": "", "N": "_n", "N s": "_ns", "N/s": "_n_s", "s": "_s", "J": "_j", "kPa": "_kpa", "m": "_m", "rad": "_rad",
    "N m": "_nm",
}  # fmt: skip
"""Unit of a metric -> end of its column's name."""
NEEDS = "the table of trials needs pyarrow: pip install 'carecontact[tables]'"


Kind = type[str] | type[float] | type[int] | type[bool]


@dataclass(frozen=True, kw_only=True)
class Column:
    name: str
    """The unit is its end, as in ``c1_peak_force_n``; without one it is a plain number."""
    kind: Kind
    value: Callable[[TrialScore], Any]
    """None: null."""


def columns(scores: Sequence[TrialScore]) -> list[Column]:
    found = [
        Column(name=name, kind=kind, value=lambda s, name=name: getattr(s, name))
        for name, field in TrialScore.model_fields.items()
        if (kind := _scalar(field.annotation)) is not None
    ]
    found += [
        Column(name="is_judged", kind=bool, value=lambda s: s.is_judged),
        Column(name="protocol_title", kind=str, value=lambda s: s.protocol_title),
        Column(name="mujoco_version", kind=str, value=lambda s: s.world.get("mujoco")),
    ]
    further = sorted({id_ for s in scores for id_ in s.additional})
    return found + [
        Column(name=metric_column(id_), kind=float, value=lambda s, id_=id_: s.additional.get(id_)) for id_ in further
    ]


def metric_column(id_: str) -> str:
    """``impulse@1`` -> ``metric_impulse_v1_ns``: SQL wants no @, and the version stays."""
    name, _, version = id_.partition("@")
    unit = METRICS[id_].unit if id_ in METRICS else "1"
    return f"metric_{name.lower()}_v{version or '0'}{UNIT_SUFFIX.get(unit, '')}"


def write_trial_table(folder: Path | str, scores: Sequence[TrialScore]) -> Path:
    """Write ``results.parquet`` into ``folder`` and return its path. Raises DependencyError as ``trial_table``."""
    table = trial_table(scores)
    buffer = BytesIO()
    import_module("pyarrow.parquet").write_table(table, buffer)
    path = Path(folder) / TABLE_NAME
    replace_file(path, buffer.getvalue())
    return path


def trial_table(scores: Sequence[TrialScore]) -> Any:
    """Return the table that ``results.parquet`` holds, as a ``pyarrow.Table``: rows by task and seed, NA as null.

    Raises DependencyError, saying what installs it, without pyarrow.
    """
    try:
        arrow = import_module("pyarrow")
    except ModuleNotFoundError:
        raise DependencyError(NEEDS) from None
    rows, fields = sorted_scores(scores), columns(scores)
    return arrow.table(
        [_array(arrow, c.kind, [c.value(s) for s in rows]) for c in fields], names=[c.name for c in fields]
    )


def _array(arrow: Any, kind: Kind, values: Sequence[Any]) -> Any:
    """``values`` as a ``pyarrow.Array``, None as null, from buffers of Arrow's columnar format: ``pyarrow.array``
    imports pandas, which takes 0.3 s of every run."""
    present = arrow.py_buffer(_bitmap([value is not None for value in values]))
    if kind is str:
        texts = [b"" if value is None else value.encode() for value in values]
        ends = np.cumsum([0, *map(len, texts)]).astype("<i4")
        buffers = [present, arrow.py_buffer(ends.tobytes()), arrow.py_buffer(b"".join(texts))]
        return arrow.Array.from_buffers(arrow.string(), len(values), buffers)
    filled = [kind() if value is None else kind(value) for value in values]
    if kind is bool:
        return arrow.Array.from_buffers(arrow.bool_(), len(values), [present, arrow.py_buffer(_bitmap(filled))])
    number, dtype = (arrow.float64(), "<f8") if kind is float else (arrow.int64(), "<i8")
    return arrow.Array.from_buffers(number, len(values), [present, arrow.py_buffer(np.array(filled, dtype).tobytes())])


def _bitmap(flags: Sequence[Any]) -> bytes:
    return np.packbits(np.array(flags, bool), bitorder="little").tobytes()


def _scalar(annotation: Any) -> Kind | None:
    """Return the type for ``float``, ``float | None`` or a Literal of strings; None for what is no single value."""
    if get_origin(annotation) in (Union, types.UnionType):
        kinds = {_scalar(part) for part in get_args(annotation) if part is not type(None)}
        return kinds.pop() if len(kinds) == 1 else None
    if get_origin(annotation) is Literal:
        return str
    return annotation if annotation in (str, float, int, bool) else None
