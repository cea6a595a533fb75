"""``carecontact export paper`` over the recordings that are kept for tests."""

from __future__ import annotations

import shutil
from pathlib import Path

import av
import numpy as np
import pytest

from carecontact.cli import export, main
from carecontact.protocol.load import load_protocol
from carecontact.recording import Recording
from carecontact.replay.film import SIZE
from carecontact.runs import score_run, write_scores
from carecontact.runs.pooling import RunScores
from tests.report.synthetic import make_score

GOLDEN = Path(__file__).parents[1] / "golden"


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run").mkdir()
    for name in ("T1-s000.h5", "T2-s000.h5"):
        shutil.copy(GOLDEN / name, tmp_path / "run" / name)
    write_scores(tmp_path / "run", score_run(tmp_path / "run"))
    return tmp_path


def contents(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.slow
def test_two_builds_are_the_same_bytes(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", "paper", "run", "--out", "one"]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert main(["export", "paper", "run", "--out", "two"]) == 0
    one = contents(run / "one")
    assert one == contents(run / "two")
    assert sorted(printed) == sorted(f"one/{name}" for name in one)
    assert {name for name in one if name.startswith("figures")} == {
        f"figures/{name}.{ending}"
        for name in ("overview", "traces", "force-indentation", "outcomes")
        for ending in ("svg", "pdf")
    }
    assert all(b"Date" not in content for name, content in one.items() if name.endswith(("svg", "pdf")))


def test_results_alone_give_what_needs_no_recording(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (run / "run" / "results.json").read_text()
    (run / "alone.json").write_text(text.replace(load_protocol("bathing-v3").sha256, "0" * 64))
    assert main(["export", "paper", "alone.json", "--out", "p"]) == 0
    printed = capsys.readouterr().out
    assert "the figures of traces and of force and indentation are left out" in printed
    assert "the tables of tasks and protocol are left out" in printed, "no recording, and an unknown protocol"
    assert {path.stem for path in (run / "p" / "figures").iterdir()} == {"overview", "outcomes"}
    assert main(["export", "paper", "alone.json", "--out", "q", "--no-figures"]) == 0
    assert not (run / "q" / "figures").exists()


def test_tables_and_figures_of_an_earlier_command_do_not_stay(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", "paper", "run", "--out", "p"]) == 0
    mine = run / "p" / "figures" / "mine.svg"
    mine.touch()
    capsys.readouterr()
    assert main(["export", "paper", "run", "--out", "p", "--no-figures"]) == 0
    assert "removed p/figures/traces.svg, which an earlier command had written" in capsys.readouterr().out
    assert list((run / "p" / "figures").iterdir()) == [mine]


def test_a_command_names_only_options_that_it_has(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (run / "run" / "results.json").unlink()
    assert main(["export", "paper", "run", "--out", "p"]) == 2
    printed = capsys.readouterr().err
    assert printed.endswith("run `carecontact report --rescore run`\n"), "without an option of its own"


@pytest.mark.parametrize("again", ["run", "./run", "run/results.json"])
def test_a_run_is_not_tested_against_itself(run: Path, again: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", "paper", "run", again, "--out", "p"]) == 2
    assert "is given twice; name different runs" in capsys.readouterr().err
    assert not (run / "p").exists()


def test_a_recording_is_no_run(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for command in (["export", "paper", "run/T1-s000.h5"], ["compare", "run/T1-s000.h5", "run"]):
        assert main(command) == 2
        printed = capsys.readouterr().err
        assert "run/T1-s000.h5: this is the recording of one trial; name the folder of a run" in printed
        assert printed.count("\n") == 1


def test_mistakes_are_one_line(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", "paper", "nowhere", "--out", "p"]) == 2
    assert main(["export", "paper", "run", "--out", "run/results.json"]) == 2
    printed = capsys.readouterr().err.splitlines()
    assert printed[0].startswith("error: nowhere: no such folder")
    assert printed[1] == "error: --out run/results.json: this is a file; name a folder"


def test_results_alone_of_one_level_have_its_protocol() -> None:
    protocol = load_protocol("bathing-wide-v2", level="L2")
    score = make_score("T1", 0).model_copy(update={"protocol_id": protocol.name, "protocol_sha256": protocol.sha256})
    assert export._protocol([], [RunScores(scores=[score])]) == protocol  # pyright: ignore[reportPrivateUsage]


# ``carecontact view --video`` and ``view`` as they are typed.

FAST = ["--fps", "1", "--draft"]


def decoded(path: Path) -> list[np.ndarray]:
    with av.open(str(path)) as file:
        return [frame.to_ndarray(format="rgb24") for frame in file.decode(file.streams.video[0])]


@pytest.mark.slow
def test_a_run_becomes_videos_and_what_is_there_is_kept(
    pressed_file: Path, pressed: Recording, capsys: pytest.CaptureFixture[str]
) -> None:
    run = pressed_file.parent
    (run / "T9-s000.h5").write_bytes(pressed_file.read_bytes()[:5000])
    assert main(["view", "--video", str(run), *FAST]) == 1
    printed = capsys.readouterr().out.splitlines()
    video = run / "trial" / "T1-s000.mp4"
    frames = decoded(video)
    assert printed[0].startswith(f"[1/2] {video}: {len(frames)} frames")
    assert printed[0].endswith("stepped again from the recording, bit for bit")
    assert printed[1].startswith("left out: ")
    assert "T9-s000.h5: not a readable HDF5 file" in printed[1]
    assert len(frames) == int(len(pressed["scorer/time_s"]) * 0.002) + 1
    assert {frame.shape for frame in frames} == {(SIZE[1], SIZE[0], 3)}
    moved = np.abs(frames[0].astype(int) - frames[-1])
    assert moved[:, :840].max() > 60, "the robot has come into the picture"
    assert moved[246:396, 914:].max() > 60, "the trace has been drawn"

    before = video.stat().st_mtime_ns
    assert main(["view", "--video", str(run), *FAST]) == 1
    assert capsys.readouterr().out.splitlines()[0] == f"[1/2] {video}: is there already"
    assert video.stat().st_mtime_ns == before
    (run / "T9-s000.h5").unlink()
    assert main(["view", "--video", str(run), "--fps", "2"]) == 0
    assert len(decoded(video)) > len(frames), "other options make another video"


def test_one_trial_from_another_camera_without_lines(pressed_file: Path) -> None:
    assert main(["view", "--video", str(pressed_file), *FAST, "--camera", "wrist", "--no-grid"]) == 0
    assert decoded(pressed_file.parent / "trial" / "T1-s000-wrist.mp4")[0].shape == (SIZE[1], SIZE[0], 3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--camera", "overhed"], "--camera 'overhed' (did you mean 'overhead'?); valid: contact, orbit, "),
        (["--fps", "0"], "--fps 0: valid are 1 to 60"),
        (["--out", "a.avi"], "--out a.avi: name a file that ends in .mp4 or .gif"),
    ],
)
def test_mistakes_about_a_video_are_one_line(
    pressed_file: Path, options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["view", "--video", str(pressed_file), *options]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_what_is_no_recording_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", "--video", str(tmp_path / "none.h5")]) == 2
    assert "none.h5: no such file" in capsys.readouterr().err
    assert main(["view", "--video", str(tmp_path)]) == 2
    assert "holds no recordings" in capsys.readouterr().err


def test_a_folder_or_a_file_of_another_kind_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "results.json").write_text("{}")
    for command, message in (
        (["view", str(tmp_path), "--save", str(tmp_path / "a.rrd")], f"{tmp_path}: this is a folder; name one record"),
        (["view", "--video", str(tmp_path / "results.json")], "results.json: this is a file; name the --out of a run"),
    ):
        assert main(command) == 2
        assert message in capsys.readouterr().err


def test_view_and_video_make_the_folder_of_their_file_or_say_why_not(
    pressed_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = pressed_file.parent
    assert main(["view", str(pressed_file), "--fps", "1", "--save", str(folder / "new" / "a.rrd")]) == 0
    assert (folder / "new" / "a.rrd").is_file()
    capsys.readouterr()
    for command, option, name in ((["view"], "--save", "a.rrd"), (["view", "--video"], "--out", "a.mp4")):
        for target in (pressed_file / name, folder / name):
            (folder / name).mkdir(exist_ok=True)
            assert main([*command, str(pressed_file), option, str(target)]) == 2
            printed = capsys.readouterr().err
            assert f"{target}: " in printed
            assert printed.count("\n") == 1


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
