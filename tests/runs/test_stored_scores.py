"""results.json is read in place of the recordings only while it belongs to them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from carecontact.errors import ConfigError
from carecontact.recording import Recording, write_recording
from carecontact.runs import score_run, write_scores
from carecontact.runs.scoring import read_scores, stale
from tests.scoring.synthetic import make_recording, push, touch


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_recording(touch(seed=0), tmp_path / "T1-s000.h5")
    write_recording(make_recording("T1", seed=1), tmp_path / "T1-s001.h5")
    (tmp_path / "T4-s000.h5").write_text("not a recording")
    write_scores(tmp_path, score_run(tmp_path))
    return tmp_path


def test_stored_scores_are_those_of_a_scoring(folder: Path) -> None:
    assert stale(folder, score_run(folder)) == []
    assert read_scores(folder) == read_scores(folder / "results.json") == read_scores(folder, rescore=True)


def test_they_are_read_and_not_computed(folder: Path) -> None:
    path = folder / "results.json"
    data = json.loads(path.read_text())
    data["trials"][0]["c4_motion_activity"] = 0.123
    path.write_text(json.dumps(data))
    assert read_scores(folder).scores[0].c4_motion_activity == 0.123
    assert read_scores(folder, rescore=True).scores[0].c4_motion_activity != 0.123


def add(folder: Path) -> None:
    write_recording(push(seed=0), folder / "T2-s000.h5")


def change(folder: Path) -> None:
    write_recording(touch(seed=0, force=9.0), folder / "T1-s000.h5")


def remove(folder: Path) -> None:
    (folder / "T1-s001.h5").unlink()


def cut(folder: Path) -> None:
    (folder / "T1-s000.h5").write_bytes((folder / "T1-s000.h5").read_bytes()[:-1])


def fix(folder: Path) -> None:
    recording = touch(seed=0)
    spec = recording.header.spec.model_copy(update={"task_id": "T4"})
    header = recording.header.model_copy(update={"spec": spec})
    write_recording(Recording(header=header, arrays=recording.arrays), folder / "T4-s000.h5")


def drop(folder: Path) -> None:
    (folder / "T4-s000.h5").unlink()


def misname(folder: Path) -> None:
    (folder / "T1-s002.H5").write_bytes(b"")


@pytest.mark.parametrize(
    ("happens", "reported"),
    [
        (add, "T2-s000.h5 was added"),
        (change, "T1-s000.h5 was changed"),
        (remove, "T1-s001.h5 is missing"),
        (cut, "T1-s000.h5 cannot be read"),
        (fix, "T4-s000.h5 was skipped and can be scored now"),
        (drop, "T4-s000.h5 is missing"),
        (misname, "T1-s002.H5 was added"),
    ],
)
def test_whatever_happened_since_is_named_with_the_command(folder: Path, happens, reported: str) -> None:
    happens(folder)
    with pytest.raises(ConfigError) as caught:
        read_scores(folder)
    message = str(caught.value)
    assert f"({reported})" in message
    assert f"`carecontact report --rescore {folder}`" in message
    assert "or add --rescore" not in message, "an option of some commands alone"
    assert "\n" not in message
    assert read_scores(folder, rescore=True) == score_run(folder)
    write_scores(folder, score_run(folder))
    assert read_scores(folder) == score_run(folder)


def test_several_differences_are_counted(folder: Path) -> None:
    add(folder)
    remove(folder)
    with pytest.raises(ConfigError, match=r"\(T2-s000\.h5 was added and 1 more\)"):
        read_scores(folder)


def test_recordings_without_a_result_and_a_result_without_recordings(folder: Path, tmp_path: Path) -> None:
    before = read_scores(folder)
    for path in folder.glob("*.h5"):
        path.unlink()
    assert read_scores(folder) == before
    (folder / "results.json").unlink()
    with pytest.raises(ConfigError, match="holds neither recordings"):
        read_scores(folder)
    add(folder)
    with pytest.raises(ConfigError, match=r"no results\.json; run `carecontact report --rescore "):
        read_scores(folder)
    assert len(read_scores(folder, rescore=True).scores) == 1
    with pytest.raises(ConfigError, match="no such folder"):
        read_scores(folder / "nowhere")


def test_what_the_manifest_plans_is_missed_though_the_result_does_not_know_it(folder: Path) -> None:
    score = score_run(folder).scores[0]
    plan = {
        "schema": "carecontact-run-1",
        "purpose": "run",
        "policy": score.policy,
        "protocol": {"id": score.protocol_id, "sha256": score.protocol_sha256},
        "identity": {"policy_sha256": None, "versions": {}, "sha256": {}},
        "trials": ["T1-s000", "T1-s001", "T2-s000"],
    }
    (folder / "manifest.json").write_text(json.dumps(plan))
    assert read_scores(folder) == replace(score_run(folder), missing=("T2-s000",))
