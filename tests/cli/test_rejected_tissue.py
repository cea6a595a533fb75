"""Tissue whose calibration was rejected: refused before the first trial, and named by every report where it is used."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from carecontact.cli import main
from carecontact.protocol.load import load_protocol
from carecontact.report.links import rules_options
from carecontact.runs import score_run

REASON = "held-out NRMSE 40.0%, limit 5%"
PLAN = 'tasks = "T1"\nseeds = "0"\n[[policies]]\npolicy = "hover"\n[axes]\ntissue = ["rejected.toml"]\n'


@pytest.fixture(autouse=True)
def rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the current folder, a set with a rejected forearm and one with an accepted abdomen."""
    monkeypatch.chdir(tmp_path)
    for name, region, verdict in (("rejected", "forearm", "rejected"), ("calibrated", "abdomen", "accepted")):
        row = load_protocol("bathing-v3").person.tissue[region].model_dump(mode="json", exclude_none=True)
        lines = [f"{key} = {json.dumps(value)}" for key, value in row.items()]
        reasons = [REASON] if verdict == "rejected" else []
        head = [f'id = "{name}-{region}-0a"', 'description = "x"', 'base = "paper-mapping"', f"[tissue.{region}]"]
        found = [f'verdict = "{verdict}"', f"reasons = {json.dumps(reasons)}", "nrmse = 0.4", "tangent_error = 0.0"]
        text = "\n".join([*head, *lines, f"[tissue.{region}.calibration]", *found])
        Path(f"{name}.toml").write_text(text)
    Path("p.toml").write_text(PLAN)
    Path("mine.toml").write_text(
        'base = "bathing-v3"\nid = "mine-v1"\ndescription = "mine"\n[person]\ntissue_set = "rejected.toml"\n'
    )


@pytest.mark.parametrize(
    "command",
    [
        ["run", "--policy", "hover", "--out", "r", "--tissue", "rejected.toml"],
        ["run", "--policy", "hover", "--out", "r", "--set", "person.tissue_set=rejected.toml"],
        ["run", "--policy", "hover", "--out", "r", "--protocol", "mine.toml"],
        ["sweep", "p.toml", "--out", "r"],
        ["sweep", "p.toml", "--out", "r", "--dry-run"],
        ["verify", "physics", "--tissue", "rejected.toml", "--out", "r"],
        ["view", "--start", "--task", "T1", "--set", "person.tissue_set=rejected.toml"],
        ["check", "hover", "--set", "person.tissue_set=rejected.toml"],
        ["verify", "leaks", "--set", "person.tissue_set=rejected.toml"],
    ],
)
def test_it_is_refused_before_the_first_trial(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(command) == 2
    found = capsys.readouterr()
    error = found.err or found.out
    assert f"the calibration of its tissue was rejected: forearm ({REASON}); --allow-rejected uses it" in error
    assert len(error.strip().splitlines()) == 1
    assert not Path("r").exists()


def test_every_report_names_it(fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    tissue = ["--tissue", "rejected.toml", "--tissue", "calibrated.toml"]
    run = ["run", "--policy", "hover", "--tasks", "T1", "--seeds", "0", "--out", "r", "--allow-rejected", *tissue]
    assert main(run) == 0
    printed = f"The calibration of this tissue was rejected: forearm ({REASON})."
    out = capsys.readouterr().out
    assert printed in out
    assert "bathing-wide-v2 L2 with tissue rejected-forearm-0a+calibrated-abdomen-0a" in out
    assert main(["report", "--rescore", "r"]) == 0
    assert printed in capsys.readouterr().out
    assert json.loads(Path("r/results.json").read_text())["rejected_tissue"] == f"forearm ({REASON})"
    page = Path("r/report.html").read_text()
    assert f"The calibration of this tissue was rejected: forearm ({REASON})." in page
    options = rules_options(score_run(Path("r")).scores[0])
    assert "--allow-rejected" in options
    assert options[options.index("--tissue") + 1] == "FILE.toml", "no command names the id of a file"
    assert main([*run[:2], "zero-action", *run[3:8], "other", *run[9:]]) == 0
    paper = ["export", "paper", "r", "--out", "p"]
    for command in (["compare", "r", "other"], ["compare", "r", "--baseline", "other"], paper):
        capsys.readouterr()
        assert main(command) == 0
        assert printed in " ".join(capsys.readouterr().out.split()), command
    assert main(["report", "r/T1-s000.h5"]) == 0
    assert printed in Path("r/trial/T1-s000.html").read_text()


def test_accepted_tissue_has_no_such_words(fake: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    run = ["run", "--policy", "hover", "--tasks", "T1", "--seeds", "0", "--out", "r", "--tissue", "calibrated.toml"]
    assert main(run) == 0
    assert "rejected" not in capsys.readouterr().out
    assert "rejected" not in Path("r/report.html").read_text()
    assert json.loads(Path("r/results.json").read_text())["rejected_tissue"] is None


def test_two_files_of_one_region_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    Path("again.toml").write_text(Path("rejected.toml").read_text())
    tissue = ["--tissue", "rejected.toml", "--tissue", "again.toml"]
    assert main(["run", "--policy", "hover", "--out", "r", "--allow-rejected", *tissue]) == 2
    assert "rejected.toml and again.toml both have a row for the forearm; give only one" in capsys.readouterr().err
    Path("again.toml").write_text(Path("calibrated.toml").read_text().replace("paper-mapping", "manikin-like"))
    assert main(["run", "--policy", "hover", "--out", "r", "--allow-rejected", *tissue]) == 2
    assert "no row for upper_arm; their bases differ (manikin-like, paper-mapping)" in capsys.readouterr().err
