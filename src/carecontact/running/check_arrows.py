"""Draws what the deltas of an answer do into enlarged copies of the pictures that are sent."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from carecontact.interface.deltas import DeltaConvention
from carecontact.interface.geometry import pixels
from carecontact.interface.observation import F64, U8, CameraView, Observation
from carecontact.running.check_deltas import AXES, path_of

Sent = Callable[[Observation], Mapping[str, U8]]
"""Observation -> the pictures (H, W, 3) of its message under their keys."""

WIDTH_PX = 640
"""An enlarged picture is about as wide."""
LENGTHS_M = (0.3, 0.2, 0.1, 0.05)
"""Lengths of the arrows; the longest with which no arrow is longer than LONGEST is taken."""
LONGEST = 0.35
"""Largest length of an arrow, as a share of the picture's width."""
NEAREST_M = 0.01
"""Points are drawn that are further before the camera."""
COLOURS = ((230, 30, 30), (20, 160, 40), (40, 80, 235))
PATH, HALO = (200, 0, 200), (255, 255, 255)
"""Colours of +x, +y and +z of an answer, of the way that the whole answer gives, and of the rim around all of them."""
LINE_PX, HEAD_PX, TEXT_PX, SAMPLES = 3, 10, 18, 200


def with_arrows(
    observation: Observation, numbers: F64, convention: DeltaConvention, *, sent: Sent, cameras: Mapping[str, str]
) -> dict[str, tuple[U8, str]]:
    """Return an enlarged copy of each picture with arrows for +x, +y and +z of an answer, from the tool, and the way
    of the answer; and a caption.

    Args:
        numbers: (steps, 6) of the answer.
        cameras: key of a picture -> name of our camera. Pictures of other keys are left out.
    """
    marked = sent(replace(observation, cameras={name: _marked(view) for name, view in observation.cameras.items()}))
    drawn: dict[str, tuple[U8, str]] = {}
    for key, picture in sent(observation).items():
        view = observation.cameras.get(cameras.get(key, ""))
        if view is not None and view.rgb is not None:
            scene = _Scene(observation.pose_tcp_in_base, convention, view, picture, _way(view, marked[key]))
            drawn[key] = scene.drawn(numbers)
    return drawn


def _marked(view: CameraView) -> CameraView:
    """A picture whose red and green say where a pixel is, so that they show where it arrives."""
    if view.rgb is None:
        return view
    high, wide = view.rgb.shape[:2]
    v, u = np.mgrid[:high, :wide]
    marks = np.stack([255 * u / (wide - 1), 255 * v / (high - 1), np.full(u.shape, 255.0)], axis=2)
    return replace(view, rgb=np.round(marks).astype(np.uint8))


def _way(view: CameraView, arrived: U8) -> F64:
    """(2, 3) affine map from pixels of the camera to those of the picture that is sent, found from the marks."""
    assert view.rgb is not None
    high, wide = view.rgb.shape[:2]
    # Rows and columns that were added around the picture have no blue.
    y, x = np.nonzero(arrived[:, :, 2] >= 250)
    came = arrived[y, x, :2] / 255 * [wide - 1, high - 1]
    back = np.linalg.lstsq(np.c_[x, y, np.ones(len(x))], came, rcond=None)[0].T
    turn = np.linalg.inv(back[:, :2])
    return np.c_[turn, -turn @ back[:, 2]]


