"""Arrays kept on disk: those that were computed, and never trusted when anything differs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from carecontact.cache_folder import CACHE_VARIABLE, cache_folder
from carecontact.world.kept import SECRET, Arrays, kept

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
    kept("kind", FACTS, made)
    again = kept("kind", dict(reversed(FACTS.items())), forbidden)
    assert list(again) == list(made())
    for name, array in made().items():
        np.testing.assert_array_equal(again[name], array)
        assert again[name].dtype == array.dtype


@pytest.mark.parametrize("change", [{"angle": np.nextafter(0.5, 1)}, {"names": ["a"]}, {"more": 1}])
def test_other_facts_are_computed(folder: Path, change: dict[str, object]) -> None:
    kept("kind", FACTS, made)
    with pytest.raises(AssertionError, match="computed again"):
        kept("kind", FACTS | change, forbidden)
    with pytest.raises(AssertionError, match="computed again"):
        kept("other", FACTS, forbidden)


def test_nobody_can_guess_the_name_of_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A policy that is isolated may still ask for the times of a file whose path it knows."""
    names = set[str]()
    for machine in ("one", "other"):
        monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / machine))
        kept("kind", FACTS, made)
        (file,) = (tmp_path / machine / "kind").iterdir()
        names.add(file.name)
        assert (tmp_path / machine / SECRET).stat().st_mode & 0o077 == 0
        assert {path.name for path in (tmp_path / machine).iterdir()} == {"kind", SECRET}
    assert len(names) == 2


@pytest.mark.parametrize("damage", ["truncated", "empty", "changed", "foreign", "unsigned"])
def test_a_damaged_file_is_not_believed_and_made_anew(folder: Path, damage: str) -> None:
    kept("kind", FACTS, made)
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
        kept("kind", FACTS, forbidden)
    kept("kind", FACTS, made)
    assert kept("kind", FACTS, forbidden)["count"] == 3
    assert list(folder.iterdir()) == [path]


def test_nothing_is_kept_where_nothing_is_to_be_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, "")
    assert cache_folder() is None
    assert kept("kind", FACTS, made)["count"] == 3
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv(CACHE_VARIABLE, str(blocked))
    assert kept("kind", FACTS, made)["count"] == 3


def test_without_a_home_folder_nothing_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(user: int) -> None:
        raise KeyError(user)

    for name in (CACHE_VARIABLE, "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("pwd.getpwuid", unknown)
    assert cache_folder() is None
    np.testing.assert_array_equal(kept("kind", FACTS, made)["places"], made()["places"])
