from __future__ import annotations

import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from carecontact.observation.keypoints import LANDMARK_COUNT, MediaPipePose, nobody, unrotate


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_unrotate_finds_the_marked_pixel(turns: int) -> None:
    image = np.zeros((5, 9))
    image[1, 6] = 1
    v, u = np.argwhere(np.rot90(image, turns))[0]
    np.testing.assert_array_equal(unrotate(np.array([[u, v]], float), turns, 5, 9), [[6, 1]])


class OnePixelGraph:
    """Stands for MediaPipe: puts every landmark on the brightest pixel and calls bright pixels a person."""

    def __init__(self, *, blind_below_px: int = 0) -> None:
        self.blind_below_px = blind_below_px
        self.sizes: list[tuple[int, int]] = []

    def process(self, rgb: np.ndarray) -> SimpleNamespace:
        height, width = rgb.shape[:2]
        self.sizes.append((height, width))
        if rgb.max() == 0 or min(height, width) < self.blind_below_px:
            return SimpleNamespace(pose_landmarks=None, segmentation_mask=None)
        marks = []
        for k in range(LANDMARK_COUNT):
            spots = np.argwhere(rgb[..., 0] > 100)
            v, u = spots[k % len(spots)]
            marks.append(SimpleNamespace(x=(u + 0.5) / width, y=(v + 0.5) / height, visibility=0.9))
        return SimpleNamespace(
            pose_landmarks=SimpleNamespace(landmark=marks), segmentation_mask=(rgb[..., 0] > 100).astype(np.float32)
        )


def estimator(graph: OnePixelGraph) -> MediaPipePose:
    made = MediaPipePose()
    made._graph = graph
    return made


def spot_image() -> np.ndarray:
    image = np.zeros((60, 80, 3), np.uint8)
    image[20, 50] = 255
    return image


def test_votes_and_crop_map_back_to_the_image() -> None:
    graph = OnePixelGraph()
    found = estimator(graph).estimate(spot_image())
    np.testing.assert_allclose(found.landmarks, np.tile([50, 20, 0.9], (LANDMARK_COUNT, 1)), atol=1e-4)
    assert np.argwhere(found.person > 0.5).tolist() == [[20, 50]]
    assert len(graph.sizes) == 6


def test_a_failed_second_pass_keeps_the_first() -> None:
    graph = OnePixelGraph(blind_below_px=30)
    found = estimator(graph).estimate(spot_image())
    np.testing.assert_allclose(found.landmarks[0], [50, 20, 0.9], atol=1e-4)


def test_nobody() -> None:
    found = estimator(OnePixelGraph()).estimate(np.zeros((60, 80, 3), np.uint8))
    assert np.isnan(found.landmarks).all()
    assert not found.person.any()
    assert nobody(4, 5).person.shape == (4, 5)


def test_what_an_estimate_does_not_need_is_not_imported_and_can_be_afterwards() -> None:
    program = """
import sys
import numpy as np
from carecontact.observation.keypoints import MediaPipePose
found = MediaPipePose().estimate(np.zeros((64, 64, 3), np.uint8))
assert np.isnan(found.landmarks).all()
needless = ("matplotlib", "mediapipe.tasks", "sounddevice")
assert "mediapipe" in sys.modules and not any(name.startswith(needless) for name in sys.modules)
from mediapipe.tasks.python import vision
assert vision.PoseLandmarker
from matplotlib import pyplot
pyplot.figure()
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
