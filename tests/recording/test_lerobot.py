"""Recordings as a LeRobotDataset: what is in it, what is not, and that lerobot reads it."""

from __future__ import annotations

import io
import json
import os
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as parquet
import pytest
from PIL import Image

from carecontact.cli import main
from carecontact.errors import RecordingError
from carecontact.recording import Recording, write_recording
from carecontact.recording.lerobot import episode_of
from carecontact.recording.pictures import MAX_FRAMES, PictureLog, Pictures
from carecontact.runs import score_run, write_scores
from tests.scoring.synthetic import make_recording, push, touch

LEROBOT = os.environ.get("CARECONTACT_LEROBOT_PYTHON")
"""A Python that has lerobot 0.4 or later, which cannot be installed beside carecontact's own packages."""


def seen(recording: Recording, *, actions: int = 6) -> Recording:
    """The recording as of a policy that was shown two images and chose its first four actions after the first."""
    rng = np.random.default_rng(recording.header.spec.seed)
    arrays: dict[str, Any] = dict(recording.arrays)
    arrays["policy/observation_time_s"] = np.array([1.0, 1.3])
    arrays["policy/observation_sha256"] = np.zeros((2, 32), np.uint8)
    arrays["actions/time_s"] = 1.0 + 0.1 * np.arange(actions)
    arrays["actions/observation_index"] = np.repeat([0, 1], [4, actions - 4]).astype(np.int32)
    poses = np.tile([0.4, 0.0, 0.3, 0.0, 1.0, 0.0, 0.0], (actions, 1))
    poses[:, 0] += 0.01 * np.arange(actions)
    poses[2] = np.nan
    arrays["actions/pose_tcp_in_base"] = poses
    arrays["actions/stiffness"] = np.tile([400.0, 20.0], (actions, 1))
    for index in (0, 1):
        arrays[f"policy/frames/{index:04d}/overhead/rgb"] = rng.integers(0, 256, (48, 64, 3), np.uint8)
    card = {"name": "p", "cameras": ["overhead"], "modalities": ["rgb"], "control_hz": 10.0}
    return Recording(header=recording.header.model_copy(update={"card": card}), arrays=arrays)


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run").mkdir()
    for recording in (seen(touch(seed=0)), seen(push(seed=0))):
        write_recording(recording, tmp_path / "run" / f"{recording.header.spec.trial_id}.h5")
    write_scores(tmp_path / "run", score_run(tmp_path / "run"))
    return tmp_path


def test_rows_have_what_the_policy_saw_and_did(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", "lerobot", "run", "--out", "d"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "T1-s000: 6 rows at 10 fps",
        "T2-s000: 6 rows at 10 fps",
        "dataset: d",
    ]
    info = json.loads(Path("d/meta/info.json").read_text())
    assert (info["codebase_version"], info["fps"], info["total_episodes"], info["total_frames"]) == ("v3.0", 10, 2, 12)
    table = parquet.read_table("d/data/chunk-000/file-001.parquet")
    assert table.column_names == [key for key in table.column_names if key in info["features"]]
    assert set(table.column_names) == set(info["features"])
    assert table["index"].to_pylist() == list(range(6, 12))
    assert np.allclose(table["timestamp"].to_pylist(), 0.1 * np.arange(6))
    assert np.allclose(table["observation.age_s"].to_pylist(), [0, 0.1, 0.2, 0.3, 0.1, 0.2])
    action = np.array(table["action"].to_pylist())
    assert np.allclose(action[:, 0], [0.4, 0.41, 0.41, 0.43, 0.44, 0.45]), "without a target, the last one holds"
    original = seen(push(seed=0))
    for row, png in enumerate(table["observation.images.overhead"].to_pylist()):
        image = np.asarray(Image.open(io.BytesIO(png["bytes"])))
        assert (image == original[f"policy/frames/{int(row >= 4):04d}/overhead/rgb"]).all()


