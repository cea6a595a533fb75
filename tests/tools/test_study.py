"""A study over runs of known content: what is sorted in, missing, refused and said, and that the page says it."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest
from tools.results import main
from tools.study.page.markdown import escaped
from tools.study.page.page import study_page
from tools.study.page.sweeps import SWEEP_TITLE
from tools.study.plan import STIFFNESS, TISSUE
from tools.study.sorted_runs import sorted_out
from tools.study.study import Study, study, study_json

from carecontact.errors import ConfigError
from carecontact.protocols import load_protocol, overridden
from carecontact.reports.paper.published import read_paper
from carecontact.runs import RunScores, read_results
from carecontact.runs.results_file import write_scores
from tests.reports.synthetic_run import FAILED, make_score

PROTOCOL, PAPER = load_protocol(), read_paper()
SEEDS = range(6)
STALLED = FAILED | {
    "failure_mode": "insufficient_progress", "attribution": "planning", "evidence": "stroke 34 mm of 100 mm",
}  # fmt: skip
Change = Callable[[str, int], dict[str, Any]]


def run(
    policy: str,
    change: Change = lambda task, seed: {},
    *,
    seeds: range = SEEDS,
    changes: Mapping[str, object] | None = None,
) -> RunScores:
    """``changes``: of ``overridden``."""
    rules = overridden(PROTOCOL, changes or {})
    said = {"policy": policy, "protocol_sha256": rules.sha256, "overrides": rules.overrides}
    scores = [make_score(t.id, s, **{**said, **change(t.id, s)}) for t in PROTOCOL.tasks for s in seeds]
    return RunScores(scores=scores, versions={"carecontact": ["0.1.0"]})


def heavy(task: str, seed: int) -> dict[str, Any]:
    return {"c1_peak_force_n": 20.0 + 0.1 * seed, "c5_force_sd_n": 3.0 + 0.01 * seed}


def light(task: str, seed: int) -> dict[str, Any]:
    """Succeeds on Touch alone."""
    touched = {"c1_peak_force_n": 2.0 + 0.1 * seed, "c5_force_sd_n": 0.2 + 0.01 * seed}
    authored = {"language_backend": "replay:0123456789ab:authored"}
    return touched | authored | ({} if task in ("T1", "T4", "T6") else STALLED)


def made(**runs: RunScores) -> Study:
    return study(sorted_out(runs, PROTOCOL), protocol=PROTOCOL, paper=PAPER)


def page(found: Study) -> str:
    return study_page(found, PAPER, command="python tools/results.py runs/bathing-v2/*", json_name="x.json")


@pytest.fixture(scope="module")
def whole() -> Study:
    """Both methods, a blind baseline, and a sweep in which the stiff arm turns the order of the forces round."""
    return made(
        a=run("state-machine", heavy), b=run("voxposer", light), null=run("zero-action", lambda t, s: STALLED),
        a1000=run("state-machine", light, changes={STIFFNESS: "1000"}),
        b1000=run("voxposer", heavy, changes={STIFFNESS: "1000"}),
        manikin=run("voxposer", light, changes={TISSUE: "manikin-like"}),
    )  # fmt: skip


def test_runs_are_known_by_their_trials_and_the_rest_is_named(whole: Study) -> None:
    assert sorted(h.title for h in whole.heads) == [
        "bathing-v2", "bathing-v2", "bathing-v2", "bathing-v2 with stiffness 1000 N/m",
        "bathing-v2 with stiffness 1000 N/m", "bathing-v2 with tissue manikin-like",
    ]  # fmt: skip
    missing = "\n".join(whole.missing)
    assert "--policy voxposer-phased --protocol bathing-v2 --out" in missing
    assert "--policy state-machine --protocol bathing-v2 --stiffness 200 " in missing
    assert "--policy state-machine --protocol bathing-v2 --tissue manikin-like " in missing
    assert len(whole.missing) == 1 + 3 + 2 + 1
    assert (
        "carecontact run --policy voxposer --protocol bathing-v2 --tissue manikin-like "
        "--out runs/bathing-v2/voxposer-manikin-like"
    ) in whole.commands
    assert len(whole.commands) == len(whole.heads) == 6
    text = page(whole)
    assert all(f"    {command}\n" in text for command in (*whole.commands, *whole.missing))
    assert "42 of 140" in text


def test_the_pair_is_tested_and_set_beside_the_paper(whole: Study) -> None:
    rows = {row.outcome.id: row for row in whole.beside}
    assert list(rows) == ["success", "region_correct", "safety_gated", "C1", "C5"]
    assert all(row.agreement == "as in the paper" for row in rows.values())
    success = rows["success"]
    assert (success.line.a.estimate, success.line.b.estimate) == (1.0, pytest.approx(18 / 42))
    assert (success.paper_a, success.paper_b, success.paper_test) == (pytest.approx(0.729), pytest.approx(0.279), None)
    text = page(whole)
    (line,) = [row for row in text.splitlines() if row.startswith("| Success [%] |")]
    assert line.startswith("| Success [%] | 100.0 | 42.9 | 57.1 [")
    assert "| 72.9 and 27.9 | not tested |" in line
    assert "state-machine higher; higher is better" in text
    assert "| State Machine | paper | 140 | 72.9 (65.0, 79.5) |" in text
    assert "| insufficient progress | planning 24 |" in text
    assert "24 of 42 trials are not region-correct. Paper: 101 of 140, 68 of them insufficient progress." in text
    assert "replay:0123456789ab:authored" in text
    assert "written by hand" in text


def test_against_the_paper_not_seen_and_open() -> None:
    same = made(a=run("state-machine", heavy), b=run("voxposer", heavy))
    assert {row.agreement for row in same.beside if row.outcome.id in ("C1", "C5")} == {"not seen here"}
    turned = made(a=run("state-machine", light), b=run("voxposer", heavy))
    assert {row.agreement for row in turned.beside} == {"against the paper"}
    few = made(a=run("state-machine", heavy, seeds=range(1)), b=run("voxposer", light, seeds=range(1)))
    assert {row.agreement for row in few.beside} == {"open"}


def test_a_sweep_ranks_each_level_against_the_protocols_own(whole: Study) -> None:
    sweeps = {sweep.field: sweep for sweep in whole.sweeps}
    stiffness = sweeps[STIFFNESS]
    assert [(level.value, level.is_protocol, level.comparison is None) for level in stiffness.levels] == [
        ("200", False, True), ("400", True, False), ("1000", False, False),
    ]  # fmt: skip
    assert {name: row.tau["1000"].tau for name, row in stiffness.ranking.items()} == dict.fromkeys(
        ("success", "region_correct", "safety_gated", "C1", "C5"), -1
    )
    assert [level.comparison is None for level in sweeps[TISSUE].levels] == [False, True]
    text = page(whole)
    assert "| stiffness 1000 N/m | voxposer (authored) | 6/6 | 6/6 | 6/6 | 6/6 | 6/6 | 6/6 | 6/6 |" in text
    assert "| stiffness 1000 N/m | state-machine (rules-v1) | 6/6 | 0/6 | 0/6 | 6/6 | 0/6 | 6/6 | 0/6 |" in text
    assert "| tissue manikin-like | voxposer (authored) | 6/6 | 0/6 | 0/6 | 6/6 | 0/6 | 6/6 | 0/6 |" in text
    assert "| stiffness 1000 N/m | -1 | -1 | -1 | -1 | -1 |" in text
    assert "| stiffness 200 N/m | run missing |" in text


def test_a_sweep_of_which_nothing_was_run_has_no_table() -> None:
    found = made(
        a=run("state-machine", heavy),
        b=run("voxposer", light),
        manikin=run("voxposer", light, changes={TISSUE: "manikin-like"}),
    )
    assert [sweep.field for sweep in found.sweeps] == [TISSUE]
    text = page(found)
    assert f"## {SWEEP_TITLE[STIFFNESS]}" not in text
    assert f"## {SWEEP_TITLE[TISSUE]}" in text
    assert "--policy voxposer --protocol bathing-v2 --stiffness 1000 " in "\n".join(found.missing)


def test_blind_baselines_stand_under_the_methods(whole: Study) -> None:
    text = page(whole)
    assert "| zero-action | 42 | 0.0 (0.0, 8.4) |" in text
    assert "| state-machine (rules-v1) | zero-action | 42 | +100.0 [" in text
    assert "No blind baseline was run" in page(made(a=run("state-machine")))


def test_every_table_says_what_stands_in_for_the_language_model(whole: Study) -> None:
    sections = {part.split("\n")[0]: part for part in page(whole).split("\n## ")}
    names = ("voxposer (authored)", "state-machine (rules-v1)")
    for title in (
        "Beside the paper",
        "state-machine against voxposer",
        "Task by task",
        "Blind baselines",
        *SWEEP_TITLE.values(),
    ):
        assert [name for name in names if name not in sections[title]] == []
    assert "voxposer.md" in sections["Beside the paper"]
    assert "rules" in sections["Beside the paper"]


def test_the_papers_proposal_is_tested_against_what_it_would_change(whole: Study) -> None:
    assert "voxposer-phased against voxposer" not in page(whole)
    found = made(b=run("voxposer", light), c=run("voxposer-phased", heavy))
    section = page(found).split("## voxposer-phased against voxposer")[1].split("\n## ")[0]
    (line,) = [row for row in section.splitlines() if row.startswith("| Success [%] |")]
    assert line.startswith("| Success [%] | 100.0 | 42.9 | 57.1 [")
    assert found.proposal is not None
    assert section.count("\n| ") == 2 + len(found.proposal.overall)


def test_pairs_that_are_mostly_equal_are_told() -> None:
    def slides_harder(task: str, seed: int) -> dict[str, Any]:
        return light(task, seed) | ({"c1_peak_force_n": 3.0 + 0.1 * seed} if task in ("T3", "T5", "T7") else {})

    found = made(b=run("voxposer", light), c=run("voxposer-phased", slides_harder))
    section = page(found).split("## voxposer-phased against voxposer")[1].split("\n## ")[0]
    (line,) = [row for row in section.splitlines() if row.startswith("| Peak force [N] |")]
    assert "| 0.00 [0.00, 0.00] | 42 |" in line
    assert line.endswith("| not to be told |")
    assert "Peak force: 24 of 42 pairs are equal, so that the median difference stands still" in section
    assert "Motion activity:" not in section


def test_what_others_wrote_stays_text() -> None:
    assert escaped("a <b>[x](http://y)</b> `c` *d* \\") == r"a \<b\>\[x\](http://y)\</b\> \`c\` \*d\* \\"
    found = made(a=run("state-machine", heavy), odd=run("<script>alert(1)</script>", light))
    assert "<script>" not in page(found)
    assert r"\<script\>" in page(found)


def test_a_missing_method_is_no_comparison() -> None:
    found = made(a=run("state-machine", heavy))
    assert (found.comparison, found.beside, found.overview) == (None, (), None)
    text = page(found)
    assert "Not compared: a run of state-machine or voxposer is missing." in text
    assert "| voxposer | here: not run |" in text


def test_what_does_not_belong_is_named_and_left_out() -> None:
    found = made(
        a=run("state-machine"), old=run("state-machine", changes={"person.body": "woman-old-light"}), mine=run("lift"),
        other=run("voxposer", lambda t, s: {"protocol_id": "bathing-droid-draft"}),
    )  # fmt: skip
    assert found.unused == {
        "old": "state-machine on bathing-v2 with body woman-old-light is no part of this study",
        "mine": "lift on bathing-v2 is no part of this study",
        "other": "of bathing-droid-draft",
    }
    assert all(f"Not used: {name}: {why}." in page(found) for name, why in found.unused.items())


@pytest.mark.parametrize(
    ("runs", "told"),
    [
        (
            {"a": run("state-machine"), "b": run("state-machine", seeds=range(5, 7))},
            r"a and b are both state-machine on bathing-v2 and no parts of one run: 7 trials are in both, T1-s0",
        ),
        (
            {
                "a": run("state-machine"),
                "b": run("state-machine", lambda t, s: {"language_backend": "live:m"}, seeds=range(6, 8)),
            },
            "no parts of one run: different language backends, rules-v1 and live:m",
        ),
        (
            {
                "a": run("state-machine"),
                "b": run("state-machine", lambda t, s: {"metric_versions": {"C1": "C1@2"}}, seeds=range(6, 8)),
            },
            "no parts of one run: different definitions",
        ),
        ({"a": run("state-machine", lambda t, s: {"protocol_sha256": "5" * 64})}, "a was made with another state of"),
        ({"a": run("lift")}, "none of 1 run"),
        (
            {
                "a": run("state-machine"),
                "b": run("voxposer", lambda t, s: {"world": {"mujoco": "9.9"}}, changes={STIFFNESS: "200"}),
            },
            "a and b were simulated in different worlds: mujoco",
        ),
    ],
)
def test_runs_that_must_not_be_set_together(runs: dict[str, RunScores], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        study(sorted_out(runs, PROTOCOL), protocol=PROTOCOL, paper=PAPER)


def test_a_run_may_come_in_parts(tmp_path: Path) -> None:
    parts = {"late": run("hover", seeds=range(3, 6)), "a": run("state-machine"), "early": run("hover", seeds=range(3))}
    for name, scores in parts.items():
        (tmp_path / name).mkdir()
        write_scores(tmp_path / name, scores)
    assert main([*(str(tmp_path / name) for name in parts), "--out", str(tmp_path)]) == 0
    assert read_results(tmp_path / "bathing-v2" / "hover.json.gz").scores == sorted(
        run("hover").scores, key=lambda score: score.trial_id
    )


def test_the_command_writes_the_same_bytes_twice(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, scores in (("a", run("state-machine", heavy)), ("b", run("voxposer", light))):
        (tmp_path / name).mkdir()
        write_scores(tmp_path / name, scores)
    arguments = [str(tmp_path / "a"), str(tmp_path / "b" / "results.json"), "--out", str(tmp_path / "out")]
    files = [tmp_path / "out" / f"bathing-v2{suffix}" for suffix in (".md", ".json")]
    assert main(arguments) == 0
    first = [file.read_bytes() for file in files]
    assert main(arguments) == 0
    assert [file.read_bytes() for file in files] == first
    content = json.loads(first[1])
    assert content["schema"] == "carecontact-study-2"
    assert content["beside"][0]["agreement"] == "as in the paper"
    assert content == json.loads(json.dumps(study_json(made(a=run("state-machine", heavy), b=run("voxposer", light)))))
    # What was packed beside the page gives it again, in any order.
    packed = sorted((tmp_path / "out" / "bathing-v2").iterdir(), reverse=True)
    assert [file.name for file in packed] == ["voxposer.json.gz", "state-machine.json.gz"]
    assert main([*map(str, packed), "--out", str(tmp_path / "again")]) == 0
    assert [(tmp_path / "again" / file.name).read_bytes() for file in files] == first
    assert main([str(tmp_path / "nothing")]) == 2
    assert "nothing: no such folder" in capsys.readouterr().err
    assert main([*map(str, packed), "--out", str(packed[0])]) == 2
    assert f"--out {packed[0]}: {packed[0]}" in capsys.readouterr().err
    (tmp_path / "taken" / "bathing-v2.md").mkdir(parents=True)
    assert main([*map(str, packed), "--out", str(tmp_path / "taken")]) == 2
    assert "bathing-v2.md cannot be written: Is a directory" in capsys.readouterr().err
