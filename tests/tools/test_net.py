"""The net finds what differs between two runs, and two runs of one revision are equal bit for bit."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tools.net import ROOT, main

from carecontact.recording import Recording, write_recording
from tests.scoring.synthetic import touch

FORCE, WALL = "scorer/force_human_from_robot_in_world", "wall/seconds"


def stored(folder: Path, *, seed: int = 0, score: float = 1.0, **arrays: np.ndarray) -> str:
    folder.mkdir()
    recording = touch(seed=0)
    spec = recording.header.spec.model_copy(update={"seed": seed})
    changed = replace(recording, header=recording.header.model_copy(update={"spec": spec}))
    timed = {**changed.arrays, WALL: np.array([float(len(str(folder)))]), **arrays}
    write_recording(Recording(header=changed.header, arrays=timed), folder / "T1-s000.h5")
    (folder / "results.json").write_text(json.dumps({"trials": [{"c1": score}]}))
    return str(folder)


def test_equal_runs_are_equal_whatever_time_they_took(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--runs", stored(tmp_path / "a"), stored(tmp_path / "another")]) == 0
    assert capsys.readouterr().out == "0 differences that are not allowed, and 0 that are\n"


def test_each_difference_is_named_by_its_place(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    force = touch(seed=0).arrays[FORCE].copy()
    force[-1, 0, 0] += np.float32(2**-20)
    runs = ["--runs", stored(tmp_path / "a"), stored(tmp_path / "b", seed=1, score=2.0, **{FORCE: force})]
    assert main(runs) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "results/trials/0/c1: 1.0 != 2.0"
    assert "T1-s000/header/spec/seed: 0 != 1" in lines
    assert f"T1-s000/{FORCE}: 1 of {force.size} numbers differ" in lines
    assert main([*runs, "--allow", "results/*", "--allow", "T1-s000/header/*"]) == 1
    assert capsys.readouterr().out.splitlines()[1:] == ["1 differences that are not allowed, and 2 that are"]


def test_a_trial_that_one_run_lacks_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runs = [stored(tmp_path / "a"), stored(tmp_path / "b")]
    (tmp_path / "b" / "T1-s000.h5").unlink()
    assert main(["--runs", *runs]) == 1
    assert capsys.readouterr().out.startswith(f"T1-s000: only in {tmp_path / 'a'}\n")


def test_two_runs_of_this_revision_are_equal_bit_for_bit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(ROOT), "--short", "--out", str(tmp_path)]) == 0, capsys.readouterr().out
    assert len(list(tmp_path.glob("*/*/*.h5"))) == 6
