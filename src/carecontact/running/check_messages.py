"""Shows the content of a message to or from a policy in words, and its pictures on a sheet, pixel for pixel."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from carecontact.errors import ConfigError, ContractError
from carecontact.interface.observation import F64, U8
from carecontact.interface.policy import CAMERAS, PolicyCard
from carecontact.serving import vla_eval
from carecontact.serving.conversation import readable
from carecontact.serving.dialect import profile_of
from carecontact.serving.packing import is_array, is_list, is_map
from carecontact.serving.sent_message import dialect_of, unpacked_message

SHOWN_CHARS = 80
DIALECTS = ("openpi", "roboarena", "vla-eval")
MARGIN_PX, LINE_PX, TEXT_PX, ROW_PX = 16, 18, 14, 1400
PAPER, INK, FRAME = (255, 255, 255), (31, 42, 54), (220, 0, 160)
"""Colours of the sheet. The frame lies around the pixels of a picture and covers none."""


def leaves(value: object, *, prefix: str = "") -> dict[str, object]:
    """Return name -> value of every entry that is no map; keys of nested maps are joined with dots."""
    if not is_map(value):
        return {prefix: value}
    found: dict[str, object] = {}
    for key, inner in value.items():
        found |= leaves(inner, prefix=f"{prefix}.{key}" if prefix else str(key))
    return found


def decoded(frame: bytes | str, scheme: str) -> dict[str, object]:
    """Return the leaves of a frame; none if it cannot be decoded. ``scheme``: of the address, or ``ws``."""
    if isinstance(frame, str):
        return {}
    try:
        return leaves(unpacked_message(frame, scheme if scheme in DIALECTS else ""))
    except ContractError:
        return {}


def chunk_of(frame: bytes | str | None, scheme: str) -> F64 | None:
    """Return the numbers (steps, columns) of a dialect's answer, unchanged; None if it has no such array."""
    found = {} if frame is None else decoded(frame, scheme)
    array = next((found[name] for name in ("actions", "payload.actions", "") if name in found), None)
    if not is_array(array) or array.dtype.kind not in "fiu" or array.ndim not in (1, 2) or not array.size:
        return None
    with np.errstate(invalid="ignore"):
        return np.atleast_2d(array).astype(np.float64)


def pictures(sent: dict[str, object]) -> dict[str, U8]:
    """Return key -> picture (H, W, 3) for every picture among the leaves of a message."""
    return {
        key: value
        for key, value in sent.items()
        if is_array(value) and value.dtype == np.uint8 and value.ndim == 3 and value.shape[2] == 3
    }


def camera_names(card: PolicyCard) -> dict[str, str]:
    """Return key of a picture -> name of our camera."""
    dialect = dialect_of(card.arguments)
    if dialect == "vla-eval":
        return {f"payload.images.{name}": ours for ours, name in vla_eval.images_of(CAMERAS, card.arguments).items()}
    if dialect:
        return {key: name for name, key in profile_of(card.arguments).picture_keys.items()}
    return {f"observation.cameras.{name}.rgb": name for name in card.cameras}


def described(value: object) -> str:
    """Describe one leaf in a few words: kind, shape and range, or the text."""
    if is_array(value):
        if not value.size or value.dtype.kind not in "fiu":
            return f"{value.dtype.name} {value.shape}"
        known = value[np.isfinite(value)]
        span = f"{known.min():.4g} to {known.max():.4g}" if known.size else "no number"
        return f"{value.dtype.name} {value.shape}, {span}"
    if is_list(value):
        value = [int(v) if isinstance(v, bool | np.bool_) else v for v in value]
    return readable(repr(value)[:SHOWN_CHARS] + ("..." if len(repr(value)) > SHOWN_CHARS else ""))


def listed(found: dict[str, object]) -> list[str]:
    names = {key: readable(key[:SHOWN_CHARS]) for key in found}
    width = max(map(len, names.values()), default=0)
    return [f"{names[key]:{width}}  {described(value)}" for key, value in found.items()]


def check_sheet_path(path: Path) -> Path:
    if path.suffix.lower() != ".png":
        raise ConfigError(f"--pictures {path}: expected a name that ends in .png, which keeps every pixel")
    if not path.resolve().parent.is_dir():
        raise ConfigError(f"--pictures {path}: there is no folder {path.parent}")
    return path


def save_sheet(
    found: Mapping[str, U8],
    path: Path,
    *,
    names: Mapping[str, str],
    title: str,
    enlarged: Mapping[str, tuple[U8, str]] | None = None,
) -> None:
    """Write all pictures (H, W, 3) beside each other, row after row, each at its own size and under its key; below
    them, the enlarged copies with what is drawn into them, and their captions. ``names``: key -> our camera."""
    font = ImageFont.load_default(size=TEXT_PX)
    shown: list[tuple[str, str, U8]] = []
    for key, image in found.items():
        camera = f"camera {names[key]}, " if key in names else ""
        shown.append((key, f"{camera}{image.shape[1]} x {image.shape[0]} pixels", image))
    copies = [(f"{key}, enlarged", caption, image) for key, (image, caption) in (enlarged or {}).items()]
    x, y, row_px, width = MARGIN_PX, 2 * MARGIN_PX + LINE_PX, 0, int(font.getlength(title)) + 2 * MARGIN_PX
    placed: list[tuple[int, int, tuple[str, str], U8]] = []
    for number, (key, text, image) in enumerate(shown + copies):
        wide = max(image.shape[1], *(int(font.getlength(line)) for line in (key, text)))
        if x > MARGIN_PX and (x + wide + MARGIN_PX > ROW_PX or number == len(shown)):
            x, y, row_px = MARGIN_PX, y + row_px + MARGIN_PX, 0
        placed.append((x, y, (key, text), image))
        x, row_px = x + wide + MARGIN_PX, max(row_px, image.shape[0] + 2 * LINE_PX + 4)
        width = max(width, x)
    sheet = Image.new("RGB", (width, y + row_px + MARGIN_PX), PAPER)
    draw = ImageDraw.Draw(sheet)
    draw.text((MARGIN_PX, MARGIN_PX), title, INK, font)
    for x, y, label, image in placed:
        for i, line in enumerate(label):
            draw.text((x, y + i * LINE_PX), line, INK, font)
        top, (high, wide) = y + 2 * LINE_PX + 2, image.shape[:2]
        draw.rectangle((x - 1, top - 1, x + wide, top + high), outline=FRAME)
        sheet.paste(Image.fromarray(np.ascontiguousarray(image)), (x, top))
    try:
        sheet.save(path)
    except OSError as error:
        raise ConfigError(f"--pictures {path}: {error.strerror or error}") from None
