"""What a trials file may hold, and what the error says where it may not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from carecontact.errors import ConfigError
from carecontact.lab.calibration.checks import MAX_SAMPLES, read_trials
from carecontact.lab.calibration.trial import Setup, template
from tests.lab.calibration.conftest import HEADER, rows, save

Edit = Callable[[list[str]], list[str]]


def column(lines: list[str], name: str, change: Callable[[str], str], *, only: slice = slice(None)) -> list[str]:
    k = HEADER.split(",").index(name)
    fields = [line.split(",") for line in lines]
    for row in fields[only]:
        row[k] = change(row[k])
    return [",".join(row) for row in fields]


def test_a_trial_is_read_in_si_units(tmp_path: Path) -> None:
    file = read_trials(save(tmp_path / "t.csv", rows("a") + rows("b", unload=True)), region="forearm")
    first, second = file.trials
    assert (first.trial_id, first.subject, first.condition.indenter_size_m) == ("a", "p1", 0.010)
    assert first.condition.speed_m_s == pytest.approx(0.005)
    assert first.indentation_m[-1] == pytest.approx(0.004)
    assert not first.unloads
    assert second.unloads
    assert file.notes == ()


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda r: column(r, "indentation_mm", lambda v: f"{float(v) / 1000:.8f}"), r"looks like metres"),
        (lambda r: column(r, "indentation_mm", lambda v: f"{float(v) * 1000:.3f}"), r"looks like micrometres"),
        (lambda r: column(r, "indentation_mm", lambda v: f"{-float(v)}"), r"inward must be positive"),
        (lambda r: column(r, "force_N", lambda v: "nan", only=slice(7, 8)), r"line 9, column force_N: 'nan'"),
        (lambda r: column(r, "force_N", lambda v: "", only=slice(7, 8)), r"line 9, column force_N: an empty field"),
        (lambda r: column(r, "force_N", lambda v: "x1", only=slice(2, 3)), r"line 4, column force_N: 'x1'"),
        (lambda r: column(r, "force_N", lambda v: f"{-float(v)}"), r"compression is positive"),
        (lambda r: column(r, "force_N", lambda v: f"{float(v) / 1000}"), r"is it in newtons"),
        (lambda r: column(r, "t_s", lambda v: "0.1", only=slice(9, 10)), r"line 11, column t_s: .*must increase"),
        (lambda r: column(r, "t_s", lambda v: f"{float(v) * 1000}"), r"check the units of t_s"),
        (lambda r: column(r, "speed_mm_s", lambda v: "0.005"), r"column speed_mm_s: 0.005 is not between"),
        (lambda r: column(r, "indenter_shape", lambda v: "wedge"), r"column indenter_shape: 'wedge'; valid: flat"),
        (lambda r: column(r, "indenter_size_mm", lambda v: "12", only=slice(20, 60)), r"line 22.*one value per trial"),
        (lambda r: column(r, "phase", lambda v: "down", only=slice(3, 4)), r"line 5, column phase: 'down'; valid"),
        (lambda r: column(r, "phase", lambda v: "unload", only=slice(3, 4)), r"load after unload"),
        (lambda r: column(r, "site", lambda v: "knee"), r"column site: .*forearm .*knee"),
        (lambda r: [*r, "a,forearm,p1"], r"line 62: 3 fields where line 1 names 12"),
        (lambda r: [*r, *rows("b"), *rows("a")], r"'a' appeared already from line 2 on"),
        (lambda r: r[:5], r"5 rows; a press needs at least 12"),
        (lambda r: [], r"no rows"),
    ],
)  # fmt: skip
def test_faults_name_the_place(edit: Edit, message: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=message):
        read_trials(save(tmp_path / "t.csv", edit(rows())), region="forearm")


def test_missing_columns_are_all_named(tmp_path: Path) -> None:
    path = save(tmp_path / "t.csv", ["a,1,2"], header="trial_id,when,N")
    with pytest.raises(ConfigError, match=r"no column t_s, indentation_mm, force_N; name them so"):
        read_trials(path, region="forearm")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "is empty"),
        (b"\n\n", "is empty"),
        (b"PK\x03\x04\0\0", "not a text file"),
        (b"t_s,indentation_mm,force_N\n\x81", "line 2: not UTF-8"),
    ],
)
def test_files_that_are_no_table(data: bytes, message: str, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_bytes(data)
    with pytest.raises(ConfigError, match=message):
        read_trials(tmp_path / "t.csv", region="forearm")


def test_rows_of_delimiters_are_left_out(tmp_path: Path) -> None:
    """As spreadsheets leave them under a table."""
    path = save(tmp_path / "t.csv", rows("a"))
    empty = "," * path.read_text().splitlines()[-1].count(",")
    path.write_text(path.read_text().rstrip("\n") + f"\n{empty}\n{empty}\n")
    assert len(read_trials(path, region="forearm").trials) == 1


def test_no_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no such file"):
        read_trials(tmp_path / "t.csv", region="forearm")
    with pytest.raises(ConfigError, match="is a folder"):
        read_trials(tmp_path, region="forearm")


def test_other_sites_are_left_out_and_counted(tmp_path: Path) -> None:
    file = read_trials(save(tmp_path / "t.csv", rows("a") + rows("b", site="Upper arm anterior")), region="upper_arm")
    assert [trial.trial_id for trial in file.trials] == ["b"]
    assert file.notes == ("60 rows of other sites left out",)


def test_long_trials_are_averaged_and_counted(tmp_path: Path) -> None:
    file = read_trials(save(tmp_path / "t.csv", rows(n=9000)), region="forearm")
    trial = file.trials[0]
    assert len(trial.time_s) <= MAX_SAMPLES
    assert "averaged" in file.notes[0]
    # Averages of a straight line lie on it.
    inside = trial.indentation_m > 0.0001
    np.testing.assert_allclose(trial.force_n[inside], 1000 * trial.indentation_m[inside], rtol=1e-3)


@pytest.mark.slow
def test_a_million_rows(tmp_path: Path) -> None:
    one = rows(n=50_000)
    lines = [line.replace("a,", f"t{k},", 1) for k in range(20) for line in one]
    file = read_trials(save(tmp_path / "t.csv", lines), region="forearm")
    assert len(file.trials) == 20
    assert all(len(trial.time_s) <= MAX_SAMPLES for trial in file.trials)


# Files as force gauges and rigs write them: each is read rightly, or refused in one line that says what to change.

T = 0.02 * np.arange(101)
DEPTH = np.round(4.0 - 5.0 * np.abs(T - 1.0), 4)
"""1 mm outside the skin, 4 mm in, and out again, at 5 mm/s [mm]."""
FORCE = np.round((0.9 * np.maximum(DEPTH, 0) + 0.07 * np.maximum(DEPTH, 0) ** 2) * np.where(T > 1.0, 0.8, 1.0), 4)
SETUP = Setup(indenter_shape="flat", indenter_size_mm=10.7)
File = str | bytes


def table(
    *,
    names: tuple[str, ...] = ("t_s", "indentation_mm", "force_N"),
    by: str = ",",
    units: tuple[str, ...] = (),
    decimal: str = ".",
    minus: str = "-",
    before: str = "",
    factors: tuple[float, float, float] = (1.0, 1.0, 1.0),
    more: tuple[str, ...] = (),
    style: str = ".6g",
    quote: str = "",
    end: str = "\n",
    behind: str = "",
    t: np.ndarray = T,
    depth: np.ndarray = DEPTH,
    force: np.ndarray = FORCE,
) -> str:
    """The press in one dialect. ``more``: texts of further columns; ``behind``: what ends every row of values."""
    columns = [factor * values for factor, values in zip(factors, (t, depth, force), strict=True)]
    rows = [by.join(names), *([by.join(units)] if units else [])]
    for values in zip(*columns, strict=True):
        texts = [format(value, style).replace(".", decimal).replace("-", minus) for value in values]
        rows.append(by.join(f"{quote}{text}{quote}" for text in (*texts, *more)) + behind)
    return before + end.join(rows) + end


def noted(change: Callable[[list[str]], list[str]], **arguments: object) -> str:
    """The press with its lines changed."""
    return "\n".join(change(table(**arguments).splitlines())) + "\n"  # type: ignore[arg-type]


BRACKETS = ("t [s]", "Indentation [mm]", "Force [N]")
GERMAN = ("Zeit [s]", "Weg [mm]", "Kraft [N]")
PREAMBLE = "Report of test 12\nOperator: A. B.\nLoad cell, 50 N, 2024-05-03\nSample rate,50,Hz\n\n"
PLAIN = ("Time", "Travel", "Load")
HOLD = np.r_[DEPTH[:51], np.full(40, DEPTH[50]), DEPTH[51:]]
RIGHT: dict[str, File] = {
    "commas": table(),
    "semicolons": table(by=";"),
    "tabs": table(by="\t"),
    "bars": table(by="|"),
    "spaces": table(by=" "),
    "wide spaces": table(by="   ", names=("Time (s)", "Depth (mm)", "Force (N)")),
    "sep=;": table(by=";", before="sep=;\n"),
    "sep=, and BOM": "\ufeff" + table(before="sep=,\n"),
    "BOM": "\ufeff" + table(),
    "UTF-16": table(by="\t").encode("utf-16"),
    "Western Windows": table(names=("Time [s]", "Depth [µm]", "Force [N]"), factors=(1, 1e3, 1)).encode("cp1252"),
    "CRLF": table(end="\r\n"),
    "CR": table(end="\r"),
    "decimal comma, semicolons": table(by=";", decimal=","),
    "decimal comma, tabs": table(by="\t", decimal=","),
    "decimal comma, bars": table(by="|", decimal=","),
    "decimal comma, spaces": table(by=" ", decimal=","),
    "decimal comma, quoted": table(decimal=",", quote='"'),
    "minus sign": table(minus="\u2212"),
    "minus sign, decimal comma": table(by=";", decimal=",", minus="\u2212"),
    "preamble": table(before=PREAMBLE, names=BRACKETS),
    "preamble with semicolons": table(by=";", before="Date;2024-05-03\nName;x\nSpeed;5\n", names=BRACKETS),
    "row of units": table(names=PLAIN, units=("s", "mm", "N")),
    "row of units in brackets": table(names=PLAIN, units=("[s]", "[mm]", "[N]")),
    "all at once": table(
        names=PLAIN, units=("ms", "um", "mN"), by=";", decimal=",", minus="\u2212", before="sep=;\nGauge;x\n\n",
        factors=(1e3, 1e3, 1e3), end="\r\n",
    ),
    "brackets": table(names=BRACKETS),
    "parentheses": table(names=("Time (sec)", "Displacement (mm)", "Load (N)")),
    "slashes": table(names=("t/s", "depth/mm", "F/N")),
    "in": table(names=("t in s", "depth in mm", "F in N"), by=";"),
    "German": table(names=GERMAN, by=";", decimal=","),
    "French": table(names=("Temps (s)", "Déplacement (mm)", "Force (N)"), by=";", decimal=",").encode("cp1252"),
    "milliseconds": table(names=("t [ms]", *BRACKETS[1:]), factors=(1e3, 1, 1)),
    "minutes": table(names=("Time [min]", *BRACKETS[1:]), factors=(1 / 60, 1, 1), style=".9g"),
    "micrometres": table(names=(BRACKETS[0], "Position [µm]", BRACKETS[2]), factors=(1, 1e3, 1)),
    "metres": table(names=(BRACKETS[0], "Displacement [m]", BRACKETS[2]), factors=(1, 1e-3, 1)),
    "centimetres": table(names=(BRACKETS[0], "Stroke [cm]", BRACKETS[2]), factors=(1, 0.1, 1)),
    "inches": table(names=(BRACKETS[0], "Travel [in]", BRACKETS[2]), factors=(1, 1 / 25.4, 1), style=".9g"),
    "millinewtons": table(names=(*BRACKETS[:2], "Force [mN]"), factors=(1, 1, 1e3)),
    "kilonewtons": table(names=(*BRACKETS[:2], "Force_kN"), factors=(1, 1, 1e-3)),
    "gram-force": table(names=(*BRACKETS[:2], "Load [g]"), factors=(1, 1, 1e3 / 9.80665), style=".9g"),
    "kilogram-force": table(names=(*BRACKETS[:2], "Load (kgf)"), factors=(1, 1, 1 / 9.80665), style=".9g"),
    "pound-force": table(names=(*BRACKETS[:2], "Load (lbf)"), factors=(1, 1, 1 / 4.4482216152605), style=".9g"),
    "further columns": table(names=(*BRACKETS, "Temperature [C]", "Bridge [V]"), more=("21.5", "0.12")),
    "comments": "# made up\n# twice\n\n" + table(),
    "header in a comment": "# " + table(),
    "rows that end with a delimiter": table(by=";", behind=";"),
    "header that ends with a delimiter": table(by=";", names=(*BRACKETS, ""), behind=";"),
    "blank lines": table().replace("\n", "\n\n"),
    "rows of delimiters": table() + ",,\n,,\n",
    "comment at the end": table() + "# end of test\n",
    "exponents": table(style=".5e"),
    "exponents and decimal comma": table(style=".5E", by="\t", decimal=","),
    "quoted": table(quote='"'),
    "time of day": table(t=T + 1.7e9, style=".15g"),
    "capitals": table(names=("T_S", "INDENTATION_MM", "FORCE_N")),
    "names with spaces": table(names=("Elapsed Time s", "Indentation Depth mm", "Normal Force N"), by=";"),
    "speed": table(names=(*BRACKETS, "Speed [mm/min]"), more=("300",)),
    "phases": noted(
        lambda lines: [
            f"{line},{'phase' if k == 0 else 'Loading' if k < 52 else 'Unloading'}" for k, line in enumerate(lines)
        ]
    ),
    "an exact name beside others": table(names=(*BRACKETS[:2], "force_N", "Load [N]"), more=("0",)),
}  # fmt: skip


@pytest.mark.parametrize("dialect", RIGHT)
def test_a_dialect_is_read_rightly(dialect: str, tmp_path: Path) -> None:
    (trial,) = read_trials(written(tmp_path, RIGHT[dialect]), region="forearm", setup=SETUP).trials
    np.testing.assert_allclose(trial.time_s, T, atol=1e-6)
    np.testing.assert_allclose(1000 * trial.indentation_m, DEPTH, atol=1e-6)
    np.testing.assert_allclose(trial.force_n, FORCE, atol=1e-5)
    np.testing.assert_array_equal(trial.phase, np.where(np.arange(101) > 50, 2, 0))
    assert trial.condition.speed_m_s == pytest.approx(0.005)
    assert (trial.trial_id, trial.site) == ("press", "forearm")


def changed(row: int, change: Callable[[str], str]) -> str:
    return noted(lambda lines: [change(line) if k == row else line for k, line in enumerate(lines)])


REFUSED: dict[str, tuple[File, str]] = {
    "decimal comma between commas": (table(decimal=","), r"line 3: 5 fields .* separate the columns by semicolons"),
    "thousands": (
        table(names=(BRACKETS[0], "Depth [um]", BRACKETS[2]), factors=(1, 1e3, 1), by=";", style=",.1f"),
        r"line \d+, column Depth \[um\]: '-1,000.0' has a comma, and .* one mark",
    ),
    "thousands without decimals": (
        table(names=("t [ms]", "Depth [um]", "F [mN]"), factors=(1e3, 1e3, 1e3), by=";", style=",.0f"),
        r"may have a mark between thousands; write numbers without it",
    ),
    "two decimal marks": (
        noted(lambda lines: [line.replace(".", ",", 1) if k else line for k, line in enumerate(lines)], by=";"),
        r"has a comma, and .* one mark",
    ),
    "volts": (table(names=(*BRACKETS[:2], "Force [V]")), r"Force \[V\]: V is what the amplifier gives; multiply"),
    "volts in the row of units": (table(names=PLAIN, units=("s", "mm", "mV")), r"column Load: mV is what the ampl"),
    "counts": (table(names=(*BRACKETS[:2], "Load (counts)")), r"counts is what the amplifier gives; multiply"),
    "no unit": (table(names=(*BRACKETS[:2], "force")), r"column force: it has no unit; name the column force_N"),
    "no units": (table(names=PLAIN), r"column Time: it has no unit; name the column t_s"),
    "another unit": (table(names=(*BRACKETS[:2], "Force [bar]")), r"bar is not a unit of force; valid: n, newt"),
    "a length in newtons": (table(names=(BRACKETS[0], "Depth [N]", BRACKETS[2])), r"N is not a unit of length; valid"),
    "two units": (
        table(names=BRACKETS, units=("s", "mm", "mN")), r"the header says N and the row of units mN",
    ),
    "a wrong name": (table(names=("t_s", "indentation_mm", "forse_N")), r"column force_N \(is it 'forse_N'\?\); name"),
    "a wrong name of three": (table(names=("t_s", "indentatoin_mm", "force_N")), r"\(is it 'indentatoin_mm'\?\)"),
    "a wrong optional name": (
        table(names=(*BRACKETS, "allong_mm"), more=("20",)), r"no column is named 'allong_mm'; is it along_mm\? Rename",
    ),
    "no header": (noted(lambda lines: lines[1:]), r"no column t_s, indentation_mm, force_N; name them"),
    "no time": (table(names=("point_no", "depth_mm", "force_N")), r"no column t_s"),
    "two forces": (
        table(names=(*BRACKETS, "Load [N]"), more=("0",)), r"'Force \[N\]' and 'Load \[N\]' may both be force_N; name",
    ),
    "tension positive": (table(force=-FORCE), r"column force_N: it falls while .* must be positive"),
    "outward positive": (table(depth=-DEPTH), r"column indentation_mm: it falls while .* inward must be positive"),
    "both signs wrong": (table(force=-FORCE, depth=-DEPTH), r"must be positive"),
    "two presses": (
        table(t=np.r_[T, T + 2.1], depth=np.r_[DEPTH, DEPTH], force=np.r_[FORCE, FORCE]),
        r"line \d+, column indentation_mm: the path goes in more than once; give each press a trial_id",
    ),
    "metres called millimetres": (table(factors=(1, 1e-3, 1)), r"looks like metres: multiply"),
    "micrometres called millimetres": (table(factors=(1, 1e3, 1)), r"looks like micrometres: divide"),
    "milliseconds called seconds": (table(factors=(1e3, 1, 1)), r"check the units of t_s"),
    "kilonewtons called newtons": (table(factors=(1, 1, 1e-3)), r"is it in newtons"),
    "millinewtons called newtons": (table(factors=(1, 1, 1e3)), r"is it in newtons"),
    "clock": (changed(7, lambda line: "00:00:01" + line[line.index(","):]), r"line 8, column t_s: '00:00:01' is not a"),
    "overload": (changed(40, lambda line: line.rpartition(",")[0] + ",OL"), r"line 41, column force_N: 'OL' is not a"),
    "a gap": (changed(40, lambda line: line.rpartition(",")[0] + ","), r"line 41, column force_N: an empty field"),
    "not a number": (changed(40, lambda line: line.rpartition(",")[0] + ",NaN"), r"line 41, column force_N: 'NaN'"),
    "a footer": (table() + "End of test\n", r"line 103: 1 fields where line 1 names 3 columns"),
    "a second header": (table() + table(), r"line 103, column t_s: 't_s' is not a finite number"),
    "time that stands": (noted(lambda lines: [*lines[:9], lines[8], *lines[9:]]), r"line 10, column t_s: .*increase"),
    "too few rows": (noted(lambda lines: lines[:9]), r"it has 8 rows; a press needs at least 12"),
    "a workbook": (b"PK\x03\x04\0\0", r"not a text file; save the trials as CSV"),
    "nothing": ("", r"is empty or has no table; one line names the columns"),
    "names alone": (noted(lambda lines: lines[:1]), r"has column names but no rows"),
    "speed of another press": (table(names=(*BRACKETS, "speed_mm_s"), more=("50",)), r"column speed_mm_s says 50"),
    "an unknown indenter": (
        table(names=(*BRACKETS, "indenter_shape", "indenter_size_mm"), more=("cone", "5")), r"'cone'; valid: flat",
    ),
}  # fmt: skip


@pytest.mark.parametrize("dialect", REFUSED)
def test_a_file_that_may_be_misread_is_refused_in_one_line(dialect: str, tmp_path: Path) -> None:
    content, message = REFUSED[dialect]
    setup = SETUP if "indenter" not in dialect else None
    with pytest.raises(ConfigError, match=message) as found:
        read_trials(written(tmp_path, content), region="forearm", setup=setup)
    assert "\n" not in str(found.value)


def test_there_are_sixty_files() -> None:
    assert len(RIGHT) + len(REFUSED) >= 60


def written(folder: Path, content: File, name: str = "press.csv") -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def test_a_file_for_each_press(tmp_path: Path) -> None:
    """Each file's name is its trial's id, and the setup may state a place for one file."""
    paths = [written(tmp_path, table(), f"press{k}.csv") for k in (2, 1)]
    setup = Setup.checked({**SETUP.model_dump(exclude_none=True), "files": {"press2.csv": {"along_mm": 20}}}, place="x")
    file = read_trials(paths, region="forearm", setup=setup)
    assert [(trial.trial_id, trial.condition.along_m) for trial in file.trials] == [("press1", 0.0), ("press2", 0.02)]
    assert file.sha256 == read_trials(paths[::-1], region="forearm", setup=setup).sha256
    assert file.sha256 != read_trials(paths[0], region="forearm", setup=SETUP).sha256
    assert any("derived from the path" in note for note in file.notes)


def test_one_id_in_two_files_is_refused(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    paths = [written(folder, table()) for folder in (tmp_path, tmp_path / "other")]
    with pytest.raises(ConfigError, match="'press' appeared already"):
        read_trials(paths, region="forearm", setup=SETUP)


def test_a_hold_is_found_in_the_path(tmp_path: Path) -> None:
    held = np.r_[FORCE[:51], np.linspace(FORCE[50], 0.9 * FORCE[50], 40), FORCE[51:]]
    path = written(tmp_path, table(t=0.02 * np.arange(141), depth=HOLD, force=held))
    (trial,) = read_trials(path, region="forearm", setup=SETUP).trials
    assert (trial.phase[:49] == 0).all()
    assert (trial.phase[53:88] == 1).all()
    assert (trial.phase[93:] == 2).all()


def test_speeds_found_in_paths_are_nominal(tmp_path: Path) -> None:
    """Presses of nearly one speed share a condition, and so a replay."""
    paths = [
        written(tmp_path, table(t=T / factor, style=".8g"), f"p{k}.csv") for k, factor in enumerate((1.0, 1.03, 2.0))
    ]
    trials = read_trials(paths, region="forearm", setup=SETUP).trials
    assert [round(1000 * trial.condition.speed_m_s, 6) for trial in trials] == [5.1, 5.1, 10.0]


@pytest.mark.parametrize(
    ("content", "setup", "message"),
    [
        (table(), None, r"no column indenter_shape; add it, or give --indenter flat:10.7"),
        (table(), Setup(indenter_shape="flat"), r"no column indenter_size_mm"),
        (
            table(names=(*BRACKETS, "along_mm"), more=("3",)),
            SETUP.model_copy(update={"along_mm": 4.0}),
            r"column along_mm, and the setup or an option states it",
        ),
    ],
)
def test_what_a_press_needs_is_stated_once(content: str, setup: Setup | None, message: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=message):
        read_trials(written(tmp_path, content), region="forearm", setup=setup)


def test_the_template_is_read_as_it_is(tmp_path: Path) -> None:
    (trial,) = read_trials(written(tmp_path, template()), region="forearm").trials
    assert trial.unloads
    assert "synthetic" in trial.site
    assert trial.condition.indenter_size_m == pytest.approx(0.0107)
