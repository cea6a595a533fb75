"""Reads one file of measured presses, as force gauges and rigs write them, into columns of text and numbers.

A file may begin with a preamble, ``sep=;`` or comments, have a row of units under its header, and write decimals with
a comma. Every number must have a unit: in its column's name (``t_s``, ``Force [N]``) or in the row of units.
"""

from __future__ import annotations

import csv
import difflib
import hashlib
import io
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from carecontact.errors import ConfigError
from carecontact.lab.calibration.trial import Array

if TYPE_CHECKING:
    from _csv import Reader

GRAVITY = 9.80665
"""Standard gravity [m/s^2], which defines gram-force and pound-force."""
UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "sec": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "μs": 1e-6, "min": 60.0},
    "length": {"mm": 1.0, "m": 1e3, "cm": 10.0, "um": 1e-3, "μm": 1e-3, "in": 25.4, "inch": 25.4},
    "force": {
        "n": 1.0, "newton": 1.0, "newtons": 1.0, "mn": 1e-3, "cn": 1e-2, "kn": 1e3, "g": GRAVITY / 1e3,
        "gf": GRAVITY / 1e3, "kg": GRAVITY, "kgf": GRAVITY, "lbf": 0.45359237 * GRAVITY, "lb": 0.45359237 * GRAVITY,
        "ozf": 0.45359237 * GRAVITY / 16,
    },
    "speed": {"mm/s": 1.0, "mm_s": 1.0, "m/s": 1e3, "cm/s": 10.0, "mm/min": 1 / 60},
    "angle": {"deg": 1.0, "°": 1.0, "degree": 1.0, "degrees": 1.0, "rad": 180 / np.pi},
}  # fmt: skip
"""Kind of quantity -> unit in lower case -> factor to seconds, millimetres, newtons, mm/s or degrees."""
ELECTRIC = ("v", "mv", "mv/v", "volt", "volts", "a", "ma", "counts", "count", "adc", "digits", "%", "raw")
"""Units that say what an amplifier gave, and not a force or a depth."""
NUMBERS = {
    "t_s": ("time", "t, time, elapsed time, test time, timestamp, zeit, temps"),
    "indentation_mm": (
        "length",
        "indentation, indentation depth, depth, displacement, disp, travel, extension, stroke, position, weg, "
        "eindringtiefe, deplacement",
    ),
    "force_N": ("force", "force, load, f, fz, normal force, kraft, normalkraft"),
    "speed_mm_s": ("speed", "speed, velocity, geschwindigkeit"),
    "indenter_size_mm": ("length", "indenter size, indenter radius"),
    "preload_N": ("force", "preload"),
    "along_mm": ("length", "along"),
    "across_mm": ("length", "across"),
    "tilt_deg": ("angle", "tilt"),
}
"""Column -> its kind of quantity and the names that it may have beside its own."""
TEXTS = {
    "trial_id": "trial id, trial, press id, press",
    "site": "site",
    "subject": "subject, participant",
    "phase": "phase",
    "indenter_shape": "indenter shape",
    "filter": "filter",
}
KNOWN_UNITS = {unit for units in UNITS.values() for unit in units} | set(ELECTRIC)
NEEDED = ("t_s", "indentation_mm", "force_N")
HEAD_LINES = 200
"""The header is looked for in so many lines."""
SPACES = " "
DELIMITERS = (";", "\t", ",", "|", SPACES)
CHUNK_ROWS = 20_000
THOUSANDS = re.compile(r"-?[1-9]\d{0,2}([.,]\d{3})+")


@dataclass(frozen=True, kw_only=True)
class Columns:
    """The columns that a file has, by the names in TEXTS and NUMBERS."""

    path: Path
    sha256: str
    """Hash of the file's bytes."""
    text: dict[str, npt.NDArray[np.object_]]
    number: dict[str, Array]
    """In seconds, millimetres, newtons, mm/s and degrees."""
    line: npt.NDArray[np.int64]
    """(n,) each row's line in the file, from 1"""


@dataclass(frozen=True)
class _Field:
    text: str
    column: str | None = None
    """Name in TEXTS or NUMBERS, or None for a column that is not needed."""
    unit: str | None = None

    @property
    def exact(self) -> bool:
        return self.text == self.column


