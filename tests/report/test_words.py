from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
import tyro

from carecontact.cli.parsing import parse
from carecontact.cli.report import Report
from carecontact.cli.run import Run
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden
from carecontact.protocol.protocol import Protocol
from carecontact.report.links import replay_commands, rules_options
from carecontact.report.run_page import write_report
from carecontact.report.trial_page import write_trial_page
from carecontact.report.words import LONGEST, clipped_text, rounded, short_names
from carecontact.scoring import score_recording
from carecontact.scoring.result import TrialScore
from tests.report.synthetic import make_score, whole_trial


def test_one_trial_with_one_action_is_in_the_singular() -> None:
    assert "In 1 of 1 trial the benchmark" in clipped_text([make_score("T1", 0, clipped_actions=1)])
    assert "(1 action in all)" in clipped_text([make_score("T1", 0, clipped_actions=1)])
    several = clipped_text([make_score("T1", seed, clipped_actions=2) for seed in range(2)])
    assert "In 2 of 2 trials the benchmark" in several
    assert "(4 actions in all)" in several


def test_numbers_keep_about_three_digits_where_they_are_rounded_up() -> None:
    assert [rounded(value) for value in (9.994, 9.996, 99.94, 99.96, 0.0004, -9.996)] == [
        "9.99", "10.0", "99.9", "100", "0", "-10.0",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("title", "name"),
    [
        ("replay", "replay"),
        ("mean-person person=bathing-wide-L2", "mean-person"),
        ("my_package.policy:MyPolicy steps=10", "MyPolicy"),
        ("my-vla at ws://192.0.2.7:8765 steps=10", "my-vla"),
    ],
)
def test_a_short_name_has_no_arguments_module_or_address(title: str, name: str) -> None:
    assert short_names([title]) == {title: name}


def test_policies_that_differ_in_their_arguments_keep_different_names() -> None:
    titles = ["replay donor=a.h5", "hover", "replay donor=b.h5", "replay"]
    assert list(short_names(titles).values()) == ["replay (1)", "hover", "replay (2)", "replay (3)"]


def test_a_long_name_is_cut_and_stays_different() -> None:
    long = "a_very_long_name_of_a_policy"
    names = list(short_names([f"m:{long}One", f"m:{long}Two"]).values())
    assert len(set(names)) == 2
    assert all(len(name) <= LONGEST + len(" (1)") for name in names)


# The report and the pages of its trials link each other, whichever is written first.

RECORDING = whole_trial()
SCORE = score_recording(RECORDING)


def page(folder: Path) -> Path:
    return write_trial_page(folder, RECORDING, SCORE)


def report(folder: Path) -> Path:
    return write_report(folder, scores=[SCORE], recordings=lambda trial_id: RECORDING, skipped={})


def shown_links(path: Path) -> list[str]:
    """Addresses of the links that a reader sees."""
    text = re.sub(r"<span hidden>.*?</span>", "", path.read_text())
    return [address for address in re.findall(r'<a href="([^"]+)"', text) if not address.startswith("#")]


def test_alone_neither_links_what_is_not_there(tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    assert shown_links(page(tmp_path)) == []
    assert shown_links(report(tmp_path / "b")) == []


def test_whichever_is_written_first_both_link_each_other_and_have_the_same_bytes(tmp_path: Path) -> None:
    written: list[list[str]] = []
    for name, order in (("a", (page, report)), ("b", (report, page)), ("c", (page, report, page, report))):
        folder = tmp_path / name
        folder.mkdir()
        for write in order:
            write(folder)
        assert shown_links(folder / "trial" / "T1-s000.html") == ["../report.html#T1-s000"]
        assert "trial/T1-s000.html" in shown_links(folder / "report.html")
        pages = [folder / "trial" / "T1-s000.html", folder / "report.html"]
        # A command that a page prints names the folder of the run.
        written.append([page.read_text().replace(str(folder), "RUN") for page in pages])
    assert written[0][0] == written[1][0] == written[2][0]
    assert written[0][1] == written[2][1]


# The commands that set blind replay beside a run, given back to the command line that they are for.

CHANGES = {
    "impedance.translational_n_m": 1000,
    "person.body": "woman-old-light",
    "scene.tool": "mitt",
    "gates.touch.duration_s": 1.5,
    "tasks.T1.prompt": "Please touch the patient's right forearm.",
    "person.tissue.forearm.friction": 0.2,
}


def _score(protocol: Protocol, *, seed: int = 0, task: str = "T1") -> TrialScore:
    return make_score(task, seed).model_copy(
        update={"protocol_id": protocol.name, "overrides": protocol.overrides, "protocol_sha256": protocol.sha256}
    )


def _parsed(command: str) -> Run:
    program, *arguments = shlex.split(command)
    assert program == "carecontact"
    run = parse(arguments)
    assert isinstance(run, Run)
    return run


@pytest.mark.parametrize("changes", [{}, CHANGES, {"phases.latency_s": 0.2, "physics.dt_s": 0.004}])
def test_the_command_runs_replay_under_the_rules_of_the_run(changes: dict[str, object]) -> None:
    protocol = overridden(load_protocol("bathing-v3"), changes)
    scores = [_score(protocol, seed=seed, task=task) for task in ("T1", "T3") for seed in (4, 1)]
    run = _parsed(replay_commands(scores, Path("runs/my run"))[0])
    assert run._protocol().sha256 == protocol.sha256
    assert (run.policy, run.tasks, run.seeds, run.out) == ("replay", "T1,T3", "1,4", Path("runs/my run-replay"))


def test_a_level_is_named() -> None:
    protocol = load_protocol("bathing-wide-v2", level="L2")
    run = _parsed(replay_commands([_score(protocol)], Path("runs/a"))[0])
    assert run._protocol().sha256 == protocol.sha256


@pytest.mark.parametrize(("folder", "out"), [("runs/a", "runs/a-replay"), ("a", "a-replay")])
def test_the_report_names_both_folders(folder: str, out: str) -> None:
    _, _, *arguments = shlex.split(replay_commands([make_score("T1", 0)], Path(folder), trials=True)[1])
    report = tyro.cli(Report, args=arguments)
    assert (report.place, report.baseline, report.trials) == (Path(folder), (Path(out),), True)


def test_the_folder_of_a_run_that_is_named_by_a_dot_has_one_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert replay_commands([make_score("T1", 0)], Path())[1].endswith(f" . --baseline ../{tmp_path.name}-replay")


def test_files_that_a_score_does_not_name_stand_as_such() -> None:
    score = make_score("T1", 0).model_copy(
        update={
            "protocol_id": "mine",
            "overrides": {"lock": "changed", "vision.segmenter": "grounded-sam 0123456789ab"},
            "world": {"salt": "ab"},
        }
    )
    assert rules_options(score) == [
        "--protocol", "FILE.toml", "--unfrozen", "--segmenter", "grounded-sam", "--weights", "FOLDER",
        "--salt-file", "FILE",
    ]  # fmt: skip
