"""``carecontact submit``: a run that may stand on the board becomes an entry, and every other one is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

from carecontact import __version__
from carecontact.cli import main
from carecontact.cli.answers import schema_of
from carecontact.cli.board import BoardEntry, best_beside, recordings_sha256
from carecontact.policies.registry import SHIPPED
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording import Recording, read_recording, write_recording
from carecontact.recording.provenance import package_versions
from carecontact.runs import score_run, submission, write_scores
from carecontact.runs.identity import identity_of
from carecontact.runs.manifest import MANIFEST, write_manifest
from carecontact.runs.results_file import RESULTS_NAME
from carecontact.scoring import TrialScore
from tests.report.synthetic import make_score
from tests.scoring.synthetic import hold, make_recording, target_segment

RULES = load_protocol("bathing-wide-v2", level="L2")
POLICY, SEED = "my_arm:Arm", 1000
GIVEN = ["--name", "Arm", "--link", "https://example.org/arm", "--kind", "vision"]


def made(task: str, **changes: Any) -> Recording:
    """A recording of this release, in which the tool presses with 3 N for 3 s."""
    segment = target_segment(task)
    costs = {"wall/act_s": np.array([0.25, 0.5]), "wall/seconds": np.array([1.0, 4.0])}
    press = {segment: hold(5.0, 1.0, 4.0, 3.0)}
    recording = make_recording(
        task, duration=5.0, normal=press, seed=SEED, policy=POLICY, protocol=RULES, extra=costs, modalities=("rgb",)
    )
    return changed(recording, **{"versions": package_versions(), **changes})


def changed(recording: Recording, **header: Any) -> Recording:
    return replace(recording, header=recording.header.model_copy(update=header))


def edit(path: Path, change: Callable[[Any], None]) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A finished run of an exam that has one person."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(submission, "TEST_SEEDS", range(SEED, SEED + 1))
    folder = tmp_path / "mine"
    folder.mkdir()
    for task in RULES.tasks:
        write_recording(made(task.id), folder / f"{task.id}-s{SEED}.h5")
    specs = [TrialSpec(protocol=RULES, task_id=task.id, seed=SEED, policy=POLICY) for task in RULES.tasks]
    write_manifest(specs, out=folder, identity=identity_of(specs[0], search_path=()), purpose="run")
    write_scores(folder, score_run(folder))
    return folder


def refusal(capsys: pytest.CaptureFixture[str], *options: str) -> str:
    assert main(["submit", "mine", "--out", "board/arm.json", *(options or GIVEN)]) == 2
    printed = capsys.readouterr()
    assert printed.err.startswith("error: ")
    assert printed.err.count("\n") == 1
    assert not Path("board/arm.json").exists()
    return printed.err


def rewritten(run: Path, trial: str, **header: Any) -> None:
    """Change the header of a recording, and score the run again as its owner could."""
    path = run / f"{trial}.h5"
    write_recording(changed(read_recording(path), **header), path)
    write_scores(run, score_run(run))


def test_an_entry_has_the_numbers_of_the_run_beside_floor_and_ceiling(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["submit", "mine", "--out", "board/arm.json", *GIVEN]) == 0
    assert "a draft exam, which ranks nothing" not in capsys.readouterr().out
    written = Path("board/arm.json").read_bytes()
    entry = BoardEntry.model_validate_json(written)
    jsonschema.Draft202012Validator(schema_of(BoardEntry)).validate(json.loads(written))
    scores = score_run(run).scores
    passed = [score.safety_gated for score in scores]
    scrubs = [score.safety_gated for score in scores if score.action == "scrub"]
    assert 0 < sum(passed) < len(passed) == 7
    (level,) = entry.levels
    assert (entry.method, entry.origin, entry.receives, entry.release) == ("vision", "isolated", ["rgb"], __version__)
    assert (level.protocol, level.ranked, level.seeds) == ("bathing-wide-v2 L2", True, str(SEED))
    assert (level.passes.whole.n, level.passes.whole.of) == (sum(passed), 7)
    assert (level.passes.scrubs.n, level.passes.scrubs.of) == (sum(scrubs), 3)
    assert level.passes.others.of == 4
    assert level.passes.harmless.of > 0
    assert sum(level.failures.values()) == sum(not score.region_correct for score in scores)
    assert (level.policy_s, level.trial_s) == (0.75, 5.0)
    assert level.recordings_sha256 == recordings_sha256(reversed(scores))


def test_of_equal_baselines_the_one_with_more_success_before_safety_is_the_floor() -> None:
    def made(policy: str, success: int) -> list[TrialScore]:
        return [
            make_score("T1", seed, policy=policy, c3_success=seed < success, safety_gated=seed < 1) for seed in range(3)
        ]

    floor = best_beside("blind", [made("hover", 1), made("replay", 3), made("zero-action", 2)])
    assert floor is not None
    assert (floor.policy, floor.passes.whole.n, floor.seeds) == ("replay", 1, "0-2")
    assert best_beside("privileged", [made("hover", 1)]) is None


def test_missing_trials_are_refused(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (run / f"T3-s{SEED}.h5").unlink()
    assert f"1 of 7 planned trials have no recording: T3-s{SEED}; give its `carecontact run`" in refusal(capsys)
    edit(run / MANIFEST, lambda plan: plan["trials"].remove(f"T3-s{SEED}"))
    assert f"its plan lacks T3-s{SEED}; the exam is every task with seeds 1000, on" in refusal(capsys)


def test_another_release_is_refused(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for task in RULES.tasks:
        write_recording(
            made(task.id, versions={**package_versions(), "carecontact": "0.1.0"}), run / f"{task.id}-s{SEED}.h5"
        )
    write_scores(run, score_run(run))
    assert f"T1-s{SEED}.h5 is of another release (carecontact was 0.1.0, is {__version__})" in refusal(capsys)
    edit(run / MANIFEST, lambda plan: plan["identity"]["versions"].update(carecontact="0.1.0"))
    assert f"{MANIFEST} is of another release (carecontact was 0.1.0" in refusal(capsys)


def test_an_in_process_origin_is_refused(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for task in RULES.tasks:
        write_recording(made(task.id, origin="in-process"), run / f"{task.id}-s{SEED}.h5")
    write_scores(run, score_run(run))
    assert "was recorded in-process" in refusal(capsys)


def test_edited_scores_are_refused(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A stored score that contradicts nothing, with the hash of the recording, for a trial that failed."""

    def passes(results: Any) -> None:
        lost = next(trial for trial in results["trials"] if not trial["c3_success"])
        lost |= {"c3_success": True, "region_correct": True, "safety_gated": True, "failure_mode": None}

    edit(run / RESULTS_NAME, passes)
    message = refusal(capsys)
    assert "results.json does not follow from the recordings" in message
    assert "c3_success is True, and False when it is computed again" in message
    assert main(["report", "--rescore", "mine"]) == 0
    assert main(["submit", "mine", "--out", "board/arm.json", *GIVEN]) == 0


