"""Sharp text and smooth lines on pictures."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from carecontact.plotting import import_matplotlib

Picture = npt.NDArray[np.uint8]
Colour = tuple[int, int, int]
Anchor = Literal["left", "middle", "right"]

PAPER: Colour = (252, 251, 249)
INK: Colour = (34, 36, 40)
SOFT: Colour = (112, 114, 120)
FAINT: Colour = (222, 220, 216)
ACCENT: Colour = (190, 58, 40)
GHOST: Colour = (226, 196, 186)
FRACTION_BITS = 4


@cache
def font(size: int, *, bold: bool = False) -> ImageFont.FreeTypeFont:
    """DejaVu Sans, which matplotlib ships."""
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(import_matplotlib().get_data_path()) / "fonts" / "ttf" / name), size)


def text_width(text: str, size: int, *, bold: bool = False) -> float:
    return font(size, bold=bold).getlength(text)


def write(
    picture: Picture, x: float, y: float, text: str, size: int, *,
    colour: Colour = INK, bold: bool = False, anchor: Anchor = "left",
) -> None:  # fmt: skip
    """Write text in place; (x, y) is on its base line."""
    letters = font(size, bold=bold)
    left, top, right, bottom = letters.getbbox(text, anchor="ls")
    x -= {"left": 0.0, "middle": letters.getlength(text) / 2, "right": letters.getlength(text)}[anchor]
    # Only what the text covers is converted for the drawing library.
    x0, y0 = max(0, int(x + left) - 1), max(0, int(y + top) - 1)
    x1, y1 = min(picture.shape[1], int(x + right) + 2), min(picture.shape[0], int(y + bottom) + 2)
    if x0 >= x1 or y0 >= y1:
        return
    part = Image.fromarray(np.ascontiguousarray(picture[y0:y1, x0:x1]))
    ImageDraw.Draw(part).text((x - x0, y - y0), text, fill=colour, font=letters, anchor="ls")
    picture[y0:y1, x0:x1] = np.asarray(part)


def line(picture: Picture, points: npt.NDArray[np.floating], colour: Colour, *, width: int = 1) -> None:
    """A polyline through (N, 2) pixels, in place."""
    if len(points) > 1:
        fixed = np.round(np.asarray(points) * (1 << FRACTION_BITS)).astype(np.int32)
        cv2.polylines(picture, [fixed], False, colour, width, cv2.LINE_AA, FRACTION_BITS)


def dashes(picture: Picture, x0: float, x1: float, y: float, colour: Colour) -> None:
    """A level dashed line, in place."""
    for x in np.arange(x0, x1, 7.0):
        line(picture, np.array([[x, y], [min(x + 4, x1), y]]), colour)


def dot(picture: Picture, x: float, y: float, radius: float, colour: Colour) -> None:
    scale = 1 << FRACTION_BITS
    centre = (round(x * scale), round(y * scale))
    cv2.circle(picture, centre, round(radius * scale), colour, -1, cv2.LINE_AA, FRACTION_BITS)


def box(picture: Picture, x0: float, y0: float, x1: float, y1: float, colour: Colour) -> None:
    picture[round(y0) : round(y1), round(x0) : round(x1)] = colour


def wrapped(words: str, size: int, width: float, *, bold: bool = False, lines: int = 2) -> list[str]:
    """Text in at most ``lines`` lines of a width [px]; the last ends in an ellipsis where more would follow."""
    out: list[str] = [""]
    for word in words.split():
        longer = f"{out[-1]} {word}".strip()
        if text_width(longer, size, bold=bold) <= width or not out[-1]:
            out[-1] = longer
        elif len(out) < lines:
            out.append(word)
        else:
            out[-1] += " …"
            break
    return out


def faded(picture: Picture, x0: int, y0: int, x1: int, y1: int, colour: Colour, share: float) -> None:
    """Blend a rectangle toward a colour, in place."""
    part = picture[y0:y1, x0:x1].astype(np.float32)
    picture[y0:y1, x0:x1] = (part * (1 - share) + np.array(colour, np.float32) * share).astype(np.uint8)


def heat(values: Iterable[float]) -> npt.NDArray[np.uint8]:
    """(N,) numbers from 0 to 1 -> (N, 3) colours from pale to dark red."""
    table = import_matplotlib().colormaps["YlOrRd"]
    return np.round(255 * table(0.12 + 0.88 * np.clip(np.asarray(list(values)), 0, 1))[:, :3]).astype(np.uint8)
