from __future__ import annotations

import errno
import hashlib
import os
import subprocess
import sys
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure

from carecontact.cache import SECRET, Arrays, cached
from carecontact.errors import ConfigError, ExhaustedError
from carecontact.plotting import plain_figures
from carecontact.system import CACHE_VARIABLE, cache_folder, is_exhausted


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable"), True),
        (OSError(errno.ENOMEM, "Cannot allocate memory"), True),
        (RuntimeError("can't start new thread"), True),
        (MemoryError(), True),
        (ExhaustedError("no process"), True),
        (RuntimeError("dictionary changed size"), False),
        (FileNotFoundError(errno.ENOENT, "No such file"), False),
        (ConfigError("wrong"), False),
    ],
)
def test_what_says_that_something_is_used_up(error: Exception, expected: bool) -> None:
    assert is_exhausted(error) == expected
    later = ValueError("of that")
    later.__context__ = error
    assert is_exhausted(later) == expected


# Arrays kept on disk: those that were computed, and never trusted when anything differs.

FACTS = {"angle": 0.5, "names": ["a", "b"]}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    return tmp_path / "kind"


def made() -> Arrays:
    return {"places": np.linspace(0, 1, 7).reshape(7, 1), "count": np.array(3), "fine": np.array([True, False])}


def forbidden() -> Arrays:
    raise AssertionError("computed again")


def test_what_was_computed_is_loaded(folder: Path) -> None:
    cached("kind", FACTS, made)
    again = cached("kind", dict(reversed(FACTS.items())), forbidden)
    assert list(again) == list(made())
    for name, array in made().items():
        np.testing.assert_array_equal(again[name], array)
        assert again[name].dtype == array.dtype


@pytest.mark.parametrize("change", [{"angle": np.nextafter(0.5, 1)}, {"names": ["a"]}, {"more": 1}])
def test_other_facts_are_computed(folder: Path, change: dict[str, object]) -> None:
    cached("kind", FACTS, made)
    with pytest.raises(AssertionError, match="computed again"):
        cached("kind", FACTS | change, forbidden)
    with pytest.raises(AssertionError, match="computed again"):
        cached("other", FACTS, forbidden)


def test_no_one_can_guess_the_name_of_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A policy that is isolated may still ask for the times of a file whose path it knows."""
    names = set[str]()
    for machine in ("one", "other"):
        monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / machine))
        cached("kind", FACTS, made)
        (file,) = (tmp_path / machine / "kind").iterdir()
        names.add(file.name)
        assert (tmp_path / machine / SECRET).stat().st_mode & 0o077 == 0
        assert {path.name for path in (tmp_path / machine).iterdir()} == {"kind", SECRET}
    assert len(names) == 2


@pytest.mark.parametrize("damage", ["truncated", "empty", "changed", "foreign", "unsigned"])
def test_a_damaged_file_is_not_believed_and_made_again(folder: Path, damage: str) -> None:
    cached("kind", FACTS, made)
    (path,) = folder.iterdir()
    with np.load(path) as z:
        arrays = dict(z)
    match damage:
        case "changed":
            np.savez(path, allow_pickle=False, **{**arrays, "count": np.array(4)})
        case "unsigned":
            np.savez(path, allow_pickle=False, **made())
        case _:
            path.write_bytes({"truncated": path.read_bytes()[:500], "empty": b"", "foreign": b"not an archive"}[damage])
    with pytest.raises(AssertionError, match="computed again"):
        cached("kind", FACTS, forbidden)
    cached("kind", FACTS, made)
    assert cached("kind", FACTS, forbidden)["count"] == 3
    assert list(folder.iterdir()) == [path]


def test_nothing_is_kept_where_nothing_is_to_be_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, "")
    assert cache_folder() is None
    assert cached("kind", FACTS, made)["count"] == 3
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv(CACHE_VARIABLE, str(blocked))
    assert cached("kind", FACTS, made)["count"] == 3


def test_without_a_home_folder_nothing_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(user: int) -> None:
        raise KeyError(user)

    for name in (CACHE_VARIABLE, "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("pwd.getpwuid", unknown)
    assert cache_folder() is None
    np.testing.assert_array_equal(cached("kind", FACTS, made)["places"], made()["places"])


# Settings for other programs change no figure.

DRAWN = """
import hashlib, io
from carecontact.plotting import plain_figures
with plain_figures({"lines.linewidth": 3.0}):
    from matplotlib.figure import Figure
    figure, file = Figure(figsize=(2, 1)), io.BytesIO()
    figure.subplots().set_title("a $b$")
    figure.savefig(file, format="png")
print(hashlib.sha256(file.getvalue()).hexdigest())
"""


def drawn(folder: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    given = {name: value for name, value in os.environ.items() if not name.startswith("MPL")}
    return subprocess.run(
        [sys.executable, "-c", DRAWN], cwd=folder, env=given | variables, capture_output=True, text=True, check=False
    )


def test_neither_a_backend_nor_a_matplotlibrc_of_the_folder_changes_a_picture(tmp_path: Path) -> None:
    plain = drawn(tmp_path)
    (tmp_path / "matplotlibrc").write_text("text.usetex: True\nfigure.dpi: 10\nbackend: module://nonsense\n")
    for backend in ("module://nonsense", "TkAgg"):
        assert drawn(tmp_path, MPLBACKEND=backend).stdout == plain.stdout
    assert len(plain.stdout.strip()) == hashlib.sha256().digest_size * 2


def test_a_matplotlibrc_that_is_no_text_is_named(tmp_path: Path) -> None:
    (tmp_path / "matplotlibrc").write_bytes(b"\xff")
    error = drawn(tmp_path).stderr.splitlines()[-1]
    assert error.startswith(
        "carecontact.errors.ConfigError: matplotlib cannot read a matplotlibrc file (in the current"
    )


def test_the_settings_of_this_process_come_back() -> None:
    with matplotlib.rc_context({"text.usetex": True}):

        @plain_figures({"font.size": 3.0})
        def draw() -> tuple[bool, float]:
            return Figure().text(0, 0, "a").get_usetex(), matplotlib.rcParams["font.size"]

        assert draw() == (False, 3.0)
        assert matplotlib.rcParams["text.usetex"]