def recomputed(episodes: range) -> dict[str, dict[str, np.ndarray]]:
    """The statistics of some episodes of the dataset ``d``, from its rows and images."""
    tables = [parquet.read_table(f"d/data/chunk-000/file-{k:03d}.parquet") for k in episodes]
    stats: dict[str, dict[str, np.ndarray]] = {}
    for name in tables[0].column_names:
        rows = [row for table in tables for row in table[name].to_pylist()]
        if name.startswith("observation.images."):
            images = np.stack([np.asarray(Image.open(io.BytesIO(row["bytes"]))) for row in rows])
            values = images.reshape(-1, 3) / 255
        else:
            values = np.array(rows, float).reshape(len(rows), -1)
        found = {"min": values.min(0), "max": values.max(0), "mean": values.mean(0), "std": values.std(0)}
        for q in (1, 10, 50, 90, 99):
            method = "inverted_cdf" if "images" in name else "linear"
            found[f"q{q:02d}"] = np.quantile(values, q / 100, axis=0, method=method)
        shape = (3, 1, 1) if "images" in name else (-1,)
        stats[name] = {key: value.reshape(shape) for key, value in found.items()} | {"count": np.array([len(rows)])}
    return stats


def assert_equal(found: dict[str, Any], expected: dict[str, dict[str, np.ndarray]]) -> None:
    assert {key: set(found[key]) for key in found} == {key: set(expected[key]) for key in expected}
    for key, stats in expected.items():
        for name, value in stats.items():
            np.testing.assert_allclose(np.array(found[key][name]), value, atol=1e-9, err_msg=f"{key} {name}")
            assert np.shape(found[key][name]) == value.shape, (key, name)


def test_every_episode_has_the_statistics_from_which_lerobots_tools_make_those_of_a_part(run: Path) -> None:
    assert main(["export", "lerobot", "run", "--out", "d"]) == 0
    assert_equal(json.loads(Path("d/meta/stats.json").read_text()), recomputed(range(2)))
    table = parquet.read_table("d/meta/episodes/chunk-000/file-000.parquet")
    kinds = {f.name: str(f.type).replace("item", "element") for f in table.schema if f.name.startswith("stats/")}
    numbers, image = "list<element: double>", "list<element: list<element: list<element: double>>>"
    assert {kind for name, kind in kinds.items() if name.endswith("/count")} == {"list<element: int64>"}
    kinds = {name: kind for name, kind in kinds.items() if not name.endswith("/count")}
    assert set(kinds.values()) == {numbers, image}
    assert all((kind == image) == name.startswith("stats/observation.images.") for name, kind in kinds.items())
    for episode, row in enumerate(table.to_pylist()):
        found: dict[str, Any] = {}
        for name in kinds:
            _, feature, key = name.split("/")
            found.setdefault(feature, {"count": row[f"stats/{feature}/count"]})[key] = row[name]
        assert_equal(found, recomputed(range(episode, episode + 1)))


def test_the_format_v21_has_a_line_for_each_episode_and_tells_which_columns_are_images(run: Path) -> None:
    assert main(["export", "lerobot", "run", "--out", "d"]) == 0
    assert main(["export", "lerobot", "--form", "v2.1", "run", "--out", "e"]) == 0
    info, of_v3 = (json.loads(Path(f"{name}/meta/info.json").read_text()) for name in ("e", "d"))
    assert (info["codebase_version"], info["total_chunks"], info["total_videos"]) == ("v2.1", 1, 0)
    assert {key: info[key] for key in ("fps", "features", "total_frames")} == {
        key: of_v3[key] for key in ("fps", "features", "total_frames")
    }
    episodes, stats, tasks = (
        [json.loads(line) for line in Path(f"e/meta/{name}.jsonl").read_text().splitlines()]
        for name in ("episodes", "episodes_stats", "tasks")
    )
    prompts = ["gently touch the right forearm", "push the right forearm"]
    assert episodes == [{"episode_index": k, "tasks": [prompts[k]], "length": 6} for k in range(2)]
    assert tasks == [{"task_index": k, "task": prompts[k]} for k in range(2)]
    for k, line in enumerate(stats):
        assert line["episode_index"] == k
        assert_equal(line["stats"], recomputed(range(k, k + 1)))
        table = parquet.read_table("e/" + info["data_path"].format(episode_chunk=0, episode_index=k))
        assert table.to_pylist() == parquet.read_table(f"d/data/chunk-000/file-{k:03d}.parquet").to_pylist()
        kinds = json.loads(table.schema.metadata[b"huggingface"])["info"]["features"]
        assert set(kinds) == set(info["features"])
        assert [key for key, kind in kinds.items() if kind["_type"] == "Image"] == ["observation.images.overhead"]


