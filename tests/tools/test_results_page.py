"""The results in docs/ are what the scores kept beside them say."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from carecontact.episode.randomization import calibration
from carecontact.errors import ConfigError
from carecontact.protocols import load_protocol, shipped_protocols
from carecontact.reports.compare.blind_floor import role_in
from carecontact.reports.compare.comparison import compare_runs
from carecontact.reports.compare.paired_lines import RateLine
from carecontact.reports.sweep.band_texts import flip_rows, spread_rows
from carecontact.reports.sweep.bands import Bands, bands
from carecontact.reports.sweep.table import CellScores
from carecontact.runs.run_scores import RunScores
from carecontact.runs.stored_scores import read_scores
from tests.reports.synthetic_run import make_score

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "docs" / "results"
PROTOCOLS = sorted(content.stem for content in RESULTS.glob("bathing-*.json"))
"""Those whose page ``tools/results.py`` made."""
EARLIER = [protocol for protocol in PROTOCOLS if protocol not in shipped_protocols()]
"""Those of them that this release cannot run, because its tissue is another one."""


def kept(protocol: str) -> list[Path]:
    return sorted((RESULTS / protocol).glob("*.json.gz"))


def content(protocol: str) -> dict[str, Any]:
    return json.loads((RESULTS / f"{protocol}.json").read_text())


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_every_run_that_is_kept_is_whole_and_used(protocol: str) -> None:
    found = content(protocol)
    assert (len(found["heads"]), found["unused"]) == (len(kept(protocol)), {})
    runs = [read_scores(path) for path in kept(protocol)]
    assert {(len(run.scores), run.scores[0].protocol_id) for run in runs} == {(140, protocol)}
    assert found["protocol_sha256"] in {run.scores[0].protocol_sha256 for run in runs}


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("method", ["state-machine", "voxposer"])
def test_the_rates_of_the_page_are_those_of_the_kept_scores(protocol: str, method: str) -> None:
    scores = read_scores(RESULTS / protocol / f"{method}.json.gz").scores
    rate = content(protocol)["methods"][method]["rates"]["safety_gated"]
    assert rate["estimate"] == pytest.approx(sum(score.safety_gated for score in scores) / 140)


@pytest.mark.parametrize("page", [*(f"{protocol}.md" for protocol in EARLIER), "earlier.md"])
def test_a_page_says_that_it_was_made_with_the_earlier_tissue(page: str) -> None:
    top = (RESULTS / page).read_text().split("\n\n")[1].replace("\n> ", " ")
    assert top.startswith("> **These results were made with an earlier model of the soft tissue**")
    assert "do not hold for" in top or "have no successor" in top


def test_a_run_of_the_present_protocol_is_not_set_beside_them() -> None:
    earlier = read_scores(RESULTS / "bathing-v1" / "replay.json.gz")
    own = RunScores(scores=[make_score(s.task_id, s.seed) for s in earlier.scores])
    told = r"A ran bathing-v2 .*, B ran bathing-v1 .*: only runs of the same protocol"
    with pytest.raises(ConfigError, match=told):
        compare_runs(own, earlier)


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


EXAM = sorted(RESULTS.glob("bathing-wide-v1-*/*.json.gz"))


@pytest.mark.parametrize("scores", EXAM, ids=lambda path: f"{path.parent.name} {path.name}")
def test_the_rates_of_the_exam_are_those_of_the_kept_scores(scores: Path) -> None:
    """On its own page, and on the page that tells what it means."""
    run = read_scores(scores)
    first, passed = run.scores[0], sum(score.safety_gated for score in run.scores)
    assert not any(score.ended == "harness_error" for score in run.scores), "a void trial says nothing"
    row = rf"\| {first.protocol_id} \| {re.escape(first.policy_title)}(?: \(\w+\))? \| {passed}/{len(run.scores)} \|"
    assert re.search(row, (RESULTS / "bathing-wide-v1.md").read_text())
    assert told(passed, run) == level_cells(RESULTS / "README.md", row_of(run))[first.protocol_id]


@pytest.mark.parametrize("level", ["L0", "L1", "L2", "L3"])
def test_the_readme_has_ceiling_methods_and_floor(level: str) -> None:
    """The floor is the best of the kept blind baselines."""
    runs = {path.name.partition(".")[0]: read_scores(path) for path in EXAM if path.parent.name.endswith(level)}
    passed = {name: sum(score.safety_gated for score in run.scores) for name, run in runs.items()}
    blind = max((name for name in passed if role_in(runs[name].scores) == "blind"), key=lambda name: passed[name])
    for name in ("oracle", "state-machine", "voxposer"):
        cell = level_cells(ROOT / "README.md", f"`{name}`")[f"bathing-wide-v1 {level}"]
        assert cell == told(passed[name], runs[name])
    floor = level_cells(ROOT / "README.md", r"\[policy that does not look\]")[f"bathing-wide-v1 {level}"]
    assert floor == told(passed[blind], runs[blind])


def test_the_newcomers_page_has_the_floors_and_ceilings() -> None:
    page = " ".join((ROOT / "docs" / "bathing-wide.md").read_text().split())
    said = re.search(
        r"On L2, the floor is (\d+) %, the ceiling (\d+) %, and our script passes (\d+) %\. "
        r"On L3, these are (\d+), (\d+) and (\d+) %", page
    )  # fmt: skip
    assert said is not None
    rates = {
        level: {
            (path.stem, role_in(run.scores)): 100 * sum(s.safety_gated for s in run.scores) / len(run.scores)
            for path in EXAM if path.parent.name.endswith(level) for run in [read_scores(path)]
        }
        for level in ("L2", "L3")
    }  # fmt: skip
    expected: list[float] = []
    for of_level in rates.values():
        expected += [
            max(rate for (_, role), rate in of_level.items() if role == kind) for kind in ("blind", "privileged")
        ]
        expected.append(of_level["state-machine.json", "method"])
    assert list(map(int, said.groups())) == [round(rate) for rate in expected]


CHANGED = sorted(RESULTS.glob("sensitivity/bathing-wide-v1-*/*.json.gz"))


@pytest.mark.parametrize("scores", CHANGED, ids=lambda path: f"{path.parent.name} {path.name}")
def test_the_rates_under_a_changed_protocol_are_those_of_the_kept_scores(scores: Path) -> None:
    run = read_scores(scores)
    first, passed = run.scores[0], sum(score.safety_gated for score in run.scores)
    value = scores.name.removesuffix(".json.gz").rpartition("_")[2]
    title = re.escape(first.policy_title) + r"(?: \(\w+\))?(?: \| bathing-wide-v1 L2)?"
    row = rf"\| {title} \| {value.replace('-', '[- _]')} \| {len(run.scores)} \| {passed}/{len(run.scores)} \|"
    assert re.search(row, (RESULTS / f"{scores.parent.name}.md").read_text())
    if value != "dry":  # this is the protocol's own, which the table has once
        assert depends_on(scores.parent.name)[first.policy][value] == str(passed)


@pytest.mark.parametrize(
    "scores",
    [p for p in CHANGED if p.name.endswith(("_400.json.gz", "_human-published.json.gz", "_dry.json.gz"))],
    ids=lambda path: f"{path.parent.name} {path.name}",
)  # fmt: skip
def test_under_the_protocols_own_value_the_same_recordings_come_out(scores: Path) -> None:
    """The sweeps ran on other machines than the results: each cell of the unchanged protocol has the same hashes."""
    run = read_scores(scores)
    twins = [read_scores(path) for path in (RESULTS / "bathing-wide-v1-L2").glob(f"{run.scores[0].policy}*.json.gz")]
    hashes = {s.recording_sha256 for twin in twins for s in twin.scores}
    assert {s.recording_sha256 for s in run.scores} <= hashes


@pytest.mark.parametrize("level", ["L0", "L1", "L2", "L3"])
def test_the_oracle_passes_every_trial_of_the_check(level: str) -> None:
    """docs/bathing-wide.md: 189 of 189 on each level."""
    run, test = (
        read_scores(RESULTS / path)
        for path in (f"check/oracle-{level}.json.gz", f"bathing-wide-v1-{level}/oracle.json.gz")
    )
    assert {(s.task_id, s.seed) for s in run.scores} == {(f"T{t}", seed) for t in range(1, 8) for seed in range(27, 54)}
    assert all(s.safety_gated for s in run.scores)
    assert {s.protocol_sha256 for s in run.scores} == {s.protocol_sha256 for s in test.scores}


@pytest.mark.parametrize(("level", "passed"), [("L2", 24), ("L3", 20)])
def test_what_a_blind_policy_passes_of_the_check(level: str, passed: int) -> None:
    """docs/bathing-wide.md: 13 and 11 %."""
    run, test = (
        read_scores(RESULTS / path)
        for path in (f"check/mean-person-{level}.json.gz", f"bathing-wide-v1-{level}/oracle.json.gz")
    )
    assert {(s.task_id, s.seed) for s in run.scores} == {(f"T{t}", seed) for t in range(1, 8) for seed in range(27, 54)}
    assert sum(s.safety_gated for s in run.scores) == passed
    assert {s.policy_title for s in run.scores} == {"mean-person person=bathing-wide-L2"}
    assert {s.protocol_sha256 for s in run.scores} == {s.protocol_sha256 for s in test.scores}


SAME = {"none": "L0", "all": "L3"}
"""Cells of the sweep of factors that are a level of the protocol as it is."""


@pytest.mark.parametrize("policy", ["state-machine", "replay"])
@pytest.mark.parametrize("cell", SAME)
def test_with_none_or_all_of_the_factors_the_recordings_of_a_level_come_out(policy: str, cell: str) -> None:
    run = read_scores(RESULTS / "sensitivity" / "bathing-wide-v1-factors" / f"{policy}_{cell}.json.gz")
    twin = read_scores(RESULTS / f"bathing-wide-v1-{SAME[cell]}" / f"{policy}.json.gz")
    assert {s.recording_sha256 for s in run.scores} <= {s.recording_sha256 for s in twin.scores}


@pytest.mark.parametrize("policy", ["state-machine", "voxposer"])
def test_the_readme_says_what_stiffness_and_tissue_do_on_the_papers_protocol(policy: str) -> None:
    runs = [f"{policy}-200", policy, f"{policy}-1000", f"{policy}-manikin-like"]
    passed = [
        sum(s.safety_gated for s in read_scores(RESULTS / "bathing-v2" / f"{run}.json.gz").scores) for run in runs
    ]
    assert "| " + " | ".join([policy, *map(str, passed)]) + " |" in (RESULTS / "README.md").read_text()


def test_the_table_of_the_cameras_error_is_that_of_the_draws_and_the_kept_scores() -> None:
    protocol = load_protocol("bathing-wide-v1", level="L2")
    error_mm = {seed: 1000 * calibration(protocol, seed)["overhead"][2, 3] for seed in range(1000, 1027)}
    group = {seed: -1 if error < -2 else int(error > 2) for seed, error in error_mm.items()}
    lines = (RESULTS / "README.md").read_text().partition("| the camera believes")[2].splitlines()[2:5]
    for which, line in zip((-1, 0, 1), lines, strict=True):
        seeds = [seed for seed in group if group[seed] == which]
        cells = [cell.strip() for cell in line.split("|")[2:-1]]
        assert cells[0] == str(len(seeds))
        exam = [f"bathing-wide-v1-{level}/state-machine" for level in ("L1", "L2", "L3")]
        deeper = [f"sensitivity/press-deeper-{level}" for level in ("L2", "L3")]
        for run, cell in zip([*exam, *deeper], cells[1:], strict=True):
            scores = read_scores(RESULTS / f"{run}.json.gz").scores
            mine = [score.safety_gated for score in scores if score.seed in seeds]
            assert cell == f"{sum(mine)} of {len(mine)}"


def people() -> Bands:
    """The bands of examples/cluster/ensemble.toml from its kept scores."""
    cells: list[CellScores] = []
    for path in sorted(RESULTS.glob("sensitivity/ensemble-*.json.gz")):
        policy, body, friction = path.name.removesuffix(".json.gz").removeprefix("ensemble-").split("_")
        scores = read_scores(path).scores
        assert {(s.policy, len(scores)) for s in scores} == {(policy, 6)}
        values = {"body": body, "friction": friction}
        cells.append(CellScores(label=policy, values=values, folder="", planned=6, scores=scores))
    assert len(cells) == 32
    found = bands(cells, "safety_gated", ranked=["state-machine", "voxposer", "voxposer-phased", "replay"])
    assert found is not None
    return found


def test_the_page_of_the_person_says_how_much_it_matters_who_is_simulated() -> None:
    found = people()
    assert {one.n for one in found.spreads} == {24}
    page = (ROOT / "docs" / "person.md").read_text().partition("## Does it matter who is simulated?")[2]
    named = {name: f"`{name}`" for name in ("state-machine", "voxposer", "voxposer-phased", "replay")}
    for row in (*spread_rows(found, named), *flip_rows(found)):
        # Neither task is a push, so that C2 is defined for none.
        assert row[4] == "NA"
        assert f"| {' | '.join(row[:4] + row[5:])} |" in page


def depends_on(sweep: str) -> dict[str, dict[str, str]]:
    """Return the table of results/README.md on what a sweep changed: policy, changed value, passed trials."""
    section = (RESULTS / "README.md").read_text().partition("## What the result depends on")[2].partition("\n## ")[0]
    values, _, factors = section.partition("### One factor at a time")
    lines = (factors if sweep.endswith("factors") else values).splitlines()
    rows = [[cell.strip().strip("`") for cell in line.split("|")[1:-1]] for line in lines if line.startswith("|")]
    if sweep.endswith("factors"):
        found = {policy: {"none": cells[0], "all": cells[1]} for policy, cells in pairs_of(rows[2]).items()}
        for row in rows[3:]:
            for policy, (alone, left_out) in pairs_of(row).items():
                name = row[0].replace(" ", "-")
                found[policy] |= {f"only-{name}": alone, f"all-but-{name}": left_out}
        return found
    columns = {"human-published": "400", **{name: name.removesuffix(" N/m") for name in rows[0]}}
    found = {row[0]: {columns[name]: cell for name, cell in zip(rows[0], row, strict=True)} for row in rows[2:]}
    return {policy: cells | {"human-published": cells["400"]} for policy, cells in found.items()}


def pairs_of(row: list[str]) -> dict[str, list[str]]:
    """Return the two cells of each policy in a row of the table of factors."""
    return {"state-machine": row[1:3], "replay": row[3:5]}


def told(passed: int, run: RunScores) -> str:
    return f"{passed} ({100 * passed / len(run.scores):.0f} %)"


def row_of(run: RunScores) -> str:
    """Return the expression that finds a policy's row, by the mean that it uses where there are several."""
    first = run.scores[0]
    mean = re.search("bathing-wide-(L[0-3])", first.policy_title) if first.policy == "mean-person" else None
    return f"`{first.policy}`" + (f".* mean of {mean[1]}" if mean else "")


def level_cells(page: Path, row: str) -> dict[str, str]:
    """Return the cells of the row whose name an expression finds, by level."""
    (line,) = (
        line for line in page.read_text().splitlines()
        if line.startswith("|") and re.search(row, line.split("|")[1]) and line.count("|") == 6
    )  # fmt: skip
    return {f"bathing-wide-v1 L{number}": cell.strip() for number, cell in enumerate(line.split("|")[2:6])}
