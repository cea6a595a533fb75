"""Foam on a region: where it is seen, by colour and depth, along which lanes it is wiped, and how the hand is held over
it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib import import_module
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt

from carecontact.interface.body_view import PerceptionFailure, RegionGeometry
from carecontact.interface.geometry import matrix_from_quat
from carecontact.interface.observation import CameraView
from carecontact.interface.robot import PANDA
from carecontact.policies.motion import UP, tool_quat

# Of scipy, which has no types here, as in policies.voxposer.planner.
ndimage: Any = import_module("scipy.ndimage")

F64 = npt.NDArray[np.float64]
WORD = "foam"

HUES_DEG = {"cyan": (196.0, 26.0), "lime": (129.0, 16.0), "magenta": (339.0, 20.0)}
"""Colours that docs/tasks.md gives foam -> hue angle in CIELAB, and how far from it a lamp of 3000 to 8000 K and
half to full strength shifts it, with a margin; yellow, red and blue lie 12 degrees or more beyond."""
LEAST_SATURATION = 0.75
"""Least saturation (HSV) of foam. The strength of the light does not change it: skin has up to 0.5, a teal garment 0.6,
foam 0.9."""
AROUND_M = 0.06
"""How far from a region's seen surface foam is still looked for: the region's ends are seen to about so much."""
LEAST_PX = 12
"""Smaller spots are the rim of something else."""
NEAREST = 9
"""So many seen points give the height of the skin at a place: depth is noisy."""
MOST_LEAN_RAD = 0.6
"""How far the hand leans at most to press against the skin's normal: the arm has room for that beside the bed."""
SPREAD = 2.0
"""Half of the length of an evenly filled ellipse over the standard deviation along it."""


@dataclass(frozen=True, kw_only=True)
class FoamSeen:
    """A patch of foam, in base."""

    centre_m: F64
    """(3,) on the skin"""
    along: F64
    """(3,) level unit vector along its longer side, toward the region's far end"""
    half_m: tuple[float, float]
    """Half length and half width, seen from above"""
    out: F64
    """(3,) unit vector against which a tool presses: across the region it leans as the skin does, by at
    most MOST_LEAN_RAD"""
    skin_m: F64
    """(N, 3) the skin under it"""

    @property
    def centre_on_skin(self) -> F64:
        """(3,)"""
        return self.on_skin(self.centre_m[None])[0]

    def on_skin(self, places: F64) -> F64:
        """Return places (n, 3) at the height of the skin that is seen nearest to each."""
        away = np.linalg.norm(places[:, None, :2] - self.skin_m[None, :, :2], axis=2)
        nearest = np.argsort(away, axis=1)[:, :NEAREST]
        return np.column_stack([places[:, :2], np.median(self.skin_m[:, 2][nearest], axis=1)])


def names_foam(instruction: str) -> bool:
    return re.search(rf"\b{WORD}\b", instruction.lower()) is not None


def lab(rgb: npt.NDArray[np.uint8]) -> F64:
    """(..., 3) sRGB -> CIELAB under D65 (IEC 61966-2-1, CIE 15)."""
    share = rgb.astype(np.float64) / 255
    linear = np.where(share > 0.04045, ((share + 0.055) / 1.055) ** 2.4, share / 12.92)
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    xyz = linear @ to_xyz.T / [0.9505, 1.0, 1.0890]
    root = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz * (29 / 6) ** 2 / 3 + 4 / 29)
    x, y, z = np.moveaxis(root, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], -1)


def foam_coloured(rgb: npt.NDArray[np.uint8]) -> npt.NDArray[np.bool_]:
    """(H, W) which pixels have the hue and the saturation of foam, however bright it is lit."""
    _, a, b = np.moveaxis(lab(rgb), -1, 0)
    hue, found = np.degrees(np.arctan2(b, a)), np.zeros(rgb.shape[:2], np.bool_)
    for own, tolerance in HUES_DEG.values():
        found |= np.abs((hue - own + 180) % 360 - 180) < tolerance
    brightest = rgb.max(axis=2)
    return found & (np.ptp(rgb, axis=2) > LEAST_SATURATION * brightest) & (brightest > 40)


def find_foam(view: CameraView, region: RegionGeometry) -> FoamSeen:
    """Return the largest spot of foam that lies on a region.

    Args:
        view: must hold rgb, depth and points.

    Raises PerceptionFailure if a modality is missing, or there is no foam there.
    """
    if view.rgb is None or view.depth is None or view.points is None:
        raise PerceptionFailure("foam is found in rgb, depth and points, and one of them is missing")
    finite = np.isfinite(view.depth)
    place = np.full((*view.depth.shape, 3), np.nan)
    place[finite] = view.points
    off = place - region.centre_m
    with np.errstate(invalid="ignore"):
        near = np.abs(off @ region.axis) < region.half_length_m + AROUND_M
        near &= np.abs(off @ region.lateral) < region.radius_m + AROUND_M
    spots, count = ndimage.label(foam_coloured(view.rgb) & near)
    sizes = np.bincount(spots.ravel())[1:]
    if count == 0 or sizes.max() < LEAST_PX:
        raise PerceptionFailure(f"no foam is seen on the {region.region.replace('_', ' ')}")
    points = place[spots == 1 + int(sizes.argmax())]
    middle = np.median(points, axis=0)
    level = points[:, :2] - points[:, :2].mean(axis=0)
    spread, axes = np.linalg.eigh(level.T @ level / len(level))
    along = np.array([*axes[:, 1], 0.0])
    half_m = SPREAD * np.sqrt(spread[::-1])
    normal = np.linalg.eigh(np.cov(points.T))[1][:, 0]
    return FoamSeen(
        centre_m=middle,
        along=along if along @ region.axis >= 0 else -along,
        half_m=(float(half_m[0]), float(half_m[1])),
        out=leant(normal if normal[2] > 0 else -normal, region.axis),
        skin_m=points,
    )