@dataclass(frozen=True)
class _Scene:
    tool: F64
    """(7,) pose in base."""
    convention: DeltaConvention
    view: CameraView
    picture: U8
    way: F64
    """(2, 3) from pixels of the camera to those of the picture."""

    @property
    def scale(self) -> int:
        return max(1, round(WIDTH_PX / self.picture.shape[1]))

    def drawn(self, numbers: F64) -> tuple[U8, str]:
        scale, (high, wide) = self.scale, self.picture.shape[:2]
        sheet = Image.fromarray(np.ascontiguousarray(self.picture)).resize((scale * wide, scale * high))
        draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=TEXT_PX)
        length = next((size for size in LENGTHS_M if self._longest(size) <= LONGEST * sheet.width), LENGTHS_M[-1])
        shown = [self._line(draw, path_of(numbers, self.tool, self.convention), PATH, sheet.size)]
        for name, tip, colour in zip(AXES, self._tips(length), COLOURS, strict=True):
            end = self._line(draw, np.array([self.tool[:3], tip]), colour, sheet.size)
            shown.append(end)
            if end is not None:
                place = np.clip(end, TEXT_PX, np.array(sheet.size) - TEXT_PX)
                draw.text(tuple(place), f"+{name}", colour, font, anchor="mm", stroke_width=2, stroke_fill=HALO)
        caption = f"arrows of {1000 * length:g} mm: +x red, +y green, +z blue; violet: where this answer goes"
        return np.asarray(sheet), caption if any(end is not None for end in shown) else "the tool is outside"

    def _tips(self, length: float) -> list[F64]:
        units = np.pad(length / self.convention.unit[0] * np.eye(3), ((0, 0), (0, 3)))
        return [self.convention.target(unit, measured=self.tool, last=self.tool)[:3] for unit in units]

    def _longest(self, length: float) -> float:
        """Length [px] of the longest arrow; infinite if one leads behind the camera."""
        places = self._places(np.array([self.tool[:3], *self._tips(length)]))
        return float(np.nan_to_num(np.linalg.norm(places[1:] - places[0], axis=1), nan=np.inf).max())

    def _places(self, points: F64) -> F64:
        """(n, 3) points in base -> (n, 2) in the enlarged picture; NaN behind the camera."""
        camera = self.view.pose_camera_in_base
        ahead = (points - camera[:3, 3]) @ camera[:3, 2] > NEAREST_M
        places = np.full((len(points), 2), np.nan)
        at = pixels(points[ahead], self.view.intrinsics, camera)
        places[ahead] = (at @ self.way[:, :2].T + self.way[:, 2] + 0.5) * self.scale
        return places

    def _line(
        self, draw: ImageDraw.ImageDraw, corners: F64, colour: tuple[int, int, int], size: tuple[int, int]
    ) -> F64 | None:
        """Draw a line as far as it lies in the picture. Return the place (2,) of its label; None if no part is seen."""
        along = np.linspace(0, len(corners) - 1, SAMPLES)
        points = np.stack([np.interp(along, np.arange(len(corners)), column) for column in corners.T], axis=1)
        places = self._places(points)
        inside = np.all((places >= 0) & (places < size), axis=1)
        if not inside.any():
            return None
        first = int(inside.argmax())
        last = first + int(np.append(~inside[first:], True).argmax())
        seen = places[first:last]
        line, end = [tuple(place) for place in seen.tolist()], seen[-1]
        # The direction of the last pixels, in which a head points.
        way = end - seen[np.flatnonzero(np.linalg.norm(seen - end, axis=1) > HEAD_PX / 2)[-1:]].reshape(-1, 2)
        way = way[0] / np.linalg.norm(way[0]) if len(way) else np.zeros(2)
        side = HEAD_PX / 2 * np.array([-way[1], way[0]])
        head = [end + HEAD_PX * way, end + side, end - side]
        ends = last == SAMPLES
        for width, paint in ((LINE_PX + 3, HALO), (LINE_PX, colour)):
            draw.line(line, fill=paint, width=width, joint="curve")
            if ends and len(way) and way.any():
                grown = [tuple(end + (1 if paint == colour else 1.4) * (corner - end)) for corner in head]
                draw.polygon(grown, fill=paint)
            elif ends:
                more = (width + 3) / 2
                draw.ellipse((end[0] - more, end[1] - more, end[0] + more, end[1] + more), fill=paint)
        return end + (HEAD_PX + TEXT_PX) * way if way.any() else end + [0, TEXT_PX]
