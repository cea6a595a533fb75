"""Parts of a run over workers that only write recordings, and their merge."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from carecontact.cli import main
from carecontact.recording import Recording, read_recording, write_recording

WHOLE = ["run", "--policy", "hover", "--tasks", "T1,T2", "--seeds", "0-1", "--protocol", "bathing-v3"]


def part(k: int, *, policy: str = "hover") -> list[str]:
    return ["run", "--policy", policy, *WHOLE[3:], "--shard", f"{k}/4", "--out", f"part-{k}"]


@pytest.fixture
def first(fake: pytest.MonkeyPatch) -> None:
    assert main(part(1)) == 0


@pytest.fixture
def parts(first: None) -> list[str]:
    for k in range(2, 5):
        assert main(part(k)) == 0
    return [f"part-{k}" for k in range(1, 5)]


def test_four_parts_are_one_run_bit_for_bit(parts: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*WHOLE, "--out", "whole"]) == 0
    assert main(["merge", "merged", *parts]) == 0
    assert "4 parts: 4 recordings copied into merged\n" in capsys.readouterr().out
    whole, merged = ({path.name: path for path in Path(name).iterdir()} for name in ("whole", "merged"))
    assert set(whole) == set(merged) >= {"T1-s000.h5", "T2-s001.h5", "results.json", "manifest.json", "report.html"}
    different = [name for name in whole if whole[name].read_bytes() != merged[name].read_bytes()]
    assert different == []
    assert main([*WHOLE, "--out", "merged"]) == 0, "and the run goes on there"
    assert "4 trials are finished already" in capsys.readouterr().out


def test_an_unfinished_part_is_named_and_a_later_merge_completes(
    parts: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    Path("part-4/T2-s001.h5").unlink()
    assert main(["merge", "merged", *parts]) == 1
    assert "no verdict on 1 planned trial, no recording: T2-s001" in capsys.readouterr().out
    assert main(part(4)) == 0
    assert main(["merge", "merged", "part-4"]) == 0
    assert "1 part: 1 recording copied into merged, 3 were there already" in capsys.readouterr().out
    assert json.loads(Path("merged/results.json").read_text())["missing"] == []


def test_a_part_that_was_forgotten_is_missing(parts: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["merge", "merged", *parts[:3]]) == 1
    assert "no verdict on 1 planned trial, no recording: T2-s001" in capsys.readouterr().out
    assert main(["merge", "merged", parts[3]]) == 0
    assert main([*WHOLE, "--out", "whole"]) == 0
    assert Path("merged/manifest.json").read_bytes() == Path("whole/manifest.json").read_bytes()


def other_recording() -> None:
    recording = read_recording("part-1/T1-s000.h5")
    header = recording.header.model_copy(update={"embodiment": "another"})
    shutil.copytree("part-1", "again")
    write_recording(Recording(header=header, arrays=recording.arrays), "again/T1-s000.h5")


def in_process() -> None:
    recording = read_recording("part-1/T1-s000.h5")
    header = recording.header.model_copy(update={"origin": "in-process"})
    shutil.copytree("part-1", "again")
    write_recording(Recording(header=header, arrays=recording.arrays), "again/T1-s000.h5")


def other_policy() -> None:
    assert main([*part(2, policy="zero-action")[:-1], "again"]) == 0


def other_protocol() -> None:
    assert main([*part(2)[:-1], "again", "--stiffness", "300"]) == 0


def other_release() -> None:
    shutil.copytree("part-1", "again")
    manifest = json.loads(Path("again/manifest.json").read_text())
    manifest["identity"]["versions"]["mujoco"] = "9.9.9"
    Path("again/manifest.json").write_text(json.dumps(manifest))


def misnamed() -> None:
    shutil.copytree("part-1", "again")
    shutil.move("again/T1-s000.h5", "again/T2-s000.h5")
    manifest = Path("again/manifest.json")
    manifest.write_text(manifest.read_text().replace("T1-s000", "T2-s000"))


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (other_recording, "part-1/T1-s000.h5 and again/T1-s000.h5 are different recordings of one trial"),
        (in_process, "again/T1-s000.h5 was recorded in-process: an Episode in somebody's own program made it"),
        (other_policy, "part-1 and again are not parts of one run: different policies, hover and zero-action"),
        (other_protocol, "not parts of one run: different protocols, bathing-v3 "),
        (other_release, "not parts of one run: different versions, mujoco 4.0.0 and mujoco 9.9.9"),
        (misnamed, "again/T2-s000.h5 holds trial T1-s000"),
        (lambda: Path("again").mkdir(), "again is not a run: it holds no manifest.json"),
    ],
)
def test_what_is_no_part_of_the_run_is_refused_and_nothing_copied(
    first: None, capsys: pytest.CaptureFixture[str], made: Callable[[], None], message: str
) -> None:
    made()
    assert main(["merge", "merged", "part-1", "again"]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not Path("merged").exists()


def test_places_that_cannot_be_merged_are_one_line(first: None, capsys: pytest.CaptureFixture[str]) -> None:
    Path("notes").mkdir()
    Path("notes/mine.txt").write_text("mine")
    for arguments, message in (
        (["merged", "part-1", "part-1"], "part-1 is given twice"),
        (["part-1", "part-1", "part-2"], "part-1 is the folder to write and one of the parts"),
        (["notes", "part-1"], "notes is not a run, and it is not empty"),
        (["notes/mine.txt", "part-1"], "this is a file"),
    ):
        assert main(["merge", *arguments]) == 2
        assert message in capsys.readouterr().err
    assert main(["merge", "merged"]) == 2
    assert {path.name for path in Path("notes").iterdir()} == {"mine.txt"}
