from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from carecontact.contract.observation import CameraView, Observation
from carecontact.errors import ConfigError
from carecontact.reports.pictures.sheet import draw_sheet, save_sheet, splat

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


def test_nobody_found_is_said(view: CameraView) -> None:
    nobody = replace(view, landmarks=np.full((33, 3), np.nan, np.float32))
    figure = draw_sheet(observation(overhead=nobody), title="t")
    said = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert "nobody found" in said


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
