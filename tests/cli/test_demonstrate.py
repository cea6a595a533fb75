"""Demonstrations, their dataset and controls, as a user types them."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pyarrow.parquet as parquet
import pytest

from carecontact.cli import main
from carecontact.protocol.overrides import FAST_DT_S
from carecontact.protocol.protocol import TRAINING_SALT, TRAINING_SHA256
from carecontact.recording import read_recording
from carecontact.runs.scoring import read_scores
from tests.recording.test_lerobot import LEROBOT

POLICY = """
import numpy as np
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard

class Down:
    def __init__(self, *, trained_on: str = ""):
        given = (trained_on,) if trained_on else ()
        self.card = PolicyCard(name="down", modalities=("rgb",), control_hz=10, trained_on=given)

    def reset(self, instruction):
        self.left = 5

    def act(self, seen):
        self.left -= 1
        pose = seen.pose_tcp_in_base + np.array([0, 0, -0.005, 0, 0, 0, 0])
        return Action(pose_tcp_in_base=pose, done=self.left == 0)
"""
READER = Path(__file__).parents[1] / "recording" / "read_lerobot.py"
SHORT = ("--tasks", "T1", "--set", f"physics.dt_s={FAST_DT_S}", "--jobs", "1")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "down.py").write_text(POLICY)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (["--persons", "0"], "--persons 0: must be at least 1"),
        (["--noise", "8"], "--noise 8: expected 1mm to 99mm"),
        (["--noise", "0mm"], "--noise 0mm: expected 1mm to 99mm"),
        (["--dagger"], "--dagger: give another --policy, whose actions the oracle labels"),
        (["--dagger", "--policy", "hover", "--noise", "8mm"], "--dagger: give another --policy"),
        (["--policy", "hover+dagger"], "policy hover+dagger: name hover, and ask for dagger by the option"),
    ],
)
def test_mistakes_are_one_line(here: Path, options: list[str], why: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demonstrate", "--out", "d", *options]) == 2
    assert why in capsys.readouterr().err
    assert not Path("d").exists()


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (["--hz", "5"], "--hz belongs to --render"),
        (["--render", "overhead"], "--render overhead: expected CAMERA:PX"),
        (["--render", "attic:128"], "--render attic:128: expected CAMERA:PX"),
        (["--render", "overhead:129"], "--render overhead:129: expected CAMERA:PX"),
        (["--render", "overhead:128", "--hz", "0"], "--hz 0: expected 1 to 50"),
        (["--render", "overhead:128", "--with-force"], "--with-force does not go with --render"),
    ],
)
def test_mistakes_about_a_rendering_are_one_line(
    here: Path, options: list[str], why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "run").mkdir()
    from carecontact.recording import write_recording
    from tests.scoring.synthetic import touch

    write_recording(touch(seed=0), here / "run" / "T1-s000.h5")
    assert main(["export", "lerobot", "run", "--out", "d", *options]) == 2
    assert why in capsys.readouterr().err


def test_the_oracle_is_run_under_no_control(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--policy", "oracle", "--control", "frozen-look", "--out", "r"]) == 2
    assert "--control frozen-look: oracle is given the simulation" in capsys.readouterr().err


@pytest.mark.slow
def test_demonstrations_become_a_dataset_with_films(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demonstrate", "--policy", "down:Down", "--dagger", "--persons", "1", "--out", "d", *SHORT]) == 0
    recording = read_recording(Path("d/T1-s000.h5"))
    header = recording.header
    assert (header.origin, header.privileged) == ("training", True)
    assert (header.spec.policy, header.spec.salt, header.spec.salt_sha256) == ("down:Down+dagger", "", TRAINING_SHA256)
    assert recording["actions/demonstrated"].shape == (5, 8)
    capsys.readouterr()
    assert main(["demonstrate", "--policy", "down:Down", "--dagger", "--persons", "1", "--out", "d", *SHORT]) == 0
    assert "1 trial is finished already" in capsys.readouterr().out
    options = ["--render", "overhead:64,wrist:32", "--video", "h264", "--points", "20", "--jobs", "1"]
    assert main(["export", "lerobot", "d", "--out", "set", *options]) == 0
    info = json.loads(Path("set/meta/info.json").read_text())
    assert info["features"]["observation.images.wrist"]["shape"] == [32, 32, 3]
    assert (info["fps"], info["total_frames"]) == (10, 5)
    rows = parquet.read_table("set/data/chunk-000/file-000.parquet").to_pydict()
    action, label = np.array(rows["action"]), recording["actions/demonstrated"]
    np.testing.assert_allclose(action[:, [0, 1, 2, 7]], label[:, [0, 1, 2, 7]], atol=1e-6)
    np.testing.assert_allclose(np.abs(np.sum(action[:, 3:7] * label[:, 3:7], axis=1)), 1, atol=1e-6)
    executed = np.array(rows["action.executed"])
    np.testing.assert_allclose(executed[:, :3], recording["actions/pose_tcp_in_base"][:, :3], atol=1e-6)
    deltas = np.array(rows["action.delta"])[1:, :3]
    np.testing.assert_allclose(deltas, action[1:, :3] - executed[:-1, :3], atol=1e-6)
    assert Path("set/videos/observation.images.overhead/chunk-000/file-000.mp4").stat().st_size > 0
    assert TRAINING_SHA256 in Path("set/README.md").read_text()


@pytest.mark.slow
def test_a_control_lies_in_the_run_and_its_report_shows_it(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = ["run", "--policy", "down:Down", "--seeds", "0", "--out", "r", *SHORT]
    assert main(run) == 0
    capsys.readouterr()
    assert main([*run, "--control", "frozen-look"]) == 0
    assert "the control beside the policy without it: report: r/report.html" in capsys.readouterr().out
    recording = read_recording(Path("r/frozen-look/T1-s000.h5"))
    assert (recording.header.spec.policy, recording.header.origin) == ("down:Down+frozen-look", "isolated")
    frames = [recording[f"policy/frames/{k:04d}/overhead/rgb"] for k in (0, 4)]
    np.testing.assert_array_equal(*frames)
    assert "down:Down+frozen-look" in Path("r/report.html").read_text()
    assert main(["compare", "r", "r/frozen-look"]) == 0


@pytest.mark.slow
def test_a_run_on_persons_of_the_training_is_refused(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    policy = ["run", "--policy", "down:Down", "--policy-arg", "trained_on=bathing-wide-v2:0-3", *SHORT]
    assert main([*policy, "--seeds", "3", "--out", "r"]) == 2
    assert "down:Down was trained on bathing-wide-v2:0-3, as its card says" in capsys.readouterr().err
    salted = [f"trained_on={TRAINING_SALT}" if part.startswith("trained_on") else part for part in policy]
    assert main([*salted, "--seeds", "4", "--out", "r"]) == 2
    assert f"is the training salt itself; give its sha256, {TRAINING_SHA256}" in capsys.readouterr().err
    assert main([*policy, "--seeds", "4", "--out", "r"]) == 0
    assert "bathing-wide-v2:0-3" in Path("r/report.html").read_text()


@pytest.mark.slow
def test_the_actions_of_a_dataset_have_the_scores_of_the_demonstration(here: Path) -> None:
    assert main(["demonstrate", "--persons", "1", "--out", "d", *SHORT]) == 0
    assert main(["export", "lerobot", "d", "--out", "set", "--render", "overhead:16", "--hz", "20"]) == 0
    targets = np.array(parquet.read_table("set/data/chunk-000/file-000.parquet").to_pydict()["action"])[:, :7]
    task = parquet.read_table("set/meta/episodes/chunk-000/file-000.parquet")["tasks"][0].as_py()[0]
    actions = np.hstack([targets, np.full((len(targets), 2), np.nan)])
    np.savez("donor.npz", **{task: actions, f"{task}/camera": np.eye(4)})
    replay = ["demonstrate", "--policy", "replay", "--policy-arg", "donor=donor.npz", "--persons", "1", "--out", "r"]
    assert main([*replay, *SHORT]) == 0
    again, shown = (read_scores(Path(folder)).scores[0] for folder in ("r", "d"))
    assert again.safety_gated
    assert shown.safety_gated
    assert again.ended == shown.ended == "done"
    for metric in ("c1_peak_force_n", "c5_force_sd_n", "contact_s", "duration_s"):
        # A dataset holds single precision.
        assert getattr(again, metric) == pytest.approx(getattr(shown, metric), abs=0.01)


@pytest.mark.slow
@pytest.mark.skipif(LEROBOT is None, reason="CARECONTACT_LEROBOT_PYTHON names no Python that has lerobot")
def test_lerobot_reads_the_films_and_keeps_the_statistics_of_parts(here: Path) -> None:
    given = ["--policy", "down:Down", "--dagger", "--persons", "1", "--tasks", "T1,T2"]
    assert main(["demonstrate", "--out", "d", *given, *SHORT[2:]]) == 0
    for name, more in (("set", ["--video", "h264"]), ("exact", [])):
        assert main(["export", "lerobot", "d", "--out", name, "--render", "overhead:64", "--jobs", "1", *more]) == 0
    environment = {**os.environ, "HF_HUB_OFFLINE": "1", "HF_HOME": str(here / "cache")}
    for name in ("set", "exact"):
        subprocess.run([str(LEROBOT), str(READER), name, f"{name}.npz"], env=environment, check=True)
        (here / "parts").rename(here / f"parts-{name}")
    film, exact = np.load("set.npz"), np.load("exact.npz")
    assert (int(film["episodes"]), float(film["fps"])) == (2, 10)
    for name in ("observation.state", "action", "action.delta", "action.executed", "next.done", "person"):
        np.testing.assert_array_equal(film[name], exact[name])
    picture = "observation.images.overhead"
    assert film[picture].shape == exact[picture].shape == (10, 3, 64, 64)
    # Films lose a little.
    assert np.abs(film[picture] - exact[picture]).mean() < 0.02
    stats = json.loads(Path("set/meta/stats.json").read_text())
    for key in (picture, "observation.state", "action", "person"):
        for name in ("min", "max", "mean", "std", "count"):
            np.testing.assert_allclose(film[f"merged/{key}/{name}"], stats[key][name], rtol=1e-4, atol=1e-6)
