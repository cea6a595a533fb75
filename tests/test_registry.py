from __future__ import annotations

import sys
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
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
    fault: Exception | None = None

    @property
    def value(self) -> str:
        return f"{self.name}_{self.row}:ROW"

    def load(self) -> Any:
        self.loads += 1
        if self.fault is not None:
            raise self.fault
        return self.row


def package(name: str) -> Any:
    return SimpleNamespace(name=name, version="0.3")


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


def test_rows_of_other_packages_come_through_entry_points(points: dict[str, list[Point]]) -> None:
    points["carecontact.things"] = [Point("theirs", 7)]
    points["carecontact.bodies"] = [Point("giant", 8)]
    assert Registry("thing")["theirs"] == 7
    assert list(Registry("thing")) == ["theirs"]
    assert "giant" in Registry("body", plural="bodies")


def test_looking_up_a_shipped_row_loads_no_other_package(points: dict[str, list[Point]]) -> None:
    theirs = Point("theirs", 99)
    points["carecontact.things"] = [theirs]
    rows: Registry[int] = Registry("thing")
    rows.register("ours", 1)
    assert rows["ours"] == 1
    assert (list(rows), "theirs" in rows, len(rows)) == (["ours", "theirs"], True, 2)
    assert rows.package("theirs") is None
    assert theirs.loads == 0


@pytest.mark.parametrize("fault", [SyntaxError("bad"), ImportError("no\nmodule"), TypeError("no neighbourhood")])
def test_a_row_that_cannot_be_loaded_is_named_and_harms_no_other(
    points: dict[str, list[Point]], fault: Exception
) -> None:
    broken = Point("theirs", 7, dist=package("their-things"), fault=fault)
    points["carecontact.things"] = [broken]
    rows: Registry[int] = Registry("thing")
    rows.register("ours", 1)
    assert (rows["ours"], rows.usable()) == (1, {"ours": 1})
    why = f"{type(fault).__name__}: {' '.join(str(fault).split())}"
    for _ in range(2):
        with pytest.raises(ConfigError) as caught:
            rows["theirs"]
        assert str(caught.value) == (
            f"thing 'theirs' of package their-things 0.3 (theirs_7:ROW) cannot be loaded: {why}"
        )
    assert broken.loads == 1, "a second import would fail for another reason"


def test_one_name_of_two_packages_is_refused_and_both_are_named(points: dict[str, list[Point]]) -> None:
    points["carecontact.things"] = [
        Point("theirs", 7, dist=package("one")),
        Point("theirs", 8, dist=package("two")),
        Point("other", 9),
    ]
    rows: Registry[int] = Registry("thing")
    with pytest.raises(ConfigError, match=r"'theirs' of package one 0\.3 \(.*\) has the same name as .* package two"):
        rows["theirs"]
    assert rows["other"] == 9


def test_a_name_that_is_registered_already_is_refused_unless_it_is_the_same_row(
    points: dict[str, list[Point]],
) -> None:
    mine: list[int] = []
    points["carecontact.things"] = [Point("ours", [], dist=package("theirs")), Point("mine", mine, dist=package("own"))]
    rows: Registry[list[int]] = Registry("thing")
    rows.register("ours", [])
    rows.register("mine", mine)
    assert rows["mine"] is mine
    with pytest.raises(
        ConfigError, match=r"thing 'ours' of package theirs 0\.3 .* has the name of another thing, which"
    ):
        rows["ours"]


def test_a_row_may_be_registered_by_the_function_that_an_entry_point_names(points: dict[str, list[Point]]) -> None:
    def function() -> None: ...

    points["carecontact.things"] = [Point("theirs", function), Point("misnamed", function)]
    rows: Registry[int] = Registry("thing", row=float)
    rows.register("theirs", 7.0, origin=function)
    assert rows["theirs"] == 7
    with pytest.raises(ConfigError, match=r"'misnamed' .* registers itself as 'theirs'; give its entry point the same"):
        rows["misnamed"]


@pytest.mark.parametrize(("row", "what"), [("7", "a str"), (float, "the class float"), (None, "a NoneType")])
def test_a_row_has_the_class_of_its_registry(points: dict[str, list[Point]], row: Any, what: str) -> None:
    points["carecontact.things"] = [Point("theirs", row)]
    rows: Registry[Any] = Registry("thing", row=float)
    with pytest.raises(ConfigError, match=rf"^thing 'theirs' \(.*\) is {what}; expected a float object$"):
        rows["theirs"]
    with pytest.raises(ConfigError, match=f"^thing 'mine' is {what}; expected a float object$"):
        rows.register("mine", row)


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
