"""The commands that set blind replay beside a run, given back to the command line that they are for."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
import tyro

from carecontact.cli.report import Report
from carecontact.cli.run import Run
from carecontact.contract.protocol import Protocol
from carecontact.protocols import load_protocol, overridden
from carecontact.reports.replay_commands import replay_commands, rules_options
from carecontact.scoring.result import TrialScore
from tests.reports.synthetic_run import make_score

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
    program, name, *arguments = shlex.split(command)
    assert (program, name) == ("carecontact", "run")
    return tyro.cli(Run, args=arguments)


@pytest.mark.parametrize("changes", [{}, CHANGES, {"phases.latency_s": 0.2, "physics.dt_s": 0.004}])
def test_the_command_runs_replay_under_the_rules_of_the_run(changes: dict[str, object]) -> None:
    protocol = overridden(load_protocol("bathing-v3-draft"), changes)
    scores = [_score(protocol, seed=seed, task=task) for task in ("T1", "T3") for seed in (4, 1)]
    run = _parsed(replay_commands(scores, Path("runs/my run"))[0])
    assert run._protocol().sha256 == protocol.sha256
    assert (run.policy, run.tasks, run.seeds, run.out) == ("replay", "T1,T3", "1,4", Path("runs/my run-replay"))


def test_a_level_is_named() -> None:
    protocol = load_protocol("bathing-wide-v2-draft", level="L2")
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
            "protocol_id": "mine", "overrides": {"lock": "changed", "vision.segmenter": "grounded-sam 0123456789ab"},
            "world": {"salt": "ab"},
        }
    )  # fmt: skip
    assert rules_options(score) == [
        "--protocol", "FILE.toml", "--unfrozen", "--segmenter", "grounded-sam", "--weights", "FOLDER",
        "--salt-file", "FILE",
    ]  # fmt: skip
