"""Reads a trials file into columns of text and numbers, before anything is known about presses."""

from __future__ import annotations

import csv
import hashlib
import io
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from operator import itemgetter
from pathlib import Path

import numpy as np
import numpy.typing as npt

from carecontact.calibration.trial import Array
from carecontact.errors import ConfigError

TEXT_COLUMNS = ("trial_id", "site", "subject", "phase", "indenter_shape", "filter")
NUMBER_COLUMNS = ("t_s", "indentation_mm", "force_N", "speed_mm_s", "indenter_size_mm", "preload_N")
OPTIONAL_COLUMNS = {"along_mm": 0.0, "across_mm": 0.0, "tilt_deg": 0.0}
CHUNK_ROWS = 20_000


@dataclass(frozen=True, kw_only=True)
class Columns:
    path: Path
    sha256: str
    """Hash of the file's bytes."""
    text: dict[str, npt.NDArray[np.object_]]
    number: dict[str, Array]
    line: npt.NDArray[np.int64]
    """(n,) each row's line in the file, from 1"""


def read_columns(path: Path) -> Columns:
    """Read a CSV file with a header line. It may use commas, semicolons or tabs, have ``#`` lines before the header,
    and have its columns in any order.

    Raises ConfigError naming the file, the line and the column, and what would be valid.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file; name a CSV file of measured trials") from None
    except IsADirectoryError:
        raise ConfigError(f"{path} is a folder; name a CSV file of measured trials") from None
    source = io.StringIO(_decoded(data, path), newline="")
    header_line, header = 0, ""
    for header_line, header in enumerate(source, start=1):  # noqa: B007
        if header.strip() and not header.startswith("#"):
            break
    else:
        raise ConfigError(f"{path} is empty; its first line names the columns: {', '.join(_required())}")
    delimiter = max(",;\t", key=header.count)
    names = [name.strip() for name in next(csv.reader([header], delimiter=delimiter))]
    _check_header(names, path)
    text: dict[str, list[str]] = {name: [] for name in TEXT_COLUMNS}
    number: dict[str, list[Array]] = {name: [] for name in (*NUMBER_COLUMNS, *OPTIONAL_COLUMNS) if name in names}
    lines: list[int] = []
    before = header_line
    rows = csv.reader(source, delimiter=delimiter)
    try:
        while chunk := list(islice(rows, CHUNK_ROWS)):
            last = header_line + rows.line_num
            if last - before != len(chunk):
                raise ConfigError(f"{path}, between lines {before + 1} and {last}: a quoted field holds a line break")
            numbered = range(before + 1, last + 1)
            before = last
            # Spreadsheets also save rows that consist of delimiters only.
            if set(map(len, chunk)) != {len(names)} or not all(map(itemgetter(0), chunk)):
                kept = [k for k, row in enumerate(chunk) if "".join(row).strip()]
                numbered, chunk = [numbered[k] for k in kept], [chunk[k] for k in kept]
                _check_widths(numbered, chunk, names, path)
            if not chunk:
                continue
            lines += numbered
            columns = dict(zip(names, zip(*chunk, strict=True), strict=True))
            for name, values in text.items():
                values += map(str.strip, columns[name])
            for name, parts in number.items():
                parts.append(_numbers(columns[name], name, numbered, path, decimal_comma=delimiter == ";"))
    except csv.Error as error:
        raise ConfigError(f"{path}, line {header_line + rows.line_num}: not CSV: {error}") from None
    if not lines:
        raise ConfigError(f"{path} has column names but no rows")
    numbers = {name: np.concatenate(parts) for name, parts in number.items()}
    for name, default in OPTIONAL_COLUMNS.items():
        numbers.setdefault(name, np.full(len(lines), default))
    return Columns(
        path=path,
        sha256=hashlib.sha256(data).hexdigest(),
        text={name: np.array(values, object) for name, values in text.items()},
        number=numbers,
        line=np.array(lines),
    )


def _required() -> tuple[str, ...]:
    return ("trial_id", "site", "subject", "t_s", "indentation_mm", "force_N", "phase", "speed_mm_s", "indenter_shape",
            "indenter_size_mm", "preload_N", "filter")  # fmt: skip


def _decoded(data: bytes, path: Path) -> str:
    if b"\0" in data[:4096]:
        raise ConfigError(f"{path} is not a text file; save the trials as CSV in UTF-8")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise ConfigError(f"{path}, line {line}: not UTF-8; save the trials as CSV in UTF-8") from None


def _check_header(names: list[str], path: Path) -> None:
    missing = [name for name in _required() if name not in names]
    if missing:
        raise ConfigError(
            f"{path}: no column {', '.join(missing)}; the first line names {', '.join(names)[:300]}; needed are "
            f"{', '.join(_required())}, and {', '.join(OPTIONAL_COLUMNS)} where they are not zero"
        )
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ConfigError(f"{path}: column {', '.join(twice)} appears more than once")


def _check_widths(lines: Sequence[int], rows: list[list[str]], names: list[str], path: Path) -> None:
    for line, row in zip(lines, rows, strict=True):
        if len(row) != len(names):
            raise ConfigError(f"{path}, line {line}: {len(row)} fields where the first line names {len(names)} columns")


def _numbers(values: tuple[str, ...], name: str, lines: Sequence[int], path: Path, *, decimal_comma: bool) -> Array:
    """Return a column as finite numbers (n,). Raises ConfigError naming the first line that holds anything else."""
    if decimal_comma:
        values = tuple(value.replace(",", ".") for value in values)
    try:
        out = np.array(list(map(float, values)))
    except ValueError:
        out = None
    if out is not None and np.isfinite(out).all():
        return out
    line, value = next((line, value) for line, value in zip(lines, values, strict=True) if not _finite(value))
    shown = repr(value.strip()) if value.strip() else "an empty field"
    raise ConfigError(f"{path}, line {line}, column {name}: {shown} is not a finite number")


def _finite(value: str) -> bool:
    try:
        return bool(np.isfinite(float(value)))
    except ValueError:
        return False
