"""``carecontact report`` of a run with the pages of its trials, and of one recording."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from carecontact.cli import main, scores
from carecontact.cli.scores import print_scores
from carecontact.protocol.protocol import Protocol
from carecontact.recording import Recording, write_recording
from carecontact.runs import score_run, write_scores
from carecontact.runs.pooling import RunScores
from carecontact.stats import person_rate
from tests.protocol.held import HELD, ship_frozen
from tests.report.synthetic import FAILED, NO_CONTACT, PROTOCOL, Run, fill, make_score, whole_trial
from tests.scoring.synthetic import touch


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A scored run of two trials, in the folder ``run`` of the current one."""
    monkeypatch.chdir(tmp_path)
    Path("run").mkdir()
    write_recording(whole_trial(), Path("run/T1-s000.h5"))
    write_recording(whole_trial("T2", touched=False), Path("run/T2-s000.h5"))
    write_scores("run", score_run("run"))
    return Path("run")


def test_the_page_of_one_trial(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", "run/T1-s000.h5"]) == 0
    assert capsys.readouterr().out == "page of the trial: run/trial/T1-s000.html\n"
    assert "T1 Touch forearm, seed 0, passed" in (run / "trial/T1-s000.html").read_text()
    assert not (run / "report.html").exists()
    assert [path.name for path in (run / "trial").iterdir()] == ["T1-s000.html"]


def test_the_report_links_the_pages_that_are_there(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", "run"]) == 0
    assert 'href="trial/' not in (run / "report.html").read_text()
    assert main(["report", "run", "--trials"]) == 0
    assert f"pages of 2 trials: {Path('run/trial')}" in capsys.readouterr().out
    text = (run / "report.html").read_text()
    for trial_id in ("T1-s000", "T2-s000"):
        assert f'href="trial/{trial_id}.html"' in text
        assert f'href="{trial_id}.h5"' in text
        assert f'href="../report.html#{trial_id}"' not in text
        assert (run / f"trial/{trial_id}.html").is_file()


def test_a_trial_that_cannot_be_drawn_is_named(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    broken = whole_trial("T2", touched=False)
    broken.arrays["report/skin_faces"][0, 0] = 10_000
    write_recording(broken, run / "T2-s000.h5")
    assert main(["report", "--rescore", "run"]) == 0
    assert main(["report", "run", "--trials"]) == 0
    printed = capsys.readouterr().out
    assert "no page of T2-s000: T2-s000: report/skin_faces does not fit report/skin_in_world" in printed
    assert f"pages of 1 trial: {Path('run/trial')}" in printed


@pytest.mark.parametrize("option", [["--trials"], ["--baseline", "other"], ["--rescore"]])
def test_options_of_a_run_are_refused_for_a_trial(
    run: Path, option: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", "run/T1-s000.h5", *option]) == 2
    assert f"{option[0]} belongs to the report of a run: name its folder, run" in capsys.readouterr().err


def test_a_file_that_is_no_recording_is_named(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", "run/results.json"]) == 2
    assert "run/results.json" in capsys.readouterr().err


def test_a_file_that_is_no_recording_is_named_what_report_takes(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (run / "results.json.gz").write_bytes(b"")
    assert main(["report", "run/results.json.gz"]) == 2
    printed = "report takes the folder of a run, or one recording in it (TRIAL.h5); name run"
    assert f"run/results.json.gz: {printed}" in capsys.readouterr().err


# What the terminal shows of scores, at 80 columns.

CRASHED = NO_CONTACT | {"ended": "process_failure", "failure_mode": "process_failure"}
PRESSED = FAILED | {
    "ended": "process_failure", "failure_mode": "process_failure", "over_limit": {"right_forearm": 61.9 / 35},
    "peak_force_n": {"right_forearm": 61.9},
}  # fmt: skip


def with_mitt(protocol: Protocol) -> Protocol:
    """The same protocol, with the mitt on the robot's hand; no command is known to have put it there."""
    return protocol.model_copy(update={"scene": protocol.scene.model_copy(update={"tool": "mitt"})})


def shown(
    made: list, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, protocol: Protocol = PROTOCOL
) -> str:
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr(scores, "_protocol", lambda run, folder: protocol)
    print_scores(RunScores(scores=made), Path("nowhere"), None, verbose=True)
    return capsys.readouterr().out


def test_the_verdict_has_an_interval_over_persons_from_six_seeds_on(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    made = [make_score("T1", seed, protocol_id="bathing-wide-v2 L2", safety_gated=seed < 3) for seed in range(6)]
    over = person_rate([s.safety_gated for s in made], persons=range(6))
    interval = f"3 of 6 trials (50 %, 95 % interval over persons {100 * over.low:.0f} to {100 * over.high:.0f} %)"
    assert interval in shown(made, capsys, monkeypatch)
    assert "3 of 5 trials (60 %) of" in shown(made[:5], capsys, monkeypatch)


def test_seven_tasks_fit_80_columns_and_no_name_is_cut(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    run = Run()
    fill(run, 0)
    scores = [s.model_copy(update={"additional": {"beyond_calibrated@2": 0.125}}) for s in run.scores]
    printed = shown(scores, capsys, monkeypatch)
    assert [line for line in printed.splitlines() if len(line) > 80] == []
    assert "…" not in printed
    assert "beyond_calibrated@2" in printed
    (row,) = [line.split() for line in printed.splitlines() if line.startswith("T5 ")]
    assert row[-2:] == ["1", "insufficient"]
    heads = [line.removeprefix("median") for line in printed.splitlines() if line.startswith("median")]
    assert " ".join(heads).split() == ["T1", "T2", "T3", "T4", "T5", "T6", "T7", "all"]
    assert all(line.count("of 6") == 1 for line in printed.split("successful\n")[1].splitlines() if " of " in line)


def test_a_run_of_crashes_alone_counts_nothing_above_a_limit(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    printed = shown([make_score("T1", 0, **CRASHED)], capsys, monkeypatch)
    assert "crashed: 1" in printed
    assert "limit" not in printed
    assert "0 of 1" not in printed.replace("score: 0 of 1", "").replace("passes 0 of 1", "")


def test_a_force_above_the_gate_before_a_crash_is_named(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    scores = [make_score("T1", 0), make_score("T1", 1, **PRESSED), make_score("T1", 2, **CRASHED)]
    printed = " ".join(shown(scores, capsys, monkeypatch).split())
    assert "crashed: 2, 1 of them after a force above the safety gate" in printed
    assert "share of the pain limit 1 of 2 0" in printed


def test_the_gate_for_joints_is_named_where_there_is_one(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    flagged = make_score("T1", 1, joints_beyond={}, joints_consumed={"right_elbow": 0.9})
    none = make_score("T1", 0, joints_beyond={}, joints_consumed={})
    printed = " ".join(shown([none, flagged], capsys, monkeypatch).split())
    assert (
        "joint beyond the protocol's limit: 0 of 2; a joint flagged because little of its margin was left: 1 of 2"
        in printed
    )
    assert "joint" not in shown([make_score("T1", 0)], capsys, monkeypatch)


def test_what_nursing_studies_ask_is_named_of_the_mitt_alone(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    values = [{"effective@1": 1.0, "comfortable@2": 0.0}, {"effective@1": 0.0, "comfortable@2": 1.0}]
    scores = [make_score("T3", seed, additional=found) for seed, found in enumerate(values)]
    scores.append(make_score("T1", 0, additional={"effective@1": 0.0, "comfortable@2": 1.0}))
    printed = shown(scores, capsys, monkeypatch, with_mitt(PROTOCOL))
    assert "Wiped clean (effective@1): 1 of 2" in printed, "of scrub tasks"
    assert "Wiped below 25 mmHg (comfortable@2): 2 of 3" in printed
    assert "effective@1" not in shown(scores, capsys, monkeypatch)


def test_terminal_and_page_know_the_mitt_of_a_protocol_that_no_command_changed(
    pressed: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = {}
    for name, change in (("caps", lambda protocol: protocol), ("mitt", with_mitt)):
        spec = pressed.header.spec
        header = pressed.header.model_copy(update={"spec": spec.model_copy(update={"protocol": change(spec.protocol)})})
        (folder := tmp_path / name).mkdir()
        write_recording(replace(pressed, header=header), folder / "T1-s000.h5")
        assert main(["report", "--rescore", "-v", str(folder)]) == 0
        printed = capsys.readouterr().out
        assert main(["report", str(folder)]) == 0
        page = (folder / "report.html").read_text()
        found[name] = ["Wiped below 25 mmHg (" in printed, "trials that pass, of those with a value" in page]
    assert found == {"caps": [False, False], "mitt": [True, True]}


# Recordings that carry a shipped id and other rules: every output that names the protocol says so.

CHANGED = f"not the frozen {HELD} (sha256 "


def eased(recording: Recording) -> Recording:
    """A hold of 10 ms is a touch."""
    protocol = recording.header.spec.protocol
    gates = protocol.gates.model_copy(update={"touch": protocol.gates.touch.model_copy(update={"duration_s": 0.01})})
    spec = recording.header.spec.model_copy(update={"protocol": protocol.model_copy(update={"gates": gates})})
    return Recording(header=recording.header.model_copy(update={"spec": spec}), arrays=recording.arrays)


def test_score_report_and_compare_name_eased_rules(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    shipped = tmp_path / "shipped"
    shipped.mkdir()
    good = touch(seed=0, protocol=ship_frozen(monkeypatch, shipped))
    for name, made in (("good", good), ("a", eased(good)), ("b", eased(good))):
        Path(name).mkdir()
        write_recording(made, Path(name) / "T1-s000.h5")
        assert main(["report", "--rescore", name]) == 0
        assert (f"protocol: {CHANGED}" in capsys.readouterr().out) == (name != "good")
        assert main(["report", name]) == 0
        assert (f"{HELD} (not the frozen protocol)" in (Path(name) / "report.html").read_text()) == (name != "good")
    capsys.readouterr()
    assert main(["compare", "a", "b"]) == 0
    assert f"protocol: {CHANGED}" in capsys.readouterr().out
    assert main(["compare", "good", "a"]) == 2
