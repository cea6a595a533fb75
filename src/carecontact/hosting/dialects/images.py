"""Pictures as the clients of openpi and RoboArena send them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from PIL import Image

U8 = npt.NDArray[np.uint8]

CAPTURED_HW = (288, 512)
"""Height and width [px] to which RoboArena's client first resizes every captured picture."""


def cropped_16_9(image: U8) -> U8:
    """Cut an (H, W, 3) picture to 16:9 about its centre, as DROID's cameras have it; one of 16:9 stays as it is."""
    height, width = image.shape[:2]
    high, wide = min(height, width * 9 // 16), min(width, height * 16 // 9)
    top, left = (height - high) // 2, (width - wide) // 2
    return image[top : top + high, left : left + wide]


def padded(image: U8, hw: tuple[int, int]) -> U8:
    """Resize an (H, W, 3) picture without distortion and centre it on black: openpi's ``resize_with_pad``.

    It must be PIL's bilinear filter, which averages over the pixels that it leaves out and OpenCV's does not, with
    sizes rounded down: both choices affect every pixel.
    """
    height, width = hw
    if image.shape[:2] == hw:
        return image
    ratio = max(image.shape[1] / width, image.shape[0] / height)
    high, wide = int(image.shape[0] / ratio), int(image.shape[1] / ratio)
    out = np.zeros((height, width, 3), np.uint8)
    top, left = int((height - high) / 2), int((width - wide) / 2)
    out[top : top + high, left : left + wide] = _resized(image, (high, wide), Image.Resampling.BILINEAR)
    return out


def stretched(image: U8, hw: tuple[int, int] | None) -> U8:
    """Resize an (H, W, 3) picture to the captured size and then to ``hw`` without regard to its shape, as RoboArena
    does.

    ``hw``: None for a server that takes pictures as they were captured.
    """
    captured = _resized(image, CAPTURED_HW, Image.Resampling.LANCZOS)
    return captured if hw is None or hw == CAPTURED_HW else _resized(captured, hw, Image.Resampling.LANCZOS)


def _resized(image: U8, hw: tuple[int, int], method: Image.Resampling) -> U8:
    return np.asarray(Image.fromarray(np.ascontiguousarray(image)).resize((hw[1], hw[0]), resample=method))
