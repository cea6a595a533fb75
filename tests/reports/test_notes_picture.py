from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carecontact.cli import main
from carecontact.contract.trial import TrialSpec
from carecontact.errors import ConfigError
from carecontact.protocols import load_protocol
from carecontact.recording import write_recording
from carecontact.recording.schema import Recording
from carecontact.reports.notes_picture import draw_notes
from carecontact.trials.failed import harness_error_recording

OPTION = {"primitive": "touch", "approach": "above", "key_point": 0.5, "depth_m": 0.012, "speed_m_s": 0.03}
OPTIONS = {
    "method": "state-machine", "camera": "overhead", "chosen": 1,
    "intent": {"action": "touch", "region": "forearm", "side": "right", "manner": "gentle"},
    "options": [{**OPTION, "corners_px": [[20.0, 30.0]]}, {**OPTION, "corners_px": [[40.0, 30.0], [40.0, 35.0]]}],
}  # fmt: skip
CAMERA = [[60.0, 0.0, 40.0], [0.0, 60.0, 30.0], [0.0, 0.0, 1.0]]
LOOKING_DOWN = [[0, -1, 0, 0.5], [-1, 0, 0, 0.0], [0, 0, -1, 2.0], [0, 0, 0, 1]]
MAPS = {
    "method": "voxposer", "camera": "overhead", "subtask": "move there", "plan": 1, "target_m": [0.5, 0.0, 0.1],
    "path_m": [[0.2, 0.0, 0.5], [0.5, 0.0, 0.1]], "path_px": [[40.0, 42.0], [40.0, 30.0]],
    "grid": {"low_m": [0.0, -0.6, 0.0], "high_m": [1.0, 0.6, 0.75], "level": 13, "upright": 50},
    "intrinsics": CAMERA, "pose_camera_in_base": LOOKING_DOWN,
    "language": [{"backend": "replay:0123:authored", "purpose": "planner: x"}],
}  # fmt: skip


def recording(content: dict[str, Any], **arrays: np.ndarray) -> Recording:
    spec = TrialSpec(protocol=load_protocol(), task_id="T1", seed=0, policy="x")
    base = harness_error_recording(spec, kind="x", message="x")
    place = "policy/notes/0000"
    kept = {f"{place}/{name}": array for name, array in arrays.items()}
    kept[f"{place}/json"] = np.frombuffer(json.dumps(content).encode(), "u1")
    kept["policy/frames/0000/overhead/rgb"] = np.full((60, 80, 3), 128, np.uint8)
    return Recording(header=base.header, arrays=base.arrays | kept)


def slices() -> dict[str, np.ndarray]:
    ramp = np.linspace(0, 1, 100)[:, None] * np.ones(100)
    return {f"{name}_level": ramp.astype("<f2") for name in ("cost", "distance", "avoidance")} | {
        "cost_upright": ramp.astype("<f2")
    }


def test_options_are_drawn_with_the_chosen_one_bold() -> None:
    figure = draw_notes(recording(OPTIONS))
    lines = figure.axes[0].get_lines()
    assert len(lines) == 2
    assert [line.get_linewidth() > 2 for line in lines] == [False, True]
    assert any("chosen    1 of 0-1" in text.get_text() for text in figure.texts)
    assert any("“gently touch the right forearm”" in text.get_text() for text in figure.texts)


def test_a_level_slice_lies_where_the_camera_sees_it() -> None:
    figure = draw_notes(recording(MAPS, **slices()))
    values = np.asarray(figure.axes[0].get_images()[1].get_array().filled(np.nan))
    assert values.shape == (60, 80)
    # Straight down: the picture's middle is x = 0.5, x grows up the picture, and beside the workspace is nothing.
    assert values[30, 40] == pytest.approx(0.5, abs=0.02)
    assert values[20, 40] > values[30, 40] > values[40, 40]
    assert np.isnan(values[0, 0])
    assert any("replay:0123:authored" in text.get_text() for text in figure.texts)


def test_a_recording_without_such_notes_says_so() -> None:
    with pytest.raises(ConfigError, match="T1-s000 has no notes to draw: nobody was found"):
        draw_notes(recording({"method": "voxposer", "ended_because": "nobody was found"}))


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    write_recording(recording(OPTIONS), tmp_path / "T1-s000.h5")
    assert main(["notes", "T1-s000.h5"]) == 0
    assert Path("notes-T1-s000.png").read_bytes().startswith(b"\x89PNG")
    assert main(["notes", "T1-s000.h5", "--out", "x.txt"]) == 2
    assert "a picture ends in" in capsys.readouterr().err