def late(latency_s: float, index: list[int], *, control_hz: float = 10.0) -> Recording:
    """A recording whose policy took the latency before the first action of each answer."""
    recording = seen(touch(seed=0))
    spec = recording.header.spec
    phases = spec.protocol.phases.model_copy(update={"latency_s": latency_s})
    protocol = spec.protocol.model_copy(update={"phases": phases})
    card = {**(recording.header.card or {}), "control_hz": control_hz}
    header = recording.header.model_copy(update={"spec": spec.model_copy(update={"protocol": protocol}), "card": card})
    waits = latency_s * (1 + np.array(index))
    # As the episode does it: every action begins at a whole physics step of 2 ms.
    times_s = np.floor((np.arange(len(index)) / control_hz + waits) * 500 + 1e-6) / 500
    answered = {"actions/time_s": 1 + times_s, "actions/observation_index": np.array(index, np.int32)}
    return replace(recording, header=header, arrays={**recording.arrays, **answered})


@pytest.mark.parametrize(
    ("latency_s", "index", "control_hz", "fps"),
    [
        (0.0, [0, 0, 0, 0, 1, 1], 15.0, "15"),
        (0.0, [0, 0, 0, 0, 1, 1], 12.5, "12.5"),
        (0.3, [0, 0, 0, 0, 0, 0], 20.0, "20"),
        (0.1, [0, 1, 1, 1, 1, 1], 10.0, None),
        (0.0, [0, 1, 2, 3, 4, 5], 10.0, "10"),
        (0.1, [0, 1, 2, 3, 4, 5], 10.0, "5"),
        (0.2, [0, 1, 2, 3, 4, 5], 15.0, "3.75"),
    ],
)
def test_the_rate_is_that_at_which_the_actions_began(
    latency_s: float, index: list[int], control_hz: float, fps: str | None
) -> None:
    recording = late(latency_s, index, control_hz=control_hz)
    if fps is None:
        with pytest.raises(
            RecordingError, match=r"T1-s000: its actions are 0.1 to 0.2 s apart, .* without --latency-ms"
        ):
            episode_of(recording)
        return
    frames = {f"policy/frames/{k:04d}/overhead/rgb": np.zeros((4, 4, 3), np.uint8) for k in index}
    times = {"policy/observation_time_s": np.ones(6), "policy/observation_sha256": np.zeros((6, 32), np.uint8)}
    recording = replace(recording, arrays={**recording.arrays, **frames, **times})
    assert json.dumps(episode_of(recording).fps) == fps


def test_no_quantity_of_the_scorer_is_exported_unless_asked_for(run: Path) -> None:
    assert main(["export", "lerobot", "run", "--out", "d"]) == 0
    features = json.loads(Path("d/meta/info.json").read_text())["features"]
    assert set(features) == {
        "action",
        "observation.state",
        "observation.age_s",
        "observation.images.overhead",
        "timestamp",
        "frame_index",
        "episode_index",
        "index",
        "task_index",
    }
    assert main(["export", "lerobot", "run", "--out", "e", "--with-force"]) == 0
    features = json.loads(Path("e/meta/info.json").read_text())["features"]
    assert "right_forearm" in features["scorer.force"]["names"]
    force = np.array(parquet.read_table("e/data/chunk-000/file-000.parquet")["scorer.force"].to_pylist())
    assert force.max() > 0


