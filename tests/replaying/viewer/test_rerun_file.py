"""The file for Rerun, read again with its SDK: every stream is in it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from carecontact.errors import DependencyError
from carecontact.recording import Recording
from carecontact.replaying.viewer import window
from carecontact.replaying.viewer.rerun_file import TIMELINE, save
from carecontact.replaying.viewer.window import LOOPBACK, command


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
    with window.without_usage_data() as environment:
        told = subprocess.run(
            [command(Path())[0], "analytics", "config"],
            env=dict(environment),
            check=True,
            capture_output=True,
            text=True,
        )
        assert '"analytics_enabled": false' in told.stdout
    assert not Path(environment["XDG_CONFIG_HOME"]).exists()


def test_without_the_extra_the_error_names_it(
    pressed: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(DependencyError, match=r"pip install 'carecontact\[viz\]'"):
        save(pressed, tmp_path / "trial.rrd", fps=5.0)