def leant(normal: F64, axis: F64) -> F64:
    """Return the (3,) unit vector that leans across a limb's ``axis`` (3,) toward ``normal`` (3,).

    It leans by at most MOST_LEAN_RAD, and not along the axis: a hand that leans over a joint hits the next limb.
    """
    across = np.cross(UP, axis)
    across /= np.linalg.norm(across)
    lean = float(np.clip(np.arctan2(normal @ across, normal[2]), -MOST_LEAN_RAD, MOST_LEAN_RAD))
    return np.cos(lean) * UP + np.sin(lean) * across


LANE_M = 0.020
"""Distance between two lanes of wiping, at most: what a mitt of 50 to 70 mm surely touches at a few newtons."""
STROKES = 5
"""Strokes in one lane: each end is then reached three times, as often as skin has to be passed to be clean."""
REACH_M = 0.008
"""How far short of the foam's end a stroke ends: the mitt is larger, and beside a joint it meets bone."""
STEP_M = 0.010
"""Distance between the points of a stroke."""


def strokes(foam: FoamSeen) -> list[list[F64]]:
    """Return for each lane its strokes (n, 3) over the skin, to and fro, one beginning where the other ends."""
    found: list[list[F64]] = []
    for start, end in lanes(foam):
        count = max(2, int(np.ceil(np.linalg.norm(end - start) / STEP_M)) + 1)
        there = foam.on_skin(np.linspace(start, end, count))
        found.append(([there, there[::-1]] * STROKES)[:STROKES])
    # The next lane begins at the side where the last one ended.
    return [lane if number % 2 == 0 else [way[::-1] for way in lane] for number, lane in enumerate(found)]


def lanes(foam: FoamSeen) -> list[tuple[F64, F64]]:
    """Return the ends (3,) of each lane along which a tool wipes foam, side by side, on the level of its middle."""
    count = max(1, int(np.ceil(2 * foam.half_m[1] / LANE_M - 0.25)))
    across = np.array([-foam.along[1], foam.along[0], 0.0])
    offsets = (np.arange(count) - (count - 1) / 2) * 2 * foam.half_m[1] / count
    reach = max(foam.half_m[0] - REACH_M, STEP_M) * foam.along
    return [(foam.centre_m + x * across - reach, foam.centre_m + x * across + reach) for x in offsets.tolist()]


# How the hand is held over foam: against the skin's normal, and turned or upright where the person leaves no room.

LEANS = (1.0, 0.5, 0.0)
"""Shares of the way from straight up to the skin's normal."""
YAWS_DEG = (0, 45, -45, 90, -90)
"""Turns about the tool's axis from where the wrist is near the middle of its range."""
CLEAR_M = 0.030
"""Enough room: twice the 15 mm by which the deepest breath moves the chest."""
NEAR_M = 0.35
"""Farther from the foam than this, neither the hand nor the last links are."""


def holds(foam: FoamSeen, person: F64) -> list[tuple[F64, F64]]:
    """Return orientations (4,) of the tool with the (3,) unit vectors against which it presses, the best one first.

    Those with room for hand and last links come first, from the least turned and the least raised one on, and then the
    others, from the most room on.

    Args:
        person: (N, 3) seen points of the person in base [m].
    """
    near = person[np.linalg.norm(person - foam.centre_m, axis=1) < NEAR_M]
    places, radial = foam.on_skin(np.vstack(lanes(foam))), np.arctan2(foam.centre_m[1], foam.centre_m[0])
    ways = sorted(product(LEANS, YAWS_DEG), key=lambda way: 2 * (1 - way[0]) + abs(way[1]) / 90)
    found: list[tuple[float, F64, F64]] = []
    for lean, yaw in ways:
        out = lean * foam.out + (1 - lean) * UP
        out /= np.linalg.norm(out)
        turned = radial + np.radians(yaw)
        quat = tool_quat(-out, np.array([np.cos(turned), np.sin(turned), 0.0]))
        found.append((min(CLEAR_M, room(near, places, quat)), quat, out))
    return [(quat, out) for _, quat, out in sorted(found, key=lambda way: -way[0])]


def room(person: F64, places: F64, quat: F64) -> float:
    """Return the distance [m] of hand and last links from a person (N, 3), below 0 inside of it, with the tool's tip at
    the nearest of places (n, 3). Fewer points than NEAREST are noise."""
    least = np.inf
    for place in places:
        off = (person - place) @ matrix_from_quat(quat)
        for half_m, behind_m in PANDA.hand_boxes_m[1:]:  # the fingers are in the tool
            gap = np.abs(off + [0.0, 0.0, behind_m]) - half_m
            apart = np.linalg.norm(np.maximum(gap, 0.0), axis=1) + np.minimum(gap.max(axis=1), 0.0)
            least = min([least, *np.sort(apart)[NEAREST : NEAREST + 1]])
    return float(least)
