from __future__ import annotations

from pathlib import Path

import pytest

from carecontact.cli.policy_names import classes, meant


@pytest.mark.parametrize(
    ("typed", "told"),
    [
        ("mine", " (did you mean mine:Own?)"),
        ("mine.py", " (did you mean mine:Own?)"),
        ("mine:own", " (did you mean mine:Own?)"),
        ("mien:Own", " (did you mean mine:Own?)"),
        ("mine:Own", ""),
        ("mine.Own", " (did you mean mine:Own?)"),
        ("mien.own", " (did you mean mine:Own?)"),
        ("./mine.py:Own", " (did you mean mine:Own?)"),
        ("inner/deep.py", " (did you mean inner.deep:Deep?)"),
        ("inner.deep.Deep", " (did you mean inner.deep:Deep?)"),
        ("inner.deep:Dep", " (did you mean inner.deep:Deep?)"),
        ("inner.deep:Deep", ""),
        ("gone.deep:Deep", ""),
        ("", ""),
        (":", ""),
        ("..", ""),
        ("plain", " (did you mean plain:A or plain:B?)"),
        ("broken", ""),
        ("state-machine", ""),
    ],
)
def test_what_was_meant_comes_from_the_files_without_importing_them(tmp_path: Path, typed: str, told: str) -> None:
    (tmp_path / "mine.py").write_text("raise SystemExit\nclass Helper: ...\nclass Own:\n    def act(self, o): ...\n")
    (tmp_path / "plain.py").write_text("class A: ...\nclass B: ...\n")
    (tmp_path / "inner").mkdir()
    (tmp_path / "inner" / "deep.py").write_text("class Deep: ...\n")
    (tmp_path / "broken.py").write_text("class :\n")
    assert meant(typed, tmp_path) == told


def test_a_file_of_another_folder_is_named_with_it(tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    (tmp_path / "mine.py").write_text("class Own:\n    def act(self, o): ...\n")
    told = f" (did you mean mine:Own, given in the folder {tmp_path.resolve()}?)"
    for typed in ("../mine.py", "../mine.py:Own", str(tmp_path / "mine.py")):
        assert meant(typed, tmp_path / "here") == told
    assert meant(str(tmp_path / "mine.py"), tmp_path) == " (did you mean mine:Own?)"
    assert meant("../none.py", tmp_path / "here") == ""


def test_a_file_that_is_not_there_has_no_classes(tmp_path: Path) -> None:
    assert classes(tmp_path / "gone.py") == []
