from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carecontact.cli import main
from carecontact.contract.observation import MODALITIES, CameraView, Observation
from carecontact.contract.policy import CAMERAS


def test_one_picture_of_every_camera(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: dict[str, Any] = {}

    def first_look(protocol: Any, **given: Any) -> Observation:
        asked.update(given, title=protocol.title, body=protocol.person.body, tool=protocol.scene.tool)
        view = CameraView(intrinsics=np.eye(3), pose_camera_in_base=np.eye(4), rgb=np.zeros((9, 12, 3), np.uint8))
        pose = np.r_[0.4, 0, 0.3, 1, 0, 0, 0]
        return Observation(
            instruction="x",
            sim_time_s=0.0,
            joint_position=np.zeros(7),
            joint_velocity=np.zeros(7),
            gripper_position=np.zeros(1),
            pose_tcp_in_base=pose,
            cameras={"wrist": view},
        )

    monkeypatch.setattr("carecontact.episode.first_look.first_look", first_look)
    monkeypatch.chdir(tmp_path)
    assert main(["look", "--task", "T3", "--seed", "7", "--body", "man-old-light", "--tool", "mitt"]) == 0
    assert capsys.readouterr().out.startswith("look-T3-s007.png: T3 seed 7")
    assert Path("look-T3-s007.png").read_bytes().startswith(b"\x89PNG")
    card = asked.pop("card")
    changed = {"body": "man-old-light", "tool": "mitt"}
    assert asked == {"title": asked["title"], "task_id": "T3", "seed": 7, "weights": None, "salt": "", **changed}
    assert (card.modalities, card.cameras) == (MODALITIES, CAMERAS)
    assert main(["look", "--task", "T1", "--protocol", "bathing-wide-v2-draft", "--level", "L2"]) == 0
    assert asked["title"] == "bathing-wide-v2-draft L2"
