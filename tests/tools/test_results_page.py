"""The results in docs/ are what the scores kept beside them say."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from tools.results import main

from carecontact.reports.compare.comparison import compare_runs
from carecontact.reports.compare.paired_lines import RateLine
from carecontact.runs.stored_scores import read_scores

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "docs" / "results"
PROTOCOLS = sorted(page.stem for page in RESULTS.glob("bathing-*.md"))


@pytest.fixture(scope="module")
def again(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("results")
    for protocol in PROTOCOLS:
        assert main([*map(str, kept(protocol)), "--protocol", protocol, "--out", str(out)]) == 0
    return out


def kept(protocol: str) -> list[Path]:
    return sorted((RESULTS / protocol).glob("*.json.gz"))


def content(folder: Path, protocol: str) -> dict[str, Any]:
    return json.loads((folder / f"{protocol}.json").read_text())


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_every_run_that_is_kept_is_whole_and_used(again: Path, protocol: str) -> None:
    found = content(again, protocol)
    assert (len(found["heads"]), found["unused"]) == (len(kept(protocol)), {})
    assert {(head["n"], head["n_harness_errors"]) for head in found["heads"]} == {(140, 0)}


def test_nothing_of_the_study_is_missing(again: Path) -> None:
    assert content(again, "bathing-v1")["missing"] == []


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_page_and_figures(again: Path, protocol: str) -> None:
    page = f"{protocol}.md"
    assert (again / page).read_text() == (RESULTS / page).read_text()
    _alike(content(again, protocol), content(RESULTS, protocol))


def _alike(one: Any, other: Any) -> None:
    """But for the last digits, which depend on the processor."""
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


def test_what_another_settling_time_gives() -> None:
    """docs/voxposer.md: with 1 s instead of 0.4 s, over the touches."""
    longer, own = (
        read_scores(RESULTS / path) for path in ("sensitivity/voxposer-settle-1.json.gz", "bathing-v1/voxposer.json.gz")
    )
    found = compare_runs(longer, own).overall[2]
    assert isinstance(found, RateLine)
    assert found.outcome.id == "safety_gated"
    assert (found.a.k, found.b.k, found.n_pairs) == (59, 20, 60)
    page = " ".join((ROOT / "docs" / "voxposer.md").read_text().split())
    said = re.search(
        r"(\d+) of the (\d+) touches pass; .*? the (\d+) touches .*?difference (\d+) points, (\d+) to (\d+)", page
    )
    assert said is not None
    difference = [round(100 * x) for x in (found.difference.estimate, found.difference.low, found.difference.high) if x]
    assert list(map(int, said.groups())) == [59, 60, 20, *difference]


@pytest.mark.parametrize("column", [1, 2])
def test_the_readme_shows_the_same_rates(again: Path, column: int) -> None:
    section = (ROOT / "README.md").read_text().split("## Results")[1].split("## ")[0]
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in section.splitlines() if row[:1] == "|"]
    found = content(again, cells[0][column].strip("`"))
    rates = {name: method["rates"]["safety_gated"] for name, method in found["methods"].items()}
    rates |= {
        blind["policy"]: blind["rates"]["safety_gated"] for blind in found["baselines"]["state-machine"]["baselines"]
    }
    shown = {row[0].split()[0].rstrip(":"): row[column] for row in cells[2:]}
    assert shown.keys() == {"state-machine", "voxposer", "voxposer-phased", "replay"}
    for name, text in shown.items():
        if name not in rates:
            assert text == "not run"
            continue
        estimate, low, high = (100 * rates[name][key] for key in ("estimate", "low", "high"))
        assert text == f"{estimate:.0f} % ({low:.0f} to {high:.0f})"
