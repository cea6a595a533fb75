"""Finds the joints of a person in an image: an estimator protocol and its default, the networks of MediaPipe Pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol as TypingProtocol

import numpy as np
import numpy.typing as npt

from carecontact.interface.observation import F32, U8
from carecontact.sensing.blazepose import LANDMARK_COUNT, BlazePose, Found

ROTATIONS = (0, 1, 3)
"""Quarter turns that are tried: the detector was trained on upright people, a patient lies at any angle to a camera."""
CROP_MARGIN = 0.15
"""Added round the first pass's person, as a share of its larger side."""


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


def unrotate(uv: npt.NDArray[np.float64], quarter_turns: int, height: int, width: int) -> npt.NDArray[np.float64]:
    """(N, 2) pixels of ``np.rot90(image, quarter_turns)`` -> pixels of the (height, width) image."""
    u, v = uv[:, 0], uv[:, 1]
    turned = ((u, v), (width - 1 - v, u), (width - 1 - u, height - 1 - v), (v, height - 1 - u))
    return np.stack(turned[quarter_turns % 4], -1)


class PoseEstimator:
    """BlazePose: the median over three rotations, then again on a crop.

    The person lies, so single views scatter: the median and the second pass at higher resolution steady them. The
    networks are read at the first image. Landmarks are NaN when no person is found.
    """

    def __init__(self) -> None:
        self._pose: BlazePose | None = None

    def estimate(self, rgb: U8) -> KeyPoints:
        height, width = rgb.shape[:2]
        coarse = self._views(rgb)
        if not coarse:
            return no_person(height, width)
        landmarks = _median([view.landmarks for view in coarse])
        left, top, right, bottom = _crop_box(landmarks[:, :2], height, width)
        fine = self._views(rgb[top:bottom, left:right])
        if not fine:
            return KeyPoints(landmarks=landmarks, person=_median([view.person() for view in coarse]))
        landmarks = _median([view.landmarks for view in fine])
        landmarks[:, :2] += np.array([left, top], np.float32)
        person = np.zeros((height, width), np.float32)
        person[top:bottom, left:right] = _median([view.person() for view in fine])
        return KeyPoints(landmarks=landmarks, person=person)

    def _views(self, rgb: U8) -> list[_View]:
        """Return what is found in the image in each rotation that shows a person."""
        self._pose = self._pose or BlazePose()
        found = ((turns, self._pose.find(np.rot90(rgb, turns))) for turns in ROTATIONS)
        return [_View(view, turns, *rgb.shape[:2]) for turns, view in found if view is not None]


class _View:
    """What was found in an image (height, width) that was turned, in the image's own pixels."""

    def __init__(self, found: Found, turns: int, height: int, width: int) -> None:
        self._found, self._turns = found, turns
        # BlazePose counts from the image's edge, we count from the centre of the first pixel.
        uv = unrotate(found.uv - 0.5, turns, height, width)
        self.landmarks = np.column_stack([uv, found.visibility]).astype(np.float32)

    def person(self) -> F32:
        """(height, width) probability that a pixel shows the person. The first pass over an image needs none."""
        return np.rot90(self._found.mask, -self._turns)


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