@dataclass(frozen=True)
class _Header:
    line: int
    """From 1."""
    delimiter: str
    fields: list[_Field]

    @property
    def columns(self) -> list[str]:
        return [field.column for field in self.fields if field.column is not None]


def read_columns(path: Path) -> Columns:
    """Read a file of presses. Raises ConfigError naming the file, the line and the column, and what would be valid."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file; name a CSV file of measured trials") from None
    except IsADirectoryError:
        raise ConfigError(f"{path} is a folder; name the CSV files of measured trials in it") from None
    source = io.StringIO(_decoded(data, path), newline="")
    header = _header(list(islice(source, HEAD_LINES)), path)
    source.seek(0)
    body = islice(source, header.line, None)
    spaced = header.delimiter == SPACES
    lines = (" ".join(line.split()) for line in body) if spaced else body
    rows = csv.reader(lines, delimiter=header.delimiter, skipinitialspace=not spaced)
    try:
        return _columns(rows, header, path, hashlib.sha256(data).hexdigest())
    except csv.Error as error:
        raise ConfigError(f"{path}, line {header.line + rows.line_num}: not CSV: {error}") from None


def _decoded(data: bytes, path: Path) -> str:
    """Return the text of UTF-8, of UTF-16 with its mark, or of Western Windows."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16", errors="replace")
    if b"\0" in data[:4096]:
        raise ConfigError(f"{path} is not a text file; save the trials as CSV in UTF-8")
    for encoding in ("utf-8-sig", "cp1252"):
        try:
            return data.decode(encoding)
        except UnicodeDecodeError as error:
            line = data.count(b"\n", 0, error.start) + 1
    raise ConfigError(f"{path}, line {line}: not UTF-8; save the trials as CSV in UTF-8")


def _header(head: Sequence[str], path: Path) -> _Header:
    """Return the first line that names time, indentation and force. Raises ConfigError for the nearest to it."""
    declared = re.fullmatch(r"\ufeff?sep=(.)\s*", head[0]) if head else None
    found = [
        _Header(number, delimiter, [_field(text) for text in fields])
        for number, line in enumerate(head, start=1)
        for delimiter in (declared[1] if declared else DELIMITERS)
        if len(fields := _split(line, delimiter)) > 1
    ]
    if not found:
        raise ConfigError(
            f"{path} is empty or has no table; one line names the columns, at least {', '.join(NEEDED)}; carecontact "
            "calibrate --template prints an example"
        )
    best = max(found, key=lambda one: (len(set(one.columns) & set(NEEDED)), len(one.columns), -one.line))
    _check_header(best, path)
    # Of two columns that may mean the same, the one with the exact name counts.
    exact = {field.column for field in best.fields if field.exact}
    fields = [replace(f, column=None) if f.column in exact and not f.exact else f for f in best.fields]
    return replace(best, fields=fields)


def _split(line: str, delimiter: str) -> list[str]:
    line = line.strip(" \r\n").removeprefix("\ufeff").lstrip("#%").strip(" ")
    if delimiter == SPACES:
        several = any(mark in line for mark in DELIMITERS if mark != SPACES)
        return [] if several else re.split(r"\s{2,}" if "  " in line else r"\s+", line)
    try:
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:
        return []


def _field(text: str) -> _Field:
    """Read a header's field: its name and, in brackets or behind it, its unit."""
    plain = unicodedata.normalize("NFKC", text).strip()
    name, unit = _words(plain), None
    for column, names in TEXTS.items():
        if name in names.split(", "):
            return _Field(plain, column)
    if bracket := re.fullmatch(r"(.+?)\s*[\[({<]\s*([^\])}>]*?)\s*[\])}>]", plain):
        name, unit = _words(bracket[1]), bracket[2]
    else:
        units = "|".join(map(re.escape, sorted(KNOWN_UNITS, key=len, reverse=True)))
        if behind := re.fullmatch(rf"(.+?)(?:\s*[/,]\s*|\s+in\s+|[_\s])({units})", plain, re.IGNORECASE):
            name, unit = _words(behind[1]), behind[2]
    for column, (_, names) in NUMBERS.items():
        if name in (*names.split(", "), _words(column.rpartition("_")[0])) or plain == column:
            return _Field(plain, column, unit)
    return _Field(plain)


