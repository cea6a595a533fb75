"""Recorded trials stepped again: what they land on, and what happens where they do not."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from rerun.chunk import RrdReader

from carecontact.episode.episode import Episode
from carecontact.errors import DependencyError, RecordingError
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording import Recording
from carecontact.replay import viewer
from carecontact.replay.replay import CLOSE_M, STATE, Replay, ReplayQuality, Stretch
from carecontact.replay.rerun_file import TIMELINE, save
from carecontact.replay.viewer import LOOPBACK, command
from tests.scoring.synthetic import before_start


def changed(recording: Recording, **arrays: Any) -> Recording:
    return replace(recording, arrays={**recording.arrays, **{k.replace("__", "/"): v for k, v in arrays.items()}})


def test_every_stored_state_is_reached_to_the_last_bit(pressed: Recording) -> None:
    stretches = list(Replay(pressed).stretches(10.0))
    assert [stretch.kind for stretch in stretches] == ["exact"] * len(pressed["state/time_s"])
    steps = np.concatenate([stretch.steps for stretch in stretches])
    assert (np.diff(steps) == 50).all()
    assert steps[0] == 0
    assert len(pressed["scorer/time_s"]) - steps[-1] < 50


def test_a_shown_state_is_the_stored_one_where_there_is_one(pressed: Recording) -> None:
    for stretch, stored in zip(Replay(pressed).stretches(4.0), pressed["state/integration"], strict=True):
        assert np.array_equal(stretch.states[0], stored, equal_nan=True)


def test_a_trial_under_joint_control_is_reached_too() -> None:
    card = PolicyCard(name="j", action_space="joint_position", control="droid", modalities=(), control_hz=15)
    spec = TrialSpec(protocol=load_protocol("bathing-v3"), task_id="T1", seed=1, policy="j")
    with Episode(spec, card=card) as episode:
        start = episode.reset().joint_position
        for number in range(20):
            offset = 0.004 * number * np.array([1, 0, 0, -1, 0, 0, 1.0])
            episode.step(Action(joint=start + offset, done=number == 19), observe=number == 7)
        recording = episode.finish()
    assert [stretch.kind for stretch in Replay(recording).stretches(10.0)] == ["exact", "exact"]


def test_a_world_that_rounds_otherwise_begins_each_second_from_its_stored_state(pressed: Recording) -> None:
    stored = pressed["state/integration"].copy()
    joint = Replay(pressed).model.joint("robot_joint1")
    stored[1:, 1 + int(joint.qposadr[0])] += 1e-7  # after the time
    stretches = list(Replay(changed(pressed, state__integration=stored)).stretches(4.0))
    assert {stretch.kind for stretch in stretches[:-1]} == {"close"}
    assert all(0 < stretch.off_m < CLOSE_M for stretch in stretches[:-1])
    assert np.array_equal(stretches[1].states[0], stored[1], equal_nan=True)


def test_where_the_commands_are_missing_states_are_interpolated(pressed: Recording) -> None:
    still = np.full_like(pressed["actions/pose_tcp_in_base"], np.nan)
    replay = Replay(changed(pressed, actions__pose_tcp_in_base=still))
    second = list(replay.stretches(4.0))[1]
    assert second.kind == "interpolated"
    assert second.off_m > CLOSE_M
    data, joint = mujoco.MjData(replay.model), replay.model.joint("robot_joint1")
    angles = []
    for state in (*second.states, pressed["state/integration"][2]):
        mujoco.mj_setState(replay.model, data, state, STATE)
        angles.append(float(data.qpos[joint.qposadr[0]]))
    assert np.allclose(np.diff(angles), np.diff(angles)[0], atol=1e-9), "even steps from stored state to stored state"
    assert abs(angles[-1] - angles[0]) > 1e-3


def test_a_trial_that_ended_before_it_began_cannot_be_shown() -> None:
    with pytest.raises(RecordingError, match=r"T5-s000|ended before t = 0"):
        Replay(before_start())


def test_states_of_another_size_are_refused(pressed: Recording) -> None:
    with pytest.raises(RecordingError, match=r"its states have \d+ numbers, this world's \d+; install the release"):
        Replay(changed(pressed, state__integration=pressed["state/integration"][:, :-4]))


def test_a_trial_with_a_secret_draw_is_refused(pressed: Recording) -> None:
    spec = pressed.header.spec.model_copy(update={"salt_sha256": "ab" * 32})
    with pytest.raises(RecordingError, match=r"T1-s000: its person was drawn with a secret"):
        Replay(replace(pressed, header=pressed.header.model_copy(update={"spec": spec})))


def test_the_worst_stretch_decides_the_wording() -> None:
    found, nothing = ReplayQuality(), np.zeros(0, np.int64)
    assert str(found) == "stepped again from the recording, bit for bit"
    for kind, off_m in (("close", 1e-4), ("interpolated", 2e-3), ("exact", 0.0)):
        found.take(Stretch(steps=nothing, states=np.zeros((0, 1)), kind=kind, off_m=off_m))  # type: ignore[arg-type]
    assert str(found) == (
        "interpolated between the states of each second, at most 2.00 mm off the tool's recorded path"
    )


# The keys of the passive viewer, its states, and a machine without a display.


def test_keys_pause_and_skip() -> None:
    player = viewer.Player(count=100, fps=10.0)
    assert player.advance(2.0) == 20
    player.key(viewer.SPACE)
    assert player.advance(5.0) == 20
    player.key(viewer.RIGHT)
    assert player.advance(0.0) == 30
    for _ in range(9):
        player.key(viewer.LEFT)
    assert player.advance(0.0) == 0
    player.key(viewer.SPACE)
    assert player.advance(100.0) == 99, "the last state stays"
    player.key(viewer.HOME)
    assert player.advance(0.0) == 0


def test_all_states_have_positions_and_the_robot_moves(pressed: Recording) -> None:
    replay = Replay(pressed)
    rows = viewer.positions(replay, 5.0)
    joint = int(replay.model.joint("robot_joint1").qposadr[0])
    assert rows.shape == (int(len(pressed["scorer/time_s"]) * 0.002 * 5) + 1, replay.model.nq)
    assert rows[:, joint].std() > 0.01


def test_without_a_display_the_error_names_what_works(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewer.sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(DependencyError, match=r"no display.*--save FILE\.rrd"):
        viewer.need_display()
    monkeypatch.setenv("DISPLAY", ":0")
    viewer.need_display()


# The file for Rerun, read again with its SDK: every stream is in it.


@pytest.fixture(scope="module")
def rows(pressed: Recording, tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, list[object]]]:
    """Entity -> component or timeline -> all that was logged."""
    path = tmp_path_factory.mktemp("rrd") / "trial.rrd"
    assert str(save(pressed, path, fps=5.0)) == "stepped again from the recording, bit for bit"
    assert [p.name for p in path.parent.iterdir()] == ["trial.rrd"]
    reader = RrdReader(str(path))
    assert len(reader.blueprints()) == 1
    found: dict[str, dict[str, list[object]]] = {}
    for chunk in reader.stream():
        batch, entity = chunk.to_record_batch(), found.setdefault(chunk.entity_path, {})
        for name in batch.schema.names:
            entity.setdefault(name, []).extend(batch.column(name).to_pylist())
    return found


def test_every_stream_is_there(rows: dict[str, dict[str, list[object]]], pressed: Recording) -> None:
    header = pressed.header
    expected = {
        "/world/person/skin/dented", "/world/person/skin/rest", "/world/tcp", "/world/tcp_path", "/world/force",
        "/world/pressure", "/world/cloud/overhead", "/world/cameras/overhead/rgb", "/world/cameras/overhead/depth",
        "/force/right_forearm", "/tool/speed", "/tool/from_command", "/events",
        *(f"/world/cameras/{name}" for name in header.spec.protocol.cameras),
        *(f"/joint_margin/{name}" for name in header.human_joints),
        *(f"/indentation/{name}" for name in header.regions),
        *(f"/world/robot/robot_link{number}" for number in range(1, 8)),
    }  # fmt: skip
    assert expected <= rows.keys()
    assert any(path.startswith("/world/robot/robot_hand/") for path in rows)
    assert any(path.startswith("/world/room/") for path in rows)


def test_the_force_has_its_peak(rows: dict[str, dict[str, list[object]]], pressed: Recording) -> None:
    scalars = [value for value in rows["/force/right_forearm"]["Scalars:scalars"] if value is not None]
    column = pressed.header.segments.index("right_forearm")
    force = np.linalg.norm(pressed["scorer/force_human_from_robot_in_world"][:, column], axis=1)
    assert np.isclose(np.max(scalars), force.max())


def test_the_skin_is_sent_again_while_it_gives_way(rows: dict[str, dict[str, list[object]]]) -> None:
    def sent(part: str) -> int:
        return len([p for p in rows[f"/world/person/skin/{part}"]["Mesh3D:vertex_positions"] if p is not None])

    assert sent("dented") > 3
    faces = [f for f in rows["/world/person/skin/dented"]["Mesh3D:triangle_indices"] if f is not None]
    assert len(faces) == 1, "triangles stay"
    assert sent("rest") <= sent("dented")


def test_times_are_those_of_the_trial(rows: dict[str, dict[str, list[object]]], pressed: Recording) -> None:
    times = np.array([t.total_seconds() for t in rows["/world/tcp"][TIMELINE]])  # type: ignore[attr-defined]
    assert np.allclose(np.sort(times), np.arange(len(times)) / 5.0)
    assert len(times) == int(len(pressed["scorer/time_s"]) * 0.002 * 5) + 1


def test_the_viewer_is_reachable_from_this_machine_only(tmp_path: Path) -> None:
    line = command(tmp_path / "trial.rrd")
    assert line[line.index("--bind") + 1] == LOOPBACK == "127.0.0.1"


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere Rerun's settings have another place")
def test_the_viewer_is_started_without_its_usage_data() -> None:
    with viewer.without_usage_data() as environment:
        wording = subprocess.run(
            [command(Path())[0], "analytics", "config"],
            env=dict(environment),
            check=True,
            capture_output=True,
            text=True,
        )
        assert '"analytics_enabled": false' in wording.stdout
    assert not Path(environment["XDG_CONFIG_HOME"]).exists()


def test_without_the_extra_the_error_names_it(
    pressed: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(DependencyError, match=r"pip install 'carecontact\[viz\]'"):
        save(pressed, tmp_path / "trial.rrd", fps=5.0)
