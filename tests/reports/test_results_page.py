"""The results in docs/ are what the scores kept beside them say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from tools.results import main

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "docs" / "results"
KEPT = sorted((RESULTS / "bathing-v1").glob("*.json.gz"))


@pytest.fixture(scope="module")
def again(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("results")
    assert main([*map(str, KEPT), "--out", str(out)]) == 0
    return out


def test_every_run_that_is_kept_is_used(again: Path) -> None:
    content = json.loads((again / "bathing-v1.json").read_text())
    assert (len(content["heads"]), content["unused"]) == (len(KEPT), {})
    assert {head["n_harness_errors"] for head in content["heads"]} == {0}


def test_page_and_figures(again: Path) -> None:
    assert (again / "bathing-v1.md").read_text() == (RESULTS / "bathing-v1.md").read_text()
    _alike(*(json.loads((folder / "bathing-v1.json").read_text()) for folder in (again, RESULTS)))


def _alike(one: Any, other: Any) -> None:
    """But for the last digits, which hang on the processor."""
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for key, value in one.items():
            _alike(value, other[key])
    elif isinstance(one, list):
        assert len(one) == len(other)
        for pair in zip(one, other, strict=True):
            _alike(*pair)
    else:
        assert one == (pytest.approx(other, rel=1e-9, abs=1e-12) if isinstance(one, float) else other)


def test_the_readme_shows_the_same_rates(again: Path) -> None:
    content = json.loads((again / "bathing-v1.json").read_text())
    rates = {name: method["rates"]["safety_gated"] for name, method in content["methods"].items()}
    rates |= {arm["policy"]: arm["rates"]["safety_gated"] for arm in content["floors"]["state-machine"]["nulls"]}
    section = (ROOT / "README.md").read_text().split("## Results")[1].split("## ")[0]
    rows = {row.split()[1].rstrip(":"): row for row in section.splitlines() if row.startswith("| ") and "%" in row}
    assert {"state-machine", "voxposer", "voxposer-phased", "replay"} <= rows.keys()
    for name, row in rows.items():
        estimate, low, high = (100 * rates[name][key] for key in ("estimate", "low", "high"))
        assert f"| {estimate:.0f} % ({low:.0f} to {high:.0f}) |" in row
