"""What a trials file may hold, and what is said where it may not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from carecontact.calibration.checks import MAX_SAMPLES, read_trials
from carecontact.errors import ConfigError
from tests.calibration.conftest import HEADER, rows, save

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
    ("edit", "told"),
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
def test_faults_name_the_place(edit: Edit, told: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=told):
        read_trials(save(tmp_path / "t.csv", edit(rows())), region="forearm")


def test_missing_columns_are_all_named(tmp_path: Path) -> None:
    path = save(tmp_path / "t.csv", ["a,1,2"], header="trial_id,when,N")
    with pytest.raises(ConfigError, match=r"no column t_s, indentation_mm, force_N; name them so"):
        read_trials(path, region="forearm")


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (b"", "is empty"),
        (b"\n\n", "is empty"),
        (b"PK\x03\x04\0\0", "not a text file"),
        (b"t_s,indentation_mm,force_N\n\x81", "line 2: not UTF-8"),
    ],
)
def test_files_that_are_no_table(data: bytes, told: str, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_bytes(data)
    with pytest.raises(ConfigError, match=told):
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


def test_other_sites_are_left_out_and_told(tmp_path: Path) -> None:
    file = read_trials(save(tmp_path / "t.csv", rows("a") + rows("b", site="Upper arm anterior")), region="upper_arm")
    assert [trial.trial_id for trial in file.trials] == ["b"]
    assert file.notes == ("60 rows of other sites left out",)


def test_long_trials_are_averaged_and_told(tmp_path: Path) -> None:
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
