from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carecontact.cli import main
from carecontact.cli.check import Doctor
from carecontact.cli.groups import VisionGroup
from carecontact.cli.policy import with_vision
from carecontact.errors import ConfigError
from carecontact.interface.observation import MODALITIES, CameraView, Observation
from carecontact.interface.policy import CAMERAS
from carecontact.lab.validation import energy, probes, sensitivity, stability
from carecontact.lab.validation.result import CheckResult, Measure
from carecontact.protocol.load import load_protocol
from carecontact.protocol.sections import Vision
from carecontact.running import machine
from carecontact.running.machine import Finding
from carecontact.sensing import grounded_sam
from tests.sensing.test_segmentation import with_sam


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

    monkeypatch.setattr("carecontact.episode.episode.first_look", first_look)
    monkeypatch.chdir(tmp_path)
    assert main(["view", "--start", "--task", "T3", "--seed", "7", "--body", "man-old-light", "--tool", "mitt"]) == 0
    assert capsys.readouterr().out.startswith("start-T3-s007.png: T3 seed 7")
    assert Path("start-T3-s007.png").read_bytes().startswith(b"\x89PNG")
    card = asked.pop("card")
    changed = {"body": "man-old-light", "tool": "mitt"}
    assert asked == {"title": asked["title"], "task_id": "T3", "seed": 7, "weights": None, "salt": "", **changed}
    assert (card.modalities, card.cameras) == (MODALITIES, CAMERAS)
    assert main(["view", "--start", "--task", "T1", "--protocol", "bathing-wide-v2", "--level", "L2"]) == 0
    assert asked["title"] == "bathing-wide-v2 L2"


# What the doctor concludes and prints; the machine's own state is not asserted.