def test_the_state_is_the_tools_pose_in_the_robots_base() -> None:
    recording = seen(touch(seed=0))
    turned = recording.header.model_copy(update={"pose_base_in_world": [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]})
    poses = np.tile(np.array([1.5, 2.25, 3.1, 1, 0, 0, 0], np.float32), (len(recording["scorer/time_s"]), 1))
    found = episode_of(
        replace(recording, header=turned, arrays={**recording.arrays, "scorer/pose_tcp_in_world": poses})
    )
    position, quat = np.split(found.streams["observation.state"].values[0], [3])
    assert np.allclose(position, [-0.5, -0.25, 0.1], atol=1e-6), "half a turn about z"
    assert np.allclose(np.abs(quat), [0, 0, 0, 1], atol=1e-6)


def looked(recording: Recording, *, actions: int = 150) -> Recording:
    """The recording as of a policy that chose each action after an observation of its own, at 10 Hz: the overhead
    camera took a view for each but every third, that of the wrist for each tenth."""
    rng, log = np.random.default_rng(0), PictureLog()
    arrays: dict[str, Any] = dict(seen(recording, actions=actions).arrays)
    arrays = {path: array for path, array in arrays.items() if not path.startswith("policy/frames/")}
    times = 0.1 * np.arange(actions)
    arrays |= {"policy/observation_time_s": times, "actions/time_s": times + 0.02}
    arrays["policy/observation_sha256"] = np.zeros((actions, 32), np.uint8)
    arrays["actions/observation_index"] = np.arange(actions, dtype=np.int32)
    arrays["policy/looked"] = np.zeros((actions, 4), np.uint8)
    for k in range(actions):
        for column, camera, new in ((0, "overhead", k % 3 != 2), (3, "wrist", k % 10 == 0)):
            if new:
                arrays["policy/looked"][k, column] = 1
                log.add(k, camera, "rgb", rng.integers(0, 256, (6, 8, 3), np.uint8))
    card = {"name": "p", "cameras": ["overhead", "wrist"], "modalities": ["rgb"], "control_hz": 10.0}
    card["camera_hz"] = {"overhead": 7.0, "wrist": 1.0}
    header = recording.header.model_copy(update={"card": card})
    return Recording(header=header, arrays=arrays | log.arrays())


def test_a_long_episode_is_exported_whole_with_the_last_view_of_each_camera_and_its_age(run: Path) -> None:
    recording = looked(touch(seed=0))
    pictures = Pictures(recording)
    assert len(pictures) == 100 + 15 > MAX_FRAMES
    write_recording(recording, run / "run" / "T1-s000.h5")
    (run / "run" / "T2-s000.h5").unlink()
    assert main(["export", "lerobot", "run", "--out", "d"]) == 0
    table = parquet.read_table("d/data/chunk-000/file-000.parquet")
    assert len(table) == 150
    last = {"overhead": [k - (k % 3 == 2) for k in range(150)], "wrist": [k - k % 10 for k in range(150)]}
    for camera, indices in last.items():
        for row, index in zip(table[f"observation.images.{camera}"].to_pylist(), indices, strict=True):
            assert (np.asarray(Image.open(io.BytesIO(row["bytes"]))) == pictures[index, camera, "rgb"]).all()
    ages = np.array(table["observation.view_age_s"].to_pylist())
    expected = 0.02 + 0.1 * (np.arange(150)[:, None] - np.array([last["overhead"], last["wrist"]]).T)
    np.testing.assert_allclose(ages, expected, atol=1e-5)
    info = json.loads(Path("d/meta/info.json").read_text())
    assert info["features"]["observation.view_age_s"]["names"] == ["overhead", "wrist"]
    # A view is new where it is as old as its observation.
    new = ages == np.array(table["observation.age_s"].to_pylist())[:, None]
    assert (new == recording["policy/looked"][:, [0, 3]]).all()


