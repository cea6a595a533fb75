"""``carecontact video`` and ``view`` as they are typed."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest

from carecontact.cli import main
from carecontact.recording import Recording
from carecontact.replaying.film.frames import SIZE

FAST = ["--fps", "1", "--draft"]


def decoded(path: Path) -> list[np.ndarray]:
    with av.open(str(path)) as file:
        return [frame.to_ndarray(format="rgb24") for frame in file.decode(file.streams.video[0])]


def test_a_run_becomes_videos_and_what_is_there_is_kept(
    pressed_file: Path, pressed: Recording, capsys: pytest.CaptureFixture[str]
) -> None:
    run = pressed_file.parent
    (run / "T9-s000.h5").write_bytes(pressed_file.read_bytes()[:5000])
    assert main(["video", str(run), *FAST]) == 1
    told = capsys.readouterr().out.splitlines()
    video = run / "trial" / "T1-s000.mp4"
    frames = decoded(video)
    assert told[0].startswith(f"[1/2] {video}: {len(frames)} frames")
    assert told[0].endswith("stepped again from the recording, bit for bit")
    assert told[1].startswith("left out: ")
    assert "T9-s000.h5: not a readable HDF5 file" in told[1]
    assert len(frames) == int(len(pressed["scorer/time_s"]) * 0.002) + 1
    assert {frame.shape for frame in frames} == {(SIZE[1], SIZE[0], 3)}
    moved = np.abs(frames[0].astype(int) - frames[-1])
    assert moved[:, :840].max() > 60, "the robot has come into the picture"
    assert moved[246:396, 914:].max() > 60, "the trace has been drawn"

    before = video.stat().st_mtime_ns
    assert main(["video", str(run), *FAST]) == 1
    assert capsys.readouterr().out.splitlines()[0] == f"[1/2] {video}: is there already"
    assert video.stat().st_mtime_ns == before
    (run / "T9-s000.h5").unlink()
    assert main(["video", str(run), "--fps", "2"]) == 0
    assert len(decoded(video)) > len(frames), "other options make another video"


def test_one_trial_from_another_camera_without_lines(pressed_file: Path) -> None:
    assert main(["video", str(pressed_file), *FAST, "--view", "wrist", "--no-grid"]) == 0
    assert decoded(pressed_file.parent / "trial" / "T1-s000-wrist.mp4")[0].shape == (SIZE[1], SIZE[0], 3)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--view", "overhed"], "--view 'overhed' (did you mean 'overhead'?); valid: contact, orbit, "),
        (["--fps", "0"], "--fps 0: valid are 1 to 60"),
        (["--out", "a.avi"], "--out a.avi: name a file that ends in .mp4 or .gif"),
    ],
)
def test_mistakes_are_one_line(
    pressed_file: Path, options: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["video", str(pressed_file), *options]) == 2
    error = capsys.readouterr().err
    assert told in error
    assert error.count("\n") == 1


def test_what_is_no_recording_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["video", str(tmp_path / "none.h5")]) == 2
    assert "none.h5: no such file" in capsys.readouterr().err
    assert main(["video", str(tmp_path)]) == 2
    assert "holds no recordings" in capsys.readouterr().err


def test_a_folder_or_a_file_of_another_kind_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "results.json").write_text("{}")
    for command, told in (
        (["view", str(tmp_path), "--save", str(tmp_path / "a.rrd")], f"{tmp_path}: this is a folder; name one record"),
        (["video", str(tmp_path / "results.json")], "results.json: this is a file; name the --out of a run"),
    ):
        assert main(command) == 2
        assert told in capsys.readouterr().err


def test_view_and_video_make_the_folder_of_their_file_or_tell_why_not(
    pressed_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = pressed_file.parent
    assert main(["view", str(pressed_file), "--fps", "1", "--save", str(folder / "new" / "a.rrd")]) == 0
    assert (folder / "new" / "a.rrd").is_file()
    capsys.readouterr()
    for command, option, name in (("view", "--save", "a.rrd"), ("video", "--out", "a.mp4")):
        for target in (pressed_file / name, folder / name):
            (folder / name).mkdir(exist_ok=True)
            assert main([command, str(pressed_file), option, str(target)]) == 2
            told = capsys.readouterr().err
            assert f"{target}: " in told
            assert told.count("\n") == 1


def test_view_writes_a_file_and_needs_a_display_for_a_window(
    pressed_file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = pressed_file.with_name("a.rrd")
    assert main(["view", str(pressed_file), "--save", str(out), "--fps", "2"]) == 0
    assert capsys.readouterr().out.startswith(f"{out}: ")
    assert out.stat().st_size > 100_000
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    for options in ([], ["--mujoco"]):
        assert main(["view", str(pressed_file), *options]) == 2
        assert "no display" in capsys.readouterr().err
    assert main(["view", str(pressed_file), "--save", "a.txt"]) == 2
    assert "name a file that ends in .rrd" in capsys.readouterr().err