@pytest.mark.parametrize(("fine", "status"), [(True, 0), (False, 1)])
def test_exit_status_and_output(
    fine: bool, status: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    finding = Finding(name="x", fine=fine, detail="so it is", fix=None if fine else "do this")
    for name in ("check_python", "check_packages", "check_opengl", "check_pose", "check_assets"):
        monkeypatch.setattr(machine, name, lambda **_: finding)
    assert Doctor()() == status
    printed = capsys.readouterr().out
    assert ("install it with: do this" in printed) is not fine


@pytest.mark.parametrize(
    ("landlock", "namespaces", "user", "message"),
    [
        (7, True, 1000, ["ok   isolation  full: namespaces and Landlock\n"]),
        (7, True, 0, ["warn isolation  full: namespaces and Landlock; you are root, and so is every policy"]),
        (7, False, 1000, ["warn isolation  partial: Landlock without namespaces; run policies"]),
        (4, False, 1000, ["warn isolation  partial: ", "signals to the harness", "on another host"]),
        (0, True, 1000, ["warn isolation  partial: namespaces without Landlock"]),
        (0, False, 0, ["warn isolation  none: neither namespaces nor Landlock", "you are root"]),
    ],
)
def test_isolation_that_is_not_there_is_warned_of(
    landlock: int,
    namespaces: bool,
    user: int,
    message: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("carecontact.serving.fence.version", lambda: landlock)
    monkeypatch.setattr("carecontact.serving.fence.granted", lambda: namespaces)
    monkeypatch.setattr("os.geteuid", lambda: user)
    monkeypatch.setattr("carecontact.running.machine.findings", lambda: [machine.check_isolation()])
    assert Doctor()() == 0
    printed = capsys.readouterr().out
    assert all(part in printed for part in message)


def verdict(value: float) -> CheckResult:
    return CheckResult(
        check="energy", title=energy.TITLE, measures=(Measure(name="made up", value=value, unit="J", limit=1.0),)
    )


@pytest.mark.parametrize(
    ("value", "status", "word"), [(0.5, 0, "passed"), (1.5, 1, "FAILED"), (float("nan"), 1, "FAILED")]
)
def test_exit_status_and_record_follow_the_verdict(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path,
    value: float, status: int, word: str,
) -> None:  # fmt: skip
    monkeypatch.setattr(energy, "run", lambda subject, *, quick: verdict(value))
    monkeypatch.setattr(energy, "draw", lambda result, figure: figure.subplots())
    arguments = ["verify", "physics", "--quick", "--checks", "energy", "--out", str(tmp_path / "out")]
    assert main(arguments) == status
    printed = capsys.readouterr().out
    assert word in printed
    assert ("made up" in printed) is (status == 1)
    record = json.loads((tmp_path / "out" / "validation.json").read_text())
    assert record["passed"] is (status == 0)
    assert record["quick"] is True
    assert (tmp_path / "out" / "energy.png").is_file()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(["--checks", "energie"], "force-balance"), (["--checks", "energy,energy"], "each once"),
     (["--body", "absent"], "man-adult"), (["--protocol", "nothing"], "bathing-v3"),
     (["--fem"], "--fem runs no check")],
)  # fmt: skip
def test_a_wrong_name_is_one_line(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, arguments: list[str], message: str
) -> None:
    assert main(["verify", "physics", "--quick", "--out", str(tmp_path), *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert "Traceback" not in error
    assert not list(tmp_path.iterdir())


def test_misses_that_do_not_decide_are_counted(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setenv("COLUMNS", "140")
    shown = tuple(Measure(name=f"shown {v}", value=v, limit=1.0, decides=False) for v in (0.5, 1.5, 2.5))
    found = verdict(0.5)
    found = CheckResult(check="energy", title=found.title, measures=found.measures + shown)
    monkeypatch.setattr(energy, "run", lambda subject, *, quick: found)
    monkeypatch.setattr(energy, "draw", lambda result, figure: figure.subplots())
    assert main(["verify", "physics", "--quick", "--checks", "energy", "--out", str(tmp_path / "out")]) == 0
    assert "1 of 1 limits met; 2 of 3 that do not decide missed" in capsys.readouterr().out


def test_the_last_line_says_how_many_of_the_checks_that_ran_failed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    for module, value in ((energy, 0.5), (stability, 1.5), (sensitivity, 0.5)):
        monkeypatch.setattr(module, "run", lambda subject, *, quick, value=value: verdict(value))
        monkeypatch.setattr(module, "draw", lambda result, figure: figure.subplots())
    arguments = ["verify", "physics", "--quick", "--out", str(tmp_path / "out"), "--checks"]
    assert main([*arguments, "energy,stability,sensitivity"]) == 1
    assert capsys.readouterr().out.splitlines()[-1].startswith("FAILED: 2 of 3 checks passed, --checks left out 10; ")
    assert main([*arguments, "energy,sensitivity"]) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("passed: 2 of 2 checks passed, --checks left out 11; ")


@pytest.mark.parametrize(("steps", "status", "word"), [(4.0, 0, "pass"), (3.0, 1, "FAIL")])
def test_status_and_record_of_a_probe_follow_its_verdict(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path,
    steps: float, status: int, word: str,
) -> None:  # fmt: skip
    import numpy as np

    def made_up(subject: object, probe: probes.Probe) -> CheckResult:
        line = Measure(name="steps", value=steps, limit=4.0, side="at least")
        curve = np.stack([np.array(probe.levels), np.arange(len(probe.levels), dtype=float)])
        return CheckResult(check=probe.metric, title="made up", measures=(line,), curves={"scores": curve})

    monkeypatch.setattr(probes, "run", made_up)
    assert main(["verify", "metrics", "--metrics", "C1@1,C5@1", "--out", str(tmp_path / "out")]) == status
    assert f"{word}  C1@1  made up" in capsys.readouterr().out
    record = json.loads((tmp_path / "out" / "probe.json").read_text())
    assert record["passed"] is (status == 0)
    assert [row["check"] for row in record["probes"]] == ["C1@1", "C5@1"]
    assert (tmp_path / "out" / "probe.png").is_file()


@pytest.mark.parametrize("metrics", ["C3@1", "C1@1,C1@1", "", "C1,C1@1"])
def test_a_wrong_metric_is_one_line(metrics: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", "metrics", "--metrics", metrics, "--out", str(tmp_path / "out")]) == 2
    assert "valid: C1@1, C2@1, C4@1, C5@1" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


# --segmenter and --weights, on run and look.

RUN = ["run", "--policy", "hover", "--out", "r"]
LOOK = ["view", "--start", "--task", "T1"]


@pytest.mark.parametrize("command", [RUN, LOOK])
@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--weights", "w"], "--weights w: only --segmenter grounded-sam takes weights"),
        (["--segmenter", "mediapipe", "--weights", "w"], "--weights w: only --segmenter grounded-sam takes weights"),
        (["--segmenter", "grounded-sam"], "--segmenter grounded-sam: also give --weights DIR"),
        (["--segmenter", "grounded-sam", "--weights", "w"], "--weights w: no such folder; expected one with grounding"),
    ],
)
def test_what_does_not_fit_is_named_before_anything_runs(
    command: list[str], options: list[str], says: str, capsys: pytest.CaptureFixture[str], tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert main([*command, *options]) == 2
    assert says in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_protocol_that_names_weights_takes_no_others(weights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grounded_sam, "GroundedSam", lambda folder: None)
    own = with_vision(load_protocol("bathing-v3"), VisionGroup(segmenter="grounded-sam", weights=weights))
    assert own.vision.segmenter == "grounded-sam"
    assert with_vision(own, VisionGroup(segmenter=None, weights=weights)) == own
    assert with_vision(own, VisionGroup(segmenter="mediapipe", weights=None)).vision == Vision()
    other = with_sam("ab" * 32)
    with pytest.raises(ConfigError, match="names abababababab"):
        with_vision(other, VisionGroup(segmenter=None, weights=weights))
    assert with_vision(other, VisionGroup(segmenter="grounded-sam", weights=weights)) == own
