from __future__ import annotations

import sys
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from carecontact import registry
from carecontact.errors import ConfigError, UnknownNameError
from carecontact.registry import Registry


@dataclass
class Point:
    name: str
    row: Any
    loads: int = 0
    dist: Any = None

    def load(self) -> Any:
        self.loads += 1
        return self.row


@pytest.fixture
def points(monkeypatch: pytest.MonkeyPatch) -> dict[str, list[Point]]:
    """Entry points of installed packages by group."""
    groups: dict[str, list[Point]] = {}
    monkeypatch.setattr(registry, "entry_points", lambda *, group: groups.get(group, []))
    return groups


@pytest.mark.usefixtures("points")
def test_rows_are_found_sorted_and_counted() -> None:
    rows: Registry[int] = Registry("thing")
    assert rows.register("b", 2) == 2
    rows.register("a", 1)
    assert list(rows) == ["a", "b"]
    assert (len(rows), rows["a"], "b" in rows, "c" in rows) == (2, 1, True, False)


@pytest.mark.usefixtures("points")
def test_unknown_name_lists_what_there_is() -> None:
    rows: Registry[int] = Registry("thing")
    rows.register("a", 1)
    with pytest.raises(UnknownNameError, match="no thing named 'x'; valid: a"):
        rows["x"]


@pytest.mark.usefixtures("points")
def test_a_name_is_given_once() -> None:
    rows: Registry[int] = Registry("thing")
    rows.register("a", 1)
    with pytest.raises(ConfigError, match="thing 'a' is registered twice"):
        rows.register("a", 2)
    assert rows["a"] == 1


@pytest.mark.usefixtures("points")
def test_decorator_registers_and_returns_the_function() -> None:
    rows: Registry[Any] = Registry("thing")

    @rows.decorator("double")
    def double(x: int) -> int:
        return 2 * x

    assert rows["double"] is double
    assert double(4) == 8


def test_rows_of_other_packages_come_through_entry_points(points: dict[str, list[Point]]) -> None:
    points["carecontact.things"] = [Point("theirs", 7)]
    points["carecontact.bodies"] = [Point("giant", 8)]
    assert Registry("thing")["theirs"] == 7
    assert list(Registry("thing")) == ["theirs"]
    assert "giant" in Registry("body", plural="bodies")


def test_a_shipped_row_is_neither_replaced_nor_slowed_by_another_package(points: dict[str, list[Point]]) -> None:
    theirs = Point("ours", 99)
    points["carecontact.things"] = [theirs]
    rows: Registry[int] = Registry("thing")
    rows.register("ours", 1)
    assert rows["ours"] == 1
    assert theirs.loads == 0, "looking up a shipped name imported another package"
    assert list(rows) == ["ours"]
    assert rows["ours"] == 1


def test_other_packages_are_loaded_once(points: dict[str, list[Point]]) -> None:
    theirs = Point("theirs", 7)
    points["carecontact.things"] = [theirs]
    rows: Registry[int] = Registry("thing")
    assert [*rows, *rows, len(rows), rows["theirs"]] == ["theirs", "theirs", 1, 7]
    assert theirs.loads == 1


@pytest.mark.usefixtures("points")
def test_the_modules_of_a_package_register_their_rows_at_the_first_look(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "scanned_rows"
    package.mkdir()
    (package / "__init__.py").write_text(
        "from carecontact.registry import Registry\nROWS = Registry('thing', scan='scanned_rows')\n"
    )
    for name in ("a", "b"):
        (package / f"{name}.py").write_text(
            f"from scanned_rows import ROWS\nROWS.register({name!r}, {name!r} in ROWS)\n"
        )
    monkeypatch.syspath_prepend(str(tmp_path))
    rows = import_module("scanned_rows").ROWS
    assert "scanned_rows.a" not in sys.modules
    assert rows["a"] is False  # a look-up from inside the scan starts no second one
    assert list(rows) == ["a", "b"]
