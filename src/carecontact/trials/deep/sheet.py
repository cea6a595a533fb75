"""Draws the pictures of one request on a sheet, pixel for pixel as they are sent."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from carecontact.errors import ConfigError

U8 = npt.NDArray[np.uint8]
Font = ImageFont.FreeTypeFont | ImageFont.ImageFont

MARGIN_PX, LINE_PX, TEXT_PX, ROW_PX = 16, 18, 14, 1400
PAPER, INK, FRAME = (255, 255, 255), (31, 42, 54), (220, 0, 160)
"""Colours of the sheet. The frame lies around the pixels of a picture and covers none."""


def check_sheet_path(path: Path) -> Path:
    """Return the path. Raises ConfigError for a file format that would lose detail and for a folder that does not
    exist.
    """
    if path.suffix.lower() != ".png":
        raise ConfigError(f"--pictures {path}: expected a name that ends in .png, which keeps every pixel")
    if not path.resolve().parent.is_dir():
        raise ConfigError(f"--pictures {path}: there is no folder {path.parent}")
    return path


def save_sheet(pictures: Mapping[str, U8], path: Path, *, names: Mapping[str, str], title: str) -> None:
    """Write all pictures beside each other, each at its own size and under its key.

    Args:
        pictures: key -> (H, W, 3) red green blue.
        names: key -> name of our camera, where it is known.

    Raises:
        ConfigError: the file cannot be written.
    """
    font = ImageFont.load_default(size=TEXT_PX)
    labels = {
        key: (key, f"{f'camera {names[key]}, ' if key in names else ''}{image.shape[1]} x {image.shape[0]} pixels")
        for key, image in pictures.items()
    }
    place, (width, height) = _places(pictures, labels, title, font)
    sheet = Image.new("RGB", (width, height), PAPER)
    draw = ImageDraw.Draw(sheet)
    draw.text((MARGIN_PX, MARGIN_PX), title, INK, font)
    for key, (x, y) in place.items():
        for i, line in enumerate(labels[key]):
            draw.text((x, y + i * LINE_PX), line, INK, font)
        top, (high, wide) = y + 2 * LINE_PX + 2, pictures[key].shape[:2]
        draw.rectangle((x - 1, top - 1, x + wide, top + high), outline=FRAME)
        sheet.paste(Image.fromarray(np.ascontiguousarray(pictures[key])), (x, top))
    try:
        sheet.save(path)
    except OSError as error:
        raise ConfigError(f"--pictures {path}: {error.strerror or error}") from None


def _places(
    pictures: Mapping[str, U8], labels: Mapping[str, tuple[str, str]], title: str, font: Font
) -> tuple[dict[str, tuple[int, int]], tuple[int, int]]:
    """Return key -> top left corner of its label, row after row, and the width and height of the sheet [px]."""
    x, y, row_px, place = MARGIN_PX, 2 * MARGIN_PX + LINE_PX, 0, {}
    width = int(font.getlength(title)) + 2 * MARGIN_PX
    for key, image in pictures.items():
        wide = max(image.shape[1], *(int(font.getlength(line)) for line in labels[key]))
        if x > MARGIN_PX and x + wide + MARGIN_PX > ROW_PX:
            x, y, row_px = MARGIN_PX, y + row_px + MARGIN_PX, 0
        place[key] = (x, y)
        x, row_px = x + wide + MARGIN_PX, max(row_px, image.shape[0] + 2 * LINE_PX + 4)
        width = max(width, x)
    return place, (width, y + row_px + MARGIN_PX)
