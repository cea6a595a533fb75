"""Finds one person in an image with the two networks of MediaPipe Pose: landmarks and a mask.

The steps and constants are those of the graph ``PoseLandmarkCpu`` of MediaPipe 0.10.21 for one image (github.com/
google-ai-edge/mediapipe, mediapipe/modules/pose_detection and pose_landmark; the networks: Bazarevsky et al. 2020,
"BlazePose", arXiv:2006.10204). A detector finds the middle of the hips and a point that encodes the person's size and
rotation. The square round both is cropped, upright, for the second network, which answers with landmarks, heatmaps that
refine them, and a mask. tests/sensing/test_blazepose.py compares every step with recorded answers of that release.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from carecontact.errors import DependencyError
from carecontact.interface.observation import F32, U8

F64 = npt.NDArray[np.float64]

LANDMARK_COUNT = 33
DETECTOR_PX, CROP_PX = 224, 256
"""Sides of the square images that the networks take [px]."""
STRIDES = (8, 16, 32, 32, 32)
"""Of the detector's layers [px]; each layer has two boxes in every cell."""
MIN_SCORE, MIN_OVERLAP = 0.5, 0.3
"""A detection needs this score; others that overlap the best one by more (intersection over union) are averaged."""
SIZE_FACTOR = 1.25
"""Side of the crop over twice the distance of the detector's two points."""
MIN_PRESENCE = 0.5
KERNEL_CELLS, MIN_REFINING = 9, 0.5
"""Width of the window of a heatmap that moves a landmark, and the least value in it from which it does. The published
graph says 7; 9 is what the released library does: on the pictures of tests/data/pose.npz, landmarks differ by at most
2.2 px with 9, and by 26 px with 7."""


@dataclass(frozen=True, kw_only=True)
class Square:
    """A square of the image that is turned: its middle (2,) [px], its side [px], and its angle [rad]."""

    middle: F64
    side: float
    angle: float

    def to_image(self, px: int) -> F64:
        """Return the (2, 3) map from points of the square, drawn with so many pixels a side, to points of the image."""
        turn = _turn(self.angle) * self.side / px
        return np.column_stack([turn, self.middle - turn @ [px / 2, px / 2]])


@dataclass(frozen=True, kw_only=True)
class Found:
    uv: F64
    """(33, 2) landmarks in the order of MediaPipe Pose [px], counted from the image's upper left corner."""
    visibility: F32
    """(33,) in [0, 1]."""
    square: Square
    shape: tuple[int, int]
    """Height and width of the image."""
    mask_logits: F32
    """(CROP_PX, CROP_PX) of the square."""

    @cached_property
    def mask(self) -> F32:
        """(H, W) probability that a pixel shows the person."""
        back = _turn(self.square.angle).T * CROP_PX / self.square.side
        # Pillow's pixels have their middles at halves; MediaPipe lays the mask's whole numbers on those of the image.
        to_crop = np.column_stack([back, CROP_PX / 2 - back @ (self.square.middle + 0.5) + 0.5]).ravel().tolist()
        crop, (height, width) = Image.fromarray(_sigmoid(self.mask_logits)), self.shape
        return np.array(crop.transform((width, height), Image.Transform.AFFINE, to_crop, Image.Resampling.BILINEAR))