def _words(text: str) -> str:
    """``Indentation_Depth`` -> ``indentation depth``, without accents."""
    letters = "".join(c for c in unicodedata.normalize("NFKD", text) if not unicodedata.combining(c))
    return " ".join(re.sub(r"[_\-.\s]+", " ", letters).lower().split())


def _check_header(header: _Header, path: Path) -> None:
    """Raise ConfigError for a column that is missing, there twice, or named almost like one that is not there."""
    place, columns = f"{path}, line {header.line}", header.columns
    others = [field.text for field in header.fields if field.column is None and field.text]
    if missing := [column for column in NEEDED if column not in columns]:
        near = dict.fromkeys(text for column in missing if (text := _nearest(column, others)))
        meant = f" (is it {' or '.join(map(repr, near))}?)" if near else ""
        raise ConfigError(
            f"{place}: no column {', '.join(missing)}{meant}; name {'it' if len(missing) == 1 else 'them'} so, or with "
            f"the unit in brackets; carecontact calibrate --template prints an example"
        )
    for column in dict.fromkeys(columns):
        same = [field for field in header.fields if field.column == column]
        if len(same) > 1 and sum(field.exact for field in same) != 1:
            raise ConfigError(
                f"{place}: columns {' and '.join(repr(field.text) for field in same)} may both be {column}; name the "
                f"right one {column}, or delete the other"
            )
    absent = [column for column in (*TEXTS, *NUMBERS) if column not in columns]
    for text in others:
        if close := difflib.get_close_matches(text.casefold(), absent, n=1, cutoff=0.8):
            raise ConfigError(f"{place}: no column is named {text!r}; is it {close[0]}? Rename or delete it")


def _nearest(column: str, others: Sequence[str]) -> str | None:
    """Return the field that comes nearest to any of the column's names."""
    words = [_words(word) for word in (column, column.rpartition("_")[0], *NUMBERS[column][1].split(", "))]

    def likeness(text: str) -> float:
        return max(difflib.SequenceMatcher(None, _words(text), word).ratio() for word in words if len(word) > 1)

    best = max(others, key=likeness, default=None)
    return best if best is not None and likeness(best) >= 0.6 else None


def _columns(rows: Reader, header: _Header, path: Path, sha256: str) -> Columns:
    width, before = len(header.fields), header.line
    kept = {field.column: k for k, field in enumerate(header.fields) if field.column is not None}
    text: dict[str, list[str]] = {name: [] for name in kept if name in TEXTS}
    number: dict[str, list[Array]] = {name: [] for name in kept if name in NUMBERS}
    factors: dict[str, float] = {}
    marks = _DecimalMarks(path)
    lines: list[int] = []
    while chunk := list(islice(rows, CHUNK_ROWS)):
        last = header.line + rows.line_num
        if last - before != len(chunk):
            raise ConfigError(f"{path}, between lines {before + 1} and {last}: a quoted field holds a line break")
        numbered: Sequence[int] = range(before + 1, last + 1)
        before = last
        # Spreadsheets also save rows that consist of delimiters only, and rigs end rows with a delimiter.
        if set(map(len, chunk)) != {width} or not all(map(itemgetter(0), chunk)):
            full = [k for k, row in enumerate(chunk) if "".join(row).strip() and not row[0].lstrip().startswith("#")]
            numbered = [numbered[k] for k in full]
            chunk = [row[:width] if not "".join(row[width:]).strip() else row for row in map(chunk.__getitem__, full)]
            _check_widths(numbered, chunk, header, path)
        if chunk and not factors:
            units = _units_row(chunk[0], kept)
            if units:
                numbered, chunk = numbered[1:], chunk[1:]
            factors = _factors(header, units, path)
        if not chunk:
            continue
        lines += numbered
        columns = list(zip(*chunk, strict=True))
        for name, values in text.items():
            values += map(str.strip, columns[kept[name]])
        for name, parts in number.items():
            label = header.fields[kept[name]].text
            parts.append(factors[name] * marks.numbers(columns[kept[name]], label, numbered))
    if not lines:
        raise ConfigError(f"{path} has column names but no rows")
    texts = {name: np.array(values, object) for name, values in text.items()}
    numbers = {name: np.concatenate(parts) for name, parts in number.items()}
    return Columns(path=path, sha256=sha256, text=texts, number=numbers, line=np.array(lines))


