"""Stored camera frames as data URIs."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from carecontact.errors import RecordingError

MAX_WIDTH = 640
MAX_BYTES = 90_000
"""Encoded size of one frame; seven tasks then stay under 0.9 MB of base64."""
QUALITIES = (85, 75, 60, 45, 30, 15)


@dataclass(frozen=True, kw_only=True)
class Frame:
    name: str
    text: str
    uri: str


def jpeg_data_uri(image: npt.NDArray[Any], *, max_width: int = MAX_WIDTH) -> str:
    """(H, W, 3) u1 RGB -> ``data:image/jpeg;base64,...``, at most ``max_width`` wide and MAX_BYTES long.

    Raises RecordingError on another shape or dtype, naming it.
    """
    import cv2

    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or not image.size:
        raise RecordingError(f"stored frame has shape {image.shape} and dtype {image.dtype}; valid: (H, W, 3) uint8")
    bgr = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2BGR)
    data = b""
    for width in (max_width, max_width // 2):
        small = bgr
        if bgr.shape[1] > width:
            small = cv2.resize(
                bgr, (width, max(1, round(bgr.shape[0] * width / bgr.shape[1]))), interpolation=cv2.INTER_AREA
            )
        for quality in QUALITIES:
            data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
            if len(data) <= MAX_BYTES:
                return "data:image/jpeg;base64," + base64.b64encode(data).decode()
    return "data:image/jpeg;base64," + base64.b64encode(data).decode()