class BlazePose:
    """Both networks, each on one thread. Raises DependencyError where their interpreter cannot be imported."""

    def __init__(self) -> None:
        self._detector, self._landmarker = _Network("pose_detection.tflite"), _Network("pose_landmark_full.tflite")
        self._cells = _cells()

    def warm_up(self) -> None:
        """Run both networks once."""
        self._detector(np.zeros((DETECTOR_PX, DETECTOR_PX, 3), np.float32))
        self._landmarker(np.zeros((CROP_PX, CROP_PX, 3), np.float32))

    def find(self, rgb: U8) -> Found | None:
        """Find the person in an image (H, W, 3); None where no person is seen."""
        framed = np.zeros((rgb.shape[0] + 2, rgb.shape[1] + 2, 4), np.uint8)
        framed[1:-1, 1:-1, :3] = rgb
        square = self._detect(framed)
        if square is None:
            return None
        # Where the square leaves the image, the detector saw black, and the crop continues the image's border.
        framed[0], framed[-1] = framed[1], framed[-2]
        framed[:, 0], framed[:, -1] = framed[:, 1], framed[:, -2]
        crop = _sampled(framed, square.to_image(CROP_PX), CROP_PX)
        answers = self._landmarker(crop.astype(np.float32) / np.float32(255))
        if answers[(1,)][0] < MIN_PRESENCE:
            return None
        # Five numbers a point: x, y, z [px of the crop], and logits of visibility and presence; six points are helpers.
        points = answers[(195,)].reshape(39, 5)[:LANDMARK_COUNT]
        uv = _refined(points[:, :2] / CROP_PX, answers[(64, 64, 39)])
        to_image = square.to_image(1)
        return Found(
            uv=uv @ to_image[:, :2].T + to_image[:, 2],
            visibility=_sigmoid(points[:, 3]),
            square=square,
            shape=(rgb.shape[0], rgb.shape[1]),
            mask_logits=answers[(256, 256, 1)][..., 0],
        )

    def _detect(self, framed: U8) -> Square | None:
        """Return the square that holds the whole person in an image that has a black frame."""
        height, width = framed.shape[0] - 2, framed.shape[1] - 2
        whole = Square(middle=np.array([width, height]) / 2, side=max(height, width), angle=0.0)
        image = _sampled(framed, whole.to_image(DETECTOR_PX), DETECTOR_PX)
        answers = self._detector(image.astype(np.float32) / 127.5 - 1)
        scores = _sigmoid(answers[(len(self._cells), 1)][:, 0])
        good = np.flatnonzero(scores >= MIN_SCORE)
        if not len(good):
            return None
        scores, cells = scores[good], self._cells[good]
        # Middle and size of a box round the face, then four points, of which two are for the upper body alone.
        raw = answers[(len(self._cells), 12)][good] / DETECTOR_PX
        middle, size = raw[:, :2] + cells, raw[:, 2:4]
        low, high, best = middle - size / 2, middle + size / 2, int(scores.argmax())
        common = np.clip(np.minimum(high, high[best]) - np.maximum(low, low[best]), 0, None).prod(1)
        near = common / (size.prod(1) + size[best].prod() - common) > MIN_OVERLAP
        points = raw[near, 4:8].reshape(-1, 2, 2) + cells[near, None]
        to_image = whole.to_image(1)
        hips, end = np.average(points, axis=0, weights=scores[near]) @ to_image[:, :2].T + to_image[:, 2]
        along = end - hips
        return Square(
            middle=hips,
            side=2 * SIZE_FACTOR * float(np.hypot(*along)),
            angle=float(np.pi / 2 - np.arctan2(-along[1], along[0])),
        )


class _Network:
    """A TensorFlow Lite model that is in this package's assets."""

    def __init__(self, name: str) -> None:
        model = (resources.files("carecontact") / "assets" / "pose" / name).read_bytes()
        with _quiet_stderr():
            self._interpreter = import_interpreter()(model_content=model, num_threads=1)
            self._interpreter.allocate_tensors()
        self._input = self._interpreter.get_input_details()[0]["index"]
        self._outputs = [row["index"] for row in self._interpreter.get_output_details()]

    def __call__(self, image: F32) -> dict[tuple[int, ...], F32]:
        """Return the answers to one image by their shape, which tells them apart."""
        self._interpreter.set_tensor(self._input, image[None])
        self._interpreter.invoke()
        answers: list[Any] = [self._interpreter.get_tensor(index)[0] for index in self._outputs]
        return {answer.shape: answer for answer in answers}