def _check_widths(lines: Sequence[int], rows: list[list[str]], header: _Header, path: Path) -> None:
    width = len(header.fields)
    for line, row in zip(lines, rows, strict=True):
        if len(row) != width:
            comma = header.delimiter == "," and len(row) > width
            raise ConfigError(
                f"{path}, line {line}: {len(row)} fields where line {header.line} names {width} columns"
                + ("; if commas mark decimals, separate the columns by semicolons" if comma else "")
            )


def _units_row(row: Sequence[str], kept: dict[str, int]) -> dict[str, str]:
    """Return the units of the columns if the row consists of units, else nothing."""
    plain = {name: re.sub(r"[\[\](){}]", "", row[k]).strip() for name, k in kept.items() if name in NUMBERS}
    units = {name: unicodedata.normalize("NFKC", unit) for name, unit in plain.items() if unit}
    named = all(name in units and _number(plain[name]) is None for name in NEEDED)
    return units if named and all(unit.lower() in KNOWN_UNITS for unit in units.values()) else {}


def _factors(header: _Header, row: dict[str, str], path: Path) -> dict[str, float]:
    """Return the factor of every column of numbers. Raises ConfigError for a missing or wrong unit."""
    out = {}
    for field in header.fields:
        if field.column not in NUMBERS:
            continue
        known = UNITS[kind := NUMBERS[field.column][0]]
        units = sorted({unit for unit in (field.unit, row.get(field.column)) if unit})
        electric = [unit for unit in units if unit.lower() in ELECTRIC]
        factors = {known.get(unit.lower(), np.nan) for unit in units}
        if not units:
            fault = f"it has no unit; name the column {field.column}, or write its unit in brackets"
        elif electric:
            fault = (
                f"{electric[0]} is what the amplifier gives; multiply the column by your sensor's calibration and name "
                f"it {field.column}"
            )
        elif np.isnan(list(factors)).any():
            fault = f"{' and '.join(units)} is not a unit of {kind}; valid: {', '.join(known)}"
        elif len(factors) > 1:
            fault = f"the header says {field.unit} and the row of units {row[field.column]}"
        else:
            out[field.column] = float(factors.pop())
            continue
        raise ConfigError(f"{path}, line {header.line}, column {field.text}: {fault}")
    return out


class _DecimalMarks:
    """Reads the numbers of a file, in which one mark, point or comma, separates decimals."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._seen: dict[str, tuple[int, str, str]] = {}
        """Mark -> line, column and value where it was first seen."""

    def numbers(self, values: Sequence[str], name: str, lines: Sequence[int]) -> Array:
        """Return a column as finite numbers (n,). Raises ConfigError naming the first line that holds anything else."""
        for mark in ".,":
            with_mark = [k for k, value in enumerate(values) if mark in value]
            if not with_mark:
                continue
            first, shown = lines[with_mark[0]], values[with_mark[0]].strip()
            self._seen.setdefault(mark, (first, name, shown))
            large = (value for value in values if mark not in value and abs(_number(value) or 0.0) >= 100)
            if all(THOUSANDS.fullmatch(values[k].strip()) for k in with_mark) and any(large):
                self._refuse(first, name, f"{shown!r} may have a mark between thousands; write numbers without it")
        if len(self._seen) > 1:
            (line, column, value), (_, other, shown) = self._seen[","], self._seen["."]
            points = f"{shown!r} in column {other} has a point"
            self._refuse(line, column, f"{value!r} has a comma, and {points}; write decimals with one mark, and no "
                         "thousands")  # fmt: skip
        try:
            out = np.array(list(map(float, values)))
        except ValueError:
            out = np.array([np.nan if (number := _number(value)) is None else number for value in values])
        for k in map(int, np.flatnonzero(~np.isfinite(out))[:1]):
            value = values[k].strip()
            self._refuse(lines[k], name, f"{repr(value) if value else 'an empty field'} is not a finite number")
        return out

    def _refuse(self, line: int, column: str, why: str) -> None:
        raise ConfigError(f"{self._path}, line {line}, column {column}: {why}")


def _number(text: str) -> float | None:
    """Return a number with a decimal point or comma and with either minus sign; None for anything else."""
    try:
        return float(text.strip().replace("\u2212", "-").replace(",", "."))
    except ValueError:
        return None
