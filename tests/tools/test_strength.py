"""The tools that measure the suite: a fault that is planted is seen or not, and sizes are counted."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from tools import size, strength

CODE = """\
def half(n):
    \"\"\"Whole halves.\"\"\"
    if n < 0:
        raise ValueError(
            "negative")

    return n // 2
"""
TEST = """\
from carecontact.code import half
def test_half():
    assert half(5) == 2
"""


FAULTS = tomllib.loads((strength.ROOT / "tests" / "strength.toml").read_text())["fault"]


def test_every_recorded_fault_can_still_be_planted() -> None:
    """A change that moves or rewrites such a place brings its entry along."""
    stale = {
        fault["id"]: found for fault in FAULTS if isinstance(found := strength.find(strength.ROOT, fault["code"]), str)
    }
    assert stale == {}
    assert [fault["id"] for fault in FAULTS if not (strength.ROOT / fault["tests"]).exists()] == []


@pytest.mark.slow
def test_faults_are_planted_one_after_another_and_taken_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, text in (("src/carecontact/__init__.py", ""), ("src/carecontact/code.py", CODE)):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    for name in ("runs/test_code.py", "runs/test_other.py"):
        (tmp_path / "tests" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "tests" / name).write_text(TEST if "code" in name else "def test_nothing(): pass\n")
    monkeypatch.setattr(strength, "ROOT", tmp_path)
    monkeypatch.setattr(strength, "LEAST_S", 1)
    whole, other = "tests/runs/test_code.py", "tests/runs/test_other.py"
    faults = [
        ("killed", "return n // 2", "return n / 2", whole),
        ("hung", "return n // 2", "while True:\n    pass", whole),
        ("killed", "return n // 2", "return None", other),
        ("killed", "return n // 2", "return None", "tests/runs/test_gone.py"),
        ("survived", 'if n < 0:\nraise ValueError(\n"negative")', "if n < -1:\n    raise ValueError", whole),
        ("stale", "return n // 3", "return n", whole),
        ("stale", "return n // 2", "return n", "tests/gone/test_gone.py"),
    ]
    entries = [
        {"id": str(number), "code": code, "broken": bad, "tests": tests}
        for number, (_, code, bad, tests) in enumerate(faults)
    ]
    found = strength.measure(entries, jobs=2, quick=False)
    assert [found[entry["id"]].state for entry in entries] == [state for state, *_ in faults]
    assert found["0"].by == "tests/runs/test_code.py::test_half"


def test_mutants_change_one_thing_each() -> None:
    found = {CODE[:first] + new + CODE[last:] for _, first, last, new in strength.candidates(CODE)}
    changes = [("n < 0", "n <= 0"), ("< 0", "< 1"), ("n // 2", "n * 2"), ("n // 2", "n // 3"), ("n // 2", "None")]
    dropped = CODE.replace('raise ValueError(\n            "negative")', "pass")
    assert found == {CODE.replace(*change) for change in changes} | {dropped}


def test_size_counts_statements_and_not_line_breaks(tmp_path: Path) -> None:
    (tmp_path / "code.py").write_text(CODE)
    assert size.size(tmp_path) == (1, 7, 5)