def import_interpreter() -> Any:
    """Return the class of LiteRT's interpreter. Raises DependencyError if it cannot be imported."""
    try:
        from ai_edge_litert.interpreter import Interpreter
    except (ImportError, OSError) as error:
        why = " ".join(str(error).split()) or type(error).__name__
        raise DependencyError(
            f"the modalities landmarks and masks need ai-edge-litert, which cannot be imported ({why}); "
            "`carecontact doctor` prints the command that installs it"
        ) from None
    return Interpreter


@contextmanager
def _quiet_stderr() -> Iterator[None]:
    """Silence file descriptor 2, where LiteRT's C++ side writes notices when it starts."""
    sys.stderr.flush()
    saved, sink = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(sink, 2)
    try:
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(sink)


def _cells() -> F32:
    """(2254, 2) middles of the detector's boxes, as shares of its image, in the order of its answers."""
    rows = []
    for stride in dict.fromkeys(STRIDES):
        middles = (np.arange(DETECTOR_PX // stride) + 0.5) * stride / DETECTOR_PX
        v, u = np.meshgrid(middles, middles, indexing="ij")
        rows.append(np.repeat(np.stack([u.ravel(), v.ravel()], -1), 2 * STRIDES.count(stride), 0))
    return np.concatenate(rows).astype(np.float32)


def _sampled(framed: U8, to_image: F64, px: int) -> U8:
    """Return the square (px, px, 3) whose pixel (x, y) is an image at ``to_image @ (x, y, 1)``.

    Between pixels it interpolates bilinearly in steps of 1/32 px, as the OpenCV that MediaPipe was built with: they
    decide a tenth of a pixel of the square.

    Args:
        framed: (H + 2, W + 2, 4) the image in a frame of one pixel, which stands for everything beyond its border.
    """
    (a, b, c), (d, e, f) = to_image.astype(np.float32)
    x, y = np.arange(px, dtype=np.float32), np.arange(px, dtype=np.float32)[:, None]
    height, width = framed.shape[0] - 2, framed.shape[1] - 2
    column = np.rint(32 * np.clip(a * x + b * y + c, -1, width)).astype(np.int32)
    row = np.rint(32 * np.clip(d * x + e * y + f, -1, height)).astype(np.int32)
    upper_left = ((row >> 5) * (width + 2) + (column >> 5) + width + 3).astype(np.intp)
    right, below = (column & 31).astype(np.uint32), (row & 31).astype(np.uint32)
    both = right * below
    weights = (1024 - 32 * (right + below) + both, 32 * right - both, 32 * below - both, both)
    # Four bytes a pixel are fetched at once.
    pixels, out = framed.view(np.uint32).ravel(), np.full((3, px, px), 512, np.uint32)
    for offset, weight in zip((0, 1, width + 2, width + 3), weights, strict=True):
        near = pixels[offset:].take(upper_left, mode="clip")
        for channel in range(3):
            out[channel] += (near >> (8 * channel) & 255) * weight
    return np.moveaxis(out >> 10, 0, -1).astype(np.uint8)


def _refined(uv: npt.NDArray[np.floating], heat: npt.NDArray[np.floating]) -> F64:
    """Move each landmark to the mean of its heatmap near it, where the heatmap is sure.

    Args:
        uv: (33, 2) shares of the crop.
        heat: (64, 64, 39) logits, by row, column and point.
    """
    side, reach = len(heat), KERNEL_CELLS // 2
    out = uv.astype(np.float64)
    for point, (u, v) in enumerate((uv * side).astype(int)):
        if not (0 <= u < side and 0 <= v < side):
            continue
        rows, columns = np.arange(max(0, v - reach), v + reach + 1), np.arange(max(0, u - reach), u + reach + 1)
        rows, columns = rows[rows < side], columns[columns < side]
        near = _sigmoid(heat[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1, point])
        if near.max() >= MIN_REFINING:
            out[point] = np.array([near.sum(0) @ columns, near.sum(1) @ rows]) / (side * near.sum())
    return out


def _turn(angle: float) -> F64:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def _sigmoid(logits: F32) -> F32:
    return np.float32(1) / (np.float32(1) + np.exp(-np.clip(logits, -80, 80)))
