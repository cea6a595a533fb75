"""Encoded pictures, areas shrunk to fewer pixels, and lines without jagged edges."""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw

Picture = npt.NDArray[np.uint8]
FINENESS = 4
"""Lines are drawn with so many times the pixels and averaged."""


def png(image: Picture) -> bytes:
    """Encode (H, W, 3) or (H, W, 4) without loss. The level of compression favours speed."""
    out = BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(out, "png", compress_level=4)
    return out.getvalue()


def jpeg(image: Picture, quality: int) -> bytes:
    """Encode (H, W, 3) with a quality from 1 to 95."""
    out = BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(out, "jpeg", quality=quality)
    return out.getvalue()


def decoded(data: bytes) -> Picture:
    """Return the RGB picture (H, W, 3) in a PNG or JPEG file. Raises OSError where there is none."""
    try:
        with Image.open(BytesIO(data)) as picture:
            return np.array(picture.convert("RGB"))
    except (SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise OSError(str(error)) from None


def shrunk(image: Picture, width: int) -> Picture:
    """Return the picture (H, W, 3) with fewer pixels, each the mean of those that it covers, and the same shape."""
    size = (width, max(1, round(image.shape[0] * width / image.shape[1])))
    return np.array(Image.fromarray(np.ascontiguousarray(image)).resize(size, Image.Resampling.BOX))


def coverage(shape: tuple[int, int], draw: Callable[[ImageDraw.ImageDraw], None]) -> Picture:
    """Return how much of each pixel (height, width) what ``draw`` draws covers, from 0 to 255.

    ``draw`` receives a canvas with FINENESS times the pixels, on which the middle of pixel (x, y) lies at
    ``fine(x, y)``, and fills with 255.
    """
    canvas = Image.new("L", (FINENESS * shape[1], FINENESS * shape[0]))
    draw(ImageDraw.Draw(canvas))
    return np.array(canvas.reduce(FINENESS))


def fine(points: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
    """(..., 2) points in pixels, whose middles are whole numbers -> points of the canvas of ``coverage``."""
    return (np.asarray(points, np.float64) + 0.5) * FINENESS - 0.5
