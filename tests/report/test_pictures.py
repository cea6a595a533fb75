from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

from carecontact.cli import main
from carecontact.errors import ConfigError
from carecontact.interface.observation import CameraView, Observation
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording import write_recording
from carecontact.recording.schema import Recording
from carecontact.report.look_sheet import draw_sheet, save_sheet, splat
from carecontact.report.notes_picture import draw_notes
from carecontact.report.value_maps_picture import CHOSEN, OBJECTIVE, pieces
from carecontact.running.lost import harness_error_recording

OPTION = {"primitive": "touch", "approach": "above", "key_point": 0.5, "depth_m": 0.012, "speed_m_s": 0.03}
OPTIONS = {
    "method": "state-machine", "camera": "overhead", "chosen": 1,
    "intent": {"action": "touch", "region": "forearm", "side": "right", "manner": "gentle"},
    "options": [
        {**OPTION, "corners_px": [[20.0, 30.0]]}, {**OPTION, "depth_m": 0.018, "corners_px": [[20.2, 30.0]]},
        {**OPTION, "primitive": "push", "approach": "near_side", "depth_m": 0.06, "speed_m_s": 0.05,
         "corners_px": [[40.0, 30.0], [40.0, 35.0]]},
    ],
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


def recording(content: dict[str, Any], *, failure: str = "x", **arrays: np.ndarray) -> Recording:
    spec = TrialSpec(protocol=load_protocol("bathing-v3"), task_id="T1", seed=0, policy="x")
    base = harness_error_recording(spec, kind="x", message=failure)
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


def texts(figure: Figure) -> list[str]:
    axes = [text.get_text() for axes in figure.axes for text in [*axes.texts, axes.title, axes._left_title]]
    return [text.get_text() for text in figure.texts] + axes


def test_every_option_has_a_cell_with_its_number_and_the_chosen_one_is_red() -> None:
    figure = draw_notes(recording(OPTIONS))
    cells = {t.get_text().strip(): t for t in figure.axes[1].texts if t.get_bbox_patch() is not None}
    assert sorted(cells) == ["0", "1", "2"]
    red = to_rgba(CHOSEN)
    assert {k: cell.get_bbox_patch().get_facecolor() == red for k, cell in cells.items()} == {
        "0": False, "1": True, "2": False
    }  # fmt: skip
    sentence = texts(figure)
    assert {"12 mm\n3 cm/s", "18 mm\n3 cm/s", "60 mm\n5 cm/s", "touch", "push"} <= set(sentence)
    assert {"above, 0.5 along the region", "near side, 0.5 along the region", "A", "B"} <= set(sentence)
    assert "“gently touch the right forearm”" in sentence
    assert any("chosen: 1" in text for text in sentence)
    assert "intent: touch right forearm gentle" in sentence
    assert not any("a dot:" in text for text in sentence)
    # Two depths at one place are one place: its letter stands once in the picture and once in the table.
    assert sentence.count("A") == 2


def test_letters_do_not_hide_one_another() -> None:
    options = [
        {**OPTION, "key_point": k / 20, "corners_px": [[30.0 + k / 10, 30.0]], "primitive": primitive}
        for primitive in ("touch", "scrub")
        for k in range(6)
    ]
    figure = draw_notes(recording({**OPTIONS, "options": options}))
    letters = np.array([t.get_position() for t in figure.axes[0].texts])
    assert len(letters) == 12
    apart = np.linalg.norm(letters[:, None] - letters, axis=2)[~np.eye(12, dtype=bool)]
    low, high = figure.axes[0].get_ylim()
    assert apart.min() > abs(high - low) / 20


def test_a_level_slice_lies_where_the_camera_sees_it() -> None:
    figure = draw_notes(recording(MAPS, **slices()))
    values = np.asarray(figure.axes[0].get_images()[1].get_array().filled(np.nan))
    assert values.shape == (60, 80)
    # Straight down: the picture's middle is x = 0.5, x grows up the picture, and beside the workspace is nothing.
    assert values[30, 40] == pytest.approx(0.5, abs=0.02)
    assert values[20, 40] > values[30, 40] > values[40, 40]
    assert np.isnan(values[0, 0])
    sentence = texts(figure)
    assert any("replay:0123:authored" in text for text in sentence)
    assert sentence.count("not in this recording") == 3, "recordings from before these were noted can still be drawn"


def test_a_path_is_dotted_where_it_leaves_the_slice() -> None:
    path = np.array([[0, 0.0, 0.5], [0, 0.0, 0.4], [0, 0.3, 0.3], [0, 0.4, 0.2], [0, 0.0, 0.1], [0, 0.0, 0.0]])
    runs = [(piece[:, 2].tolist(), whole) for piece, whole in pieces(path, path[:, 1] < 0.1)]
    assert runs == [([0.5, 0.4], True), ([0.4, 0.3, 0.2, 0.1], False), ([0.1, 0.0], True)]
    figure = draw_notes(recording({**MAPS, "path_m": path.tolist()}, **slices()))
    upright = next(axes for axes in figure.axes if axes._left_title.get_text().startswith("cost, upright at y = 0.01"))
    assert [line.get_linestyle() for line in upright.get_lines()] == ["-", ":", "-"]


MANNER = {
    "path_speed_m_s": [0.25, 0.0625], "path_quat": [None, [0.0, 1.0, 0.0, 0.0]], "path_gripper": [None, None],
    "maps": {"affordance": "there", "velocity": "slowly"}, "path_m": [[0.2, 0, 0.5], [0.4, 0, 0.3], [0.5, 0, 0.1]],
    "path_px": [[40.0, 42.0]] * 3, "written": {"velocity": [[50, 50, 13, 10.0, 0.25], [50, 50, 50, 200.0, 1.0]]},
}  # fmt: skip


def test_what_the_other_maps_ask_for_is_drawn() -> None:
    figure = draw_notes(recording(MAPS | MANNER, **slices()))
    by_label = {axes.get_ylabel(): axes for axes in figure.axes}
    np.testing.assert_allclose(by_label["speed [m/s]"].get_lines()[0].get_ydata(), [0.25, 0.0625])
    np.testing.assert_allclose(by_label["off straight\ndown [deg]"].get_lines()[0].get_ydata(), [np.nan, 0.0])
    assert [t.get_text() for t in by_label["gripper"].texts] == ["as it is"]
    sentence = texts(figure)
    assert "affordance: there     velocity: slowly" in sentence
    assert "velocity 0.25" in sentence
    assert "velocity 1" not in sentence, "a box that fills the workspace has no edge to draw"


def test_the_phase_of_the_objective_is_drawn_where_the_tool_was_sent() -> None:
    whole = recording(MAPS | MANNER, **slices())
    looks = [
        {"progress": "slide", "progress_m": done, "progress_of_m": 0.2, "subtask": "move there", "pursuing": done < 0.2,
         "method": "voxposer-phased", "camera": "overhead"}
        for done in (0.0, 0.12, 0.21)
    ]  # fmt: skip
    extra = {
        f"policy/notes/{k:04d}/json": np.frombuffer(json.dumps(look).encode(), "u1") for k, look in enumerate(looks, 1)
    }
    sent = np.array([[0.5, y, 0.1, 0, 1, 0, 0] for y in (0.0, 0.02, 0.05, -0.05, 0.3)])
    extra |= {"actions/observation_index": np.array([1, 1, 2, 2, 3]), "actions/pose_tcp_in_base": sent}
    figure = draw_notes(Recording.trusted(whole.header, whole.arrays | extra))
    orange = [line for line in figure.axes[0].get_lines() if line.get_color() == OBJECTIVE]
    assert [len(line.get_xdata()) for line in orange] == [2, 2], "not the way home of the look that found it met"
    done = next(axes for axes in figure.axes if axes.get_xlabel() == "look since the touch")
    assert done.get_lines()[0].get_ydata().tolist() == [0.0, 0.12, 0.21]
    assert any("then “slide”: 0.21 of 0.20 m" in text for text in texts(figure))
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "sent while the objective led" in legend


def test_a_program_that_stopped_everything_is_shown_with_its_line() -> None:
    programs = [{"role": "planner", "query": "go", "code": "x = 1\nopen('/etc/passwd')"},
                {"role": "composer", "query": "there", "code": "execute()"}]  # fmt: skip
    sentence = "program planner: go was stopped: PermissionError: no (line 2: open('/etc/passwd'))"
    content = {"method": "voxposer", "camera": "overhead", "programs": programs, "language": MAPS["language"]}
    figure = draw_notes(recording(content, failure=sentence))
    lines = [text for text in figure.texts if "open(" in text.get_text()]
    assert [line.get_text() for line in lines] == [sentence, ">   2  open('/etc/passwd')"]
    assert all(line.get_color() == CHOSEN for line in lines)
    assert any("composer: there" in text for text in texts(figure))
    assert any("replay:0123:authored" in text for text in texts(figure))


def test_what_is_not_offered_at_a_place_is_a_dot_and_explained() -> None:
    elsewhere = {**OPTION, "key_point": 0.65, "corners_px": [[24.0, 30.0]]}
    sentence = texts(draw_notes(recording({**OPTIONS, "options": [*OPTIONS["options"], elsewhere]})))
    assert sentence.count("·") == 1
    assert any(text.endswith("outside the workspace") for text in sentence)


def test_options_of_which_none_was_chosen_are_drawn() -> None:
    figure = draw_notes(recording({k: v for k, v in OPTIONS.items() if k != "chosen"}))
    assert any(text.startswith("nothing was chosen") for text in texts(figure))


def test_programs_that_planned_nothing_are_shown_too() -> None:
    """They go home without contact: the trial ends as it should, and people ask why."""
    programs = [{"role": "planner", "query": "go", "code": 'composer("back to default pose")'}]
    kept = recording({"method": "voxposer", "camera": "overhead", "programs": programs})
    header = kept.header.model_copy(update={"ended": "done", "failure": None})
    sentence = texts(draw_notes(Recording(header=header, arrays=kept.arrays)))
    assert any('composer("back to default pose")' in text for text in sentence)
    assert any("voxposer planned no path" in text for text in sentence)


def test_a_recording_without_notes_tells_the_reason_in_one_line() -> None:
    trace = "failed at act: Traceback (most recent call last):\n  File x\nValueError: boom\n (exit code 0)"
    with pytest.raises(ConfigError, match=r"^T1-s000 has no notes to draw: ValueError: boom$"):
        draw_notes(recording({"method": "mine"}, failure=trace))


def test_a_recording_without_such_notes_says_so() -> None:
    with pytest.raises(ConfigError, match="T1-s000 has no notes to draw: no person was found"):
        draw_notes(recording({"method": "voxposer", "ended_because": "no person was found"}))


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    write_recording(recording(OPTIONS), tmp_path / "T1-s000.h5")
    assert main(["view", "--notes", "T1-s000.h5"]) == 0
    assert Path("notes-T1-s000.png").read_bytes().startswith(b"\x89PNG")
    assert main(["view", "--notes", "T1-s000.h5", "--out", "x.txt"]) == 2
    assert "a picture ends in" in capsys.readouterr().err


H, W = 30, 40


@pytest.fixture
def view() -> CameraView:
    human = np.zeros((H, W), bool)
    human[10:20, 10:30] = True
    depth = np.full((H, W), 2.0, np.float32)
    depth[0] = np.nan
    v, u = np.mgrid[1:H, :W]
    points = np.stack([u / 20, v / 20, np.zeros_like(u)], -1).reshape(-1, 3).astype(np.float32)
    return CameraView(
        intrinsics=np.eye(3),
        pose_camera_in_base=np.eye(4),
        rgb=np.full((H, W, 3), 90, np.uint8),
        depth=depth,
        points=points,
        point_colors=np.full((len(points), 3), 200, np.uint8),
        masks={"human": human, "robot": ~human & (u[:1] < 3), "bed": ~human, "background": human & False},
        landmarks=np.tile(np.float32([15, 12, 0.9]), (33, 1)),
        landmarks_in_base=np.zeros((33, 3), np.float32),
    )


def observation(**cameras: CameraView) -> Observation:
    return Observation(
        instruction="touch the arm",
        sim_time_s=0.0,
        joint_position=np.arange(7.0),
        joint_velocity=np.zeros(7),
        gripper_position=np.zeros(1),
        pose_tcp_in_base=np.r_[0.4, 0, 0.3, 1, 0, 0, 0],
        cameras=cameras,
    )


def titles(seen: Observation) -> list[str]:
    return [text for axes in draw_sheet(seen, title="t").axes if (text := axes.get_title(loc="left"))]


def test_every_modality_of_every_camera_is_there(view: CameraView) -> None:
    found = titles(observation(overhead=view, wrist=view))
    for camera in ("overhead", "wrist"):
        for name in ("RGB", "depth", "masks over RGB", "landmarks"):
            assert f"{camera}: {name}" in found
    assert len([t for t in found if t.startswith("points ")]) == 2
    assert "robot's encoders" in found


def test_keys_stand_below_their_picture_and_cover_none_of_it(view: CameraView) -> None:
    figure = draw_sheet(
        observation(overhead=view, wrist=replace(view, landmarks=view.landmarks * [1, 1, 0.1])), title="t"
    )
    FigureCanvasAgg(figure).draw()
    pictures = [axes for axes in figure.axes if ": " in axes.get_title(loc="left")]
    keys = 0
    for axes in pictures:
        around = [*axes.texts, *axes.child_axes, *([legend] if (legend := axes.get_legend()) else [])]
        for key in around:
            keys += 1
            box, picture = key.get_window_extent(), axes.get_window_extent()
            assert box.y1 < picture.y0, (axes.get_title(loc="left"), key)
            assert box.y0 > 0
            assert box.x1 <= picture.x1 + 1
            others = [other.get_window_extent() for other in pictures if other is not axes]
            assert not any(box.overlaps(other) for other in others)
    assert keys == 2 * (3 + 1 + 3), "a bar with two numbers, a legend, left, right and what is unsure; two cameras"


def test_a_cropped_cloud_says_so(view: CameraView) -> None:
    assert view.points is not None
    far = replace(
        view,
        points=np.concatenate([view.points, view.points[:5] + 9]),
        point_colors=np.zeros((len(view.points) + 5, 3), np.uint8),
    )
    shown = {}
    for name, one in {"far": replace(far, masks=None), "near": replace(view, masks=None)}.items():
        labels = [axes.get_xlabel() for axes in draw_sheet(observation(overhead=one), title="t").axes]
        shown[name] = {label for label in labels if label}
    assert shown == {
        "far": {"across the picture [m]; cropped to 1,160 of 1,165 points"},
        "near": {"across the picture [m]; 1,160 points"},
    }


def test_what_is_not_in_the_observation_is_not_drawn(view: CameraView) -> None:
    bare = CameraView(intrinsics=view.intrinsics, pose_camera_in_base=view.pose_camera_in_base, rgb=view.rgb)
    assert titles(observation(overhead=bare)) == ["overhead: RGB", "robot's encoders"]
    assert titles(observation()) == ["robot's encoders"]


def test_no_person_found_is_stated(view: CameraView) -> None:
    without = replace(view, landmarks=np.full((33, 3), np.nan, np.float32))
    figure = draw_sheet(observation(overhead=without), title="t")
    sentence = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert "no person found" in sentence


def test_it_is_written(view: CameraView, tmp_path: Path) -> None:
    path = save_sheet(observation(overhead=view), tmp_path / "a.png", title="t", dpi=30)
    assert path.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(("name", "why"), [("a.txt", ".png"), ("a", ".png"), ("nowhere/a.png", "no folder")])
def test_where_it_cannot_be_written(name: str, why: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=why):
        save_sheet(observation(), tmp_path / name, title="t")


def test_nearer_points_cover_farther_ones() -> None:
    points = np.array([[0.0, 0, 0], [1.0, 0, 0], [1.0, 0.5, 0]])
    colors = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255]], np.uint8)
    image, (left, right, low, high) = splat(points, colors, azimuth_deg=0.0, elevation_deg=0.0)
    assert (image == [255, 0, 0]).all(2).any()
    assert not (image == [0, 255, 0]).all(2).any()
    # Looking along +x, +y is on the left.
    blue, red = (np.argwhere((image == c).all(2))[:, 1].mean() for c in (colors[2], colors[0]))
    assert blue < red
    assert right - left > 0.5 > high - low
