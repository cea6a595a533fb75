"""Finds the joints of a person in an image: an estimator protocol and its default, MediaPipe Pose."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from types import ModuleType
from typing import Any
from typing import Protocol as TypingProtocol

import numpy as np
import numpy.typing as npt

from carecontact.errors import DependencyError
from carecontact.interface.observation import F32, U8

LANDMARK_COUNT = 33
ROTATIONS = (0, 1, 3)
"""Quarter turns that are tried: the detector was trained on upright people, a patient lies at any angle to a camera."""
CROP_MARGIN = 0.15
"""Added round the first pass's person, as a share of its larger side."""
MIN_DETECTION_CONFIDENCE = 0.5
NEEDLESS = ("matplotlib", "matplotlib.pyplot", "mediapipe.tasks", "mediapipe.tasks.python")
"""What MediaPipe imports for its drawing functions and its newer interface, of which Pose uses none: a second or more
of every trial. The newer interface looks for a sound card's library, too, with the help of a compiler."""


@dataclass(frozen=True, kw_only=True)
class KeyPoints:
    landmarks: F32
    """(33, 3): u [px], v [px], visibility in [0, 1]; MediaPipe Pose order; all NaN when no person was found."""
    person: F32
    """(H, W) probability that a pixel shows the person."""


class KeypointEstimator(TypingProtocol):
    def estimate(self, rgb: U8) -> KeyPoints:
        """Estimate key points from one (H, W, 3) image alone."""
        ...


def no_person(height: int, width: int) -> KeyPoints:
    return KeyPoints(
        landmarks=np.full((LANDMARK_COUNT, 3), np.nan, np.float32), person=np.zeros((height, width), np.float32)
    )


@contextmanager
def _quiet_stderr() -> Iterator[None]:
    """Silence file descriptor 2: MediaPipe's C++ side writes start-up notices there whatever its log level is."""
    sys.stderr.flush()
    saved = os.dup(2)
    sink = os.open(os.devnull, os.O_WRONLY)
    os.dup2(sink, 2)
    try:
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(sink)


@contextmanager
def _without_needless() -> Iterator[None]:
    """Keep MediaPipe from importing NEEDLESS."""
    stand_ins = {name: ModuleType(name) for name in NEEDLESS if name not in sys.modules}
    sys.modules.update(stand_ins)
    try:
        yield
    finally:
        for name, stand_in in stand_ins.items():
            if sys.modules.get(name) is stand_in:
                del sys.modules[name]


def unrotate(uv: npt.NDArray[np.float64], quarter_turns: int, height: int, width: int) -> npt.NDArray[np.float64]:
    """(N, 2) pixels of ``np.rot90(image, quarter_turns)`` -> pixels of the (height, width) image."""
    u, v = uv[:, 0], uv[:, 1]
    turned = ((u, v), (width - 1 - v, u), (width - 1 - u, height - 1 - v), (v, height - 1 - u))
    return np.stack(turned[quarter_turns % 4], -1)


def import_pose() -> Any:
    """MediaPipe's class, which no thread belongs to before an object of it is made.

    Raises DependencyError if MediaPipe is not installed, or is installed and cannot be imported.
    """
    os.environ.setdefault("GLOG_minloglevel", "3")
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    try:
        with _quiet_stderr(), _without_needless():
            from mediapipe.python.solutions.pose import Pose
    except ModuleNotFoundError as error:
        raise DependencyError(
            f"the modalities landmarks and masks need MediaPipe, and {error.name} is not installed; "
            "`carecontact doctor` prints the command that installs it"
        ) from None
    except (ImportError, OSError) as error:
        why = " ".join(str(error).split()) or type(error).__name__
        raise DependencyError(
            f"the modalities landmarks and masks need MediaPipe, which is installed but cannot be imported ({why}); "
            "`carecontact doctor` says what is wrong"
        ) from None
    return Pose


class MediaPipePose:
    """MediaPipe Pose 0.10.21, the model its wheel carries: median over three rotations, then again on a crop.

    The person lies, so single views scatter: the median and the second pass at higher resolution steady them. The graph
    is built at the first image. Landmarks are NaN when no person is found.
    """

    def __init__(self) -> None:
        self._graph: Any = None

    def estimate(self, rgb: U8) -> KeyPoints:
        height, width = rgb.shape[:2]
        coarse = self._vote(rgb)
        if coarse is None:
            return no_person(height, width)
        left, top, right, bottom = _crop_box(coarse.landmarks[:, :2], height, width)
        fine = self._vote(rgb[top:bottom, left:right])
        if fine is None:
            return coarse
        landmarks = fine.landmarks.copy()
        landmarks[:, :2] += np.array([left, top], np.float32)
        person = np.zeros((height, width), np.float32)
        person[top:bottom, left:right] = fine.person
        return KeyPoints(landmarks=landmarks, person=person)

    def close(self) -> None:
        if self._graph is not None:
            self._graph.close()
            self._graph = None

    def _vote(self, rgb: U8) -> KeyPoints | None:
        found = [result for turns in ROTATIONS if (result := self._single(rgb, turns)) is not None]
        if not found:
            return None
        return KeyPoints(landmarks=_median([f.landmarks for f in found]), person=_median([f.person for f in found]))

    def _single(self, rgb: U8, turns: int) -> KeyPoints | None:
        turned = np.ascontiguousarray(np.rot90(rgb, turns))
        result = self._process(turned)
        if result.pose_landmarks is None:
            return None
        scale = np.array([turned.shape[1], turned.shape[0]])
        raw = np.array([[mark.x, mark.y, mark.visibility] for mark in result.pose_landmarks.landmark])
        # MediaPipe counts from the image's edge, we count from the centre of the first pixel.
        uv = unrotate(raw[:, :2] * scale - 0.5, turns, rgb.shape[0], rgb.shape[1])
        landmarks = np.column_stack([uv, raw[:, 2]]).astype(np.float32)
        return KeyPoints(landmarks=landmarks, person=np.rot90(result.segmentation_mask, -turns).astype(np.float32))

    def _process(self, rgb: U8) -> Any:
        if self._graph is not None:
            return self._graph.process(rgb)
        pose = import_pose()
        with _quiet_stderr():
            self._graph = pose(
                static_image_mode=True,
                model_complexity=1,
                enable_segmentation=True,
                min_detection_confidence=MIN_DETECTION_CONFIDENCE,
            )
            return self._graph.process(rgb)


def _median(views: Sequence[F32]) -> F32:
    if len(views) != 3:
        return np.median(views, axis=0).astype(np.float32)
    # The same number, found twenty times as fast.
    a, b, c = views
    return np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), c))


def _crop_box(uv: F32, height: int, width: int) -> tuple[int, int, int, int]:
    """left, top, right, bottom [px] round the landmarks, inside the image."""
    low, high = uv.min(0), uv.max(0)
    margin = CROP_MARGIN * float((high - low).max())
    left, top = np.clip(np.floor(low - margin), 0, [width - 2, height - 2]).astype(int)
    right, bottom = np.clip(np.ceil(high + margin), [left + 2, top + 2], [width, height]).astype(int)
    return int(left), int(top), int(right), int(bottom)
