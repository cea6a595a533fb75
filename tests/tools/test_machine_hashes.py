from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from tools.machine_hashes import machine, main

from carecontact.recording import Recording, write_recording
from tests.scoring.synthetic import touch

FORCE, WALL = "scorer/force_human_from_robot_in_world", "wall/seconds"


def stored(folder: Path, **changed: np.ndarray) -> Path:
    folder.mkdir()
    recording = touch(seed=0)
    arrays = {**recording.arrays, WALL: np.array([float(len(str(folder)))]), **changed}
    write_recording(Recording(header=recording.header, arrays=arrays), folder / "T1-s000.h5")
    return folder


def test_equal_runs_are_equal_whatever_time_they_took(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one, other, file = stored(tmp_path / "a"), stored(tmp_path / "another"), tmp_path / "hashes.json"
    assert main(["write", str(one), str(file)]) == 0
    assert json.loads(file.read_text())["machine"] == machine()
    assert {"renderer", "opengl", "machine", "arithmetic"} <= machine().keys()
    for with_what in (file, one):
        assert main(["compare", str(other), str(with_what)]) == 0
        assert capsys.readouterr().out.endswith("equal\n")


def test_the_last_bit_of_one_number_is_named_and_measured(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    force = touch(seed=0).arrays[FORCE].copy()
    force[-1, 0, 0] += np.float32(0.25)
    one, other, file = stored(tmp_path / "a"), stored(tmp_path / "b", **{FORCE: force}), tmp_path / "hashes.json"
    main(["write", str(one), str(file)])
    assert main(["compare", str(other), str(file)]) == 1
    assert f"T1-s000: {FORCE} differs\n1 difference: " in capsys.readouterr().out
    assert main(["compare", str(other), str(one)]) == 1
    assert f"T1-s000: {FORCE}: 1 of {force.size} values differ, by at most 0.25\n" in capsys.readouterr().out


def test_a_recording_that_one_side_lacks_is_a_difference(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one, other = stored(tmp_path / "a"), stored(tmp_path / "b")
    (other / "T1-s000.h5").rename(other / "T2-s000.h5")
    assert main(["compare", str(one), str(other)]) == 1
    assert "T1-s000: only one of the two has it\nT2-s000: only one" in capsys.readouterr().out
