"""H.264 in an MP4 file, and animated GIF."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from fractions import Fraction
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from carecontact.errors import DependencyError, RecordingError
from carecontact.replaying.film.ink import Picture

PRESET, QUALITY = "veryfast", "18"
"""Settings of x264: a constant quality at which text stays sharp."""
PART = ".part"
"""Ending of the name of a file that is still being written."""


def pyav() -> Any:
    """Raises DependencyError where the extra is not installed."""
    try:
        return import_module("av")
    except ModuleNotFoundError:
        raise DependencyError("a video needs PyAV: pip install 'carecontact[viz]'") from None


def write_mp4(path: Path, frames: Iterable[Picture], *, fps: float, comment: Callable[[], str] | str) -> None:
    """Write a video as a whole or not at all.

    Args:
        frames: (H, W, 3) each, of one size with even sides.
        comment: kept in the file's metadata, where ``comment_of`` finds it.
    """
    av, part = pyav(), path.with_name(path.name + PART)
    rate = Fraction(fps).limit_denominator(1000)
    try:
        with av.open(str(part), "w", format="mp4", options={"movflags": "faststart"}) as file:
            stream: Any = None
            file.metadata["comment"] = comment if isinstance(comment, str) else comment()
            for picture in frames:
                if stream is None:
                    stream = file.add_stream("libx264", rate=rate, options={"preset": PRESET, "crf": QUALITY})
                    stream.height, stream.width = picture.shape[:2]
                    stream.pix_fmt = "yuv420p"
                file.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
            if stream is not None:
                file.mux(stream.encode())
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def comment_of(path: Path) -> str | None:
    """Return the comment that a video was written with; None for no video or an unreadable one."""
    av = pyav()
    try:
        with av.open(str(path)) as file:
            return file.metadata.get("comment")
    except (OSError, av.error.FFmpegError):
        return None


def write_gif(path: Path, frames: Iterable[Picture], *, fps: float, colours: int = 128) -> None:
    """Write a looping animation with one palette for all frames.

    Raises RecordingError where there is no frame.
    """
    pictures = [Image.fromarray(frame) for frame in frames]
    if not pictures:
        raise RecordingError(f"{path}: no frame to write")
    few = pictures[:: max(1, len(pictures) // 8)]
    sheet = Image.fromarray(np.vstack([np.asarray(picture) for picture in few]))
    palette = sheet.quantize(colours, method=Image.Quantize.MEDIANCUT)
    reduced = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    part = path.with_name(path.name + PART)
    reduced[0].save(
        part, format="GIF", save_all=True, append_images=reduced[1:], duration=round(1000 / fps), loop=0, optimize=True
    )
    os.replace(part, path)