def test_a_shipped_policy_needs_no_link(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(SHIPPED, POLICY, SHIPPED["state-machine"])
    assert main(["submit", "mine", "--out", "board/arm.json", *GIVEN[:2], *GIVEN[4:]]) == 0
    assert json.loads(Path("board/arm.json").read_text())["link"] is None


@pytest.mark.parametrize("entry", ["bathing-wide-v2:0-26,990-1010", "bathing-wide-draft:1000"])
def test_exam_persons_in_training_are_refused(run: Path, capsys: pytest.CaptureFixture[str], entry: str) -> None:
    trial = f"T5-s{SEED}"
    card = read_recording(run / f"{trial}.h5").header.card
    assert card is not None
    rewritten(run, trial, card={**card, "trained_on": [entry]})
    assert f"trained on {entry}, as its card says, and {trial} is a trial of such a person" in refusal(capsys)


def test_other_refusals_name_what_is_valid(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "give vision or trained-on-simulation" in refusal(capsys, *GIVEN[:4])
    assert "--kind served: the policy ran in an isolated process" in refusal(capsys, *GIVEN[:4], "--kind", "served")
    link = [*GIVEN[:2], "--link", "javascript:alert(1)", *GIVEN[4:]]
    assert "--link javascript:alert(1): expected an address" in refusal(capsys, *link)
    assert "is not shipped; expected an address" in refusal(capsys, *GIVEN[:2], *GIVEN[4:])
    assert "--name <script>: expected at most 60" in refusal(capsys, "--name", "<script>", *GIVEN[2:])
    for change, words in (
        (lambda plan: plan.update(policy="oracle"), "oracle is registered as privileged"),
        (lambda plan: plan["protocol"].update(id="bathing-v3"), "no exam of the board; valid: bathing-"),
        (lambda plan: plan["protocol"].update(overrides={"physics.dt_s": "0.001"}), "(physics.dt_s = 0.001)"),
        (lambda plan: plan["protocol"].update(sha256="1" * 64), "other rules under the id bathing-wide-v2 L2"),
        (lambda plan: plan.update(salt_sha256="2" * 64), "another policy, protocol or salt than manifest.json"),
    ):
        kept = (run / MANIFEST).read_bytes()
        edit(run / MANIFEST, change)
        assert words in refusal(capsys)
        (run / MANIFEST).write_bytes(kept)
    (run / MANIFEST).unlink()
    assert "is not a run" in refusal(capsys)