def test_noisy_encoders_are_not_exported_without_their_noise() -> None:
    recording = seen(touch(seed=0))
    spec = recording.header.spec
    noisy = spec.protocol.model_copy(
        update={"variation": spec.protocol.variation.model_copy(update={"encoder_noise_rad": 0.01})}
    )
    header = recording.header.model_copy(update={"spec": spec.model_copy(update={"protocol": noisy})})
    assert "observation.state" not in episode_of(replace(recording, header=header)).streams


def test_a_trial_that_cannot_be_exported_is_named(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lost = seen(touch(seed=1))
    arrays = {path: array for path, array in lost.arrays.items() if path != "policy/frames/0001/overhead/rgb"}
    write_recording(replace(lost, arrays=arrays), run / "run" / "T1-s001.h5")
    write_recording(touch(seed=2), run / "run" / "T1-s002.h5")
    assert main(["export", "lerobot", "run", "--out", "d"]) == 1
    message = capsys.readouterr().out
    assert "left out: T1-s001: the recording does not hold the image of overhead at observation 1" in message
    assert "left out: T1-s002: the policy did no action" in message
    assert json.loads(Path("d/meta/info.json").read_text())["total_episodes"] == 2


def test_mistakes_are_one_line(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", "lerobot", "run", "--out", "run"]) == 2
    assert main(["export", "lerobot", "nowhere", "--out", "d"]) == 2
    other = seen(touch(seed=3))
    other.header.card["cameras"] = []  # type: ignore[index]
    write_recording(other, run / "run" / "T1-s003.h5")
    assert main(["export", "lerobot", "run", "--out", "d"]) == 2
    message = capsys.readouterr().err.splitlines()
    assert message[0] == "error: --out run: exists already; name a new folder"
    assert message[1].startswith("error: nowhere: no such folder")
    assert message[2] == (
        "error: T1-s003 cannot be in one dataset with the trials before it: it differs in observation.images.overhead"
    )


def test_only_the_trials_that_were_asked_for(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_recording(seen(make_recording("T1", seed=1)), run / "run" / "T1-s001.h5")
    write_scores(run / "run", score_run(run / "run"))
    assert main(["export", "lerobot", "run", "--out", "d", "--only", "success"]) == 0
    assert capsys.readouterr().out.splitlines()[:-1] == ["T1-s000: 6 rows at 10 fps", "T2-s000: 6 rows at 10 fps"]


@pytest.mark.slow
@pytest.mark.skipif(LEROBOT is None, reason="CARECONTACT_LEROBOT_PYTHON names no Python that has lerobot")
def test_lerobots_own_loader_and_tools_give_every_row_and_the_statistics_of_every_part(run: Path) -> None:
    assert main(["export", "lerobot", "run", "--out", "d", "--with-force"]) == 0
    reader = Path(__file__).with_name("read_lerobot.py")
    environment = {**os.environ, "HF_HUB_OFFLINE": "1", "HF_HOME": str(run / "cache")}
    subprocess.run([str(LEROBOT), str(reader), "d", "read.npz"], env=environment, check=True)
    read = np.load("read.npz")
    assert (int(read["episodes"]), float(read["fps"])) == (2, 10)
    assert set(read["task"]) == {"gently touch the right forearm", "push the right forearm"}
    row = 0
    for recording in (seen(touch(seed=0)), seen(push(seed=0))):
        episode = episode_of(recording, force=True)
        rows = slice(row, row + len(episode))
        for name, stream in episode.streams.items():
            assert (read[name][rows].reshape(stream.values.shape) == stream.values).all(), name
        images = np.stack(episode.images["overhead"])[episode.shown["overhead"]]
        got = read["observation.images.overhead"][rows].transpose(0, 2, 3, 1)
        assert (np.round(got * 255).astype(np.uint8) == images).all()
        row += len(episode)
    for name, episode in (("deleted", 1), ("first", 0), ("second", 1)):
        found: dict[str, Any] = {}
        for path in (path for path in read if path.startswith(f"{name}/")):
            _, key, each = path.split("/")
            found.setdefault(key, {})[each] = read[path]
        assert_equal(found, recomputed(range(episode, episode + 1)))
