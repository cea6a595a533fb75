"""The meshed surface of a soft region, sampled from the body by rays: around a limb, or over the abdomen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from carecontact.cache import Arrays, cached, source_sha256
from carecontact.human.body import Array, Body
from carecontact.human.mesh import (
    bridged,
    distance_outside,
    graded,
    graded_from_middle,
    normals_and_areas,
    smooth_field,
    zip_rows,
)
from carecontact.human.pose import NOT_TURNED, ArmTurn
from carecontact.interface.geometry import Triangles
from carecontact.interface.regions import REGIONS, Tube
from carecontact.protocol.person import Tissue

GROWTH = 0.4
"""Increase of the spacing [m] for each metre of distance from the fine patch."""
ROW_RATIO = np.sqrt(3) / 2
"""Distance between the rows of a triangular lattice, as a share of the distance between points in a row."""
SMOOTHING_M = 0.012
"""Standard deviation of the smoothing of the sampled surface. The body's own faces are 20 mm wide, and without
smoothing their edges made the force of a press vary by 9 to 16 % from place to place."""


@dataclass(frozen=True, kw_only=True)
class Shell:
    """A surface of triangles, with vertices in rows across the region's axis."""

    vertices: Array
    """(N, 3) mesh frame"""
    normals: Array
    """(N, 3) outward unit"""
    triangles: npt.NDArray[np.int64]
    """(M, 3) wound outward"""
    fine: npt.NDArray[np.bool_]
    """(N,) on the patch that the tool reaches"""
    area: Array
    """(N,) share of the surface [m^2]"""
    axis_points: Array
    """(N, 3) point of the region's axis (abdomen: of its back plane) inward of each vertex"""
    grid: Array
    """(N, 2) place along the axis from the shell's start [m], and across: angle round a limb [rad], on a trunk [m]"""
    frame_origin: Array
    frame: Array
    """(3, 3) columns x (along), y, z (outward at the middle): the region frame in the mesh frame"""
    length_m: float
    radius_m: float
    axis_depth_m: float
    """Depth of the axis under the surface at the middle."""


def spacing(tissue: Tissue, distance: Array) -> Array:
    """Return the (n,) distance between neighbouring vertices [m] at (n,) distances outside the fine patch [m]."""
    return np.clip(tissue.spacing_m + GROWTH * distance, None, tissue.coarse_spacing_m)


Step = Callable[[float, Array], Array]
Ray = Callable[[float, Array], tuple[Array, Array]]


def meshed(
    t: Array, half_width: float, *, step: Step, ray: Ray, away: Callable[[Array, Array], Array], **others: Any
) -> Shell:
    """Return the shell over rows of points at places ``t`` (n,) along a region, each ``half_width`` [rad or m] wide.

    Args:
        step: place of a row, and (n,) places across it -> (n,) widest step there.
        ray: the same -> (n, 3) points of the axis, and the ways (n, 3) from there to the skin.
        away: (n,) places along and across -> (n,) distance from the fine patch [m].
    """
    across = [graded_from_middle(half_width, partial(step, at), half_step=bool(i % 2)) for i, at in enumerate(t)]
    rays = [ray(at, s) for at, s in zip(t, across, strict=True)]
    rows, axis_points = [foot + way for foot, way in rays], np.concatenate([foot for foot, _ in rays])
    grid = np.stack([np.repeat(t, [len(s) for s in across]), np.concatenate(across)], 1)
    vertices, triangles = np.concatenate(rows), zip_rows(rows)
    normals, area = normals_and_areas(vertices, triangles)
    if np.einsum("ij,ij->i", normals, vertices - axis_points).mean() < 0:
        triangles, normals = triangles[:, ::-1], -normals
    return Shell(
        vertices=vertices,
        normals=normals,
        triangles=triangles,
        fine=away(grid[:, 0], grid[:, 1]) <= 1e-9,
        area=area,
        axis_points=axis_points,
        grid=grid - [t[0], 0.0],
        **others,
    )


SHELL_HALF_DEG = 150.0
FINE_HALF_LENGTH_M, FINE_HALF_ROUND_DEG = 0.085, 60.0
"""Half length and half angle of the fine patch for tools from above: scrub strokes of +-60 mm plus two tool radii, and
the part of the circumference that a tool from above touches."""
SIDE_HALF_LENGTH_M, SIDE_HALF_ROUND_DEG = 0.035, 100.0
"""Half length and half angle of the fine patch at mid-length of a limb that is pushed sideways."""
LIMB_SAMPLES = (41, 61)
"""Number of rays along a limb and around it."""


@dataclass(frozen=True, kw_only=True)
class _Limb:
    """A segment's frame in the mesh frame, and which part of it is soft."""

    start: Array
    along: Array
    frame: Array
    """(3, 3) columns x (along), y, z (outward)"""
    low: float
    high: float
    """Ends of the soft part along x [m]."""
    middle: float
    """Middle of the region, as a share of the line to the next joint."""

    @classmethod
    def of(cls, body: Body, segment: str, tube: Tube, outward: Array, middle: float) -> _Limb:
        along = body.axis_vector(segment)
        length = float(np.linalg.norm(along))
        x = along / length
        z = outward - (outward @ x) * x
        z /= np.linalg.norm(z)
        low, high = np.array(tube.span) * length
        frame = np.stack([x, np.cross(z, x), z], 1)
        return cls(start=body.joint_centre[segment], along=along, frame=frame, low=low, high=high, middle=middle)

    @property
    def length(self) -> float:
        return float(np.linalg.norm(self.along))

    @property
    def region_length(self) -> float:
        """Length of the region [m]: it reaches to the next joint, and equally far to the other side of its middle."""
        return 2 * (1 - self.middle) * self.length

    @property
    def fine(self) -> tuple[float, float]:
        """Middle and half length [m] along x of the patch that a tool reaches from above. It lies around the middle of
        the soft part and never nearer to the trunk than the region.
        """
        middle, half = (self.low + self.high) / 2, min(FINE_HALF_LENGTH_M, (self.high - self.low) / 2 - 0.01)
        crowded = self.length - self.region_length - (middle - half)
        return (middle + crowded / 2, half - crowded / 2) if crowded > 0 else (middle, half)

    def directions(self, theta: Array) -> Array:
        """Return unit vectors (n, 3) across the limb at angles [rad] from the outward direction."""
        _, y, z = self.frame.T
        return np.cos(theta)[:, None] * z + np.sin(theta)[:, None] * y

    def surface(self, body: Body) -> Triangles:
        x = self.frame[:, 0]
        faces = body.vertices[body.faces]
        triangles = faces[np.abs((faces.mean(1) - (self.start + self.along / 2)) @ x) < self.length / 2 + 0.03]
        middle = triangles.mean(1) - self.start
        return Triangles(triangles[np.linalg.norm(middle - np.outer(middle @ x, x), axis=1) < 0.12])

    def centre_line(self, surface: Triangles, t: Array) -> Callable[[Array], Array]:
        """Return a cubic along the limb through the centres of its cross-sections (midpoints of opposite points)."""
        x, y, z = self.frame.T
        directions = self.directions(np.linspace(0, 2 * np.pi, 12, endpoint=False))
        off = np.zeros((len(t), 3))
        for _ in range(2):
            for i, at in enumerate(t):
                off[i] += surface.first_hits(self.start + at * x + off[i], directions) @ directions / 6
        fit = np.polynomial.Polynomial.fit
        across = [fit(t, off @ axis, 3) for axis in (y, z)]
        return lambda u: self.start + u[:, None] * x + across[0](u)[:, None] * y + across[1](u)[:, None] * z


def limb_shell(body: Body, segment: str, tube: Tube, outward: Array, tissue: Tissue, *, middle: float = 0.5) -> Shell:
    """Return a tube round a limb, fine where the tool reaches it.

    Args:
        outward: (3,) direction in the mesh frame that faces up in the lying pose.
        middle: middle of the region, as a share of the line to the next joint.
    """
    limb = _Limb.of(body, segment, tube, outward, middle)
    surface = limb.surface(body)
    # The line between joints is off centre, so that angles are measured about the centres of the cross-sections.
    sections = np.linspace(limb.low, limb.high, LIMB_SAMPLES[0])
    line = limb.centre_line(surface, sections)
    turns = np.linspace(-np.pi, np.pi, LIMB_SAMPLES[1])
    directions = limb.directions(turns)
    measured = np.array([surface.first_hits(centre, directions) for centre in line(sections)])
    radius = float(np.median(measured[len(sections) // 2]))
    sigma = SMOOTHING_M / np.ptp(sections), SMOOTHING_M / (2 * np.pi * radius)
    radius_at = smooth_field(sections, turns, measured, sigma=sigma, wrap=True)

    def step_along(u: Array) -> Array:
        return ROW_RATIO * spacing(tissue, _away(limb, tube, u, np.zeros(len(u)), 1.0))

    def step(at: float, theta: Array) -> Array:
        distance = radius_at(at, theta)
        return spacing(tissue, _away(limb, tube, at, theta, float(np.median(distance)))) / distance

    def ray(at: float, theta: Array) -> tuple[Array, Array]:
        way = radius_at(at, theta)[:, None] * limb.directions(theta)
        return np.repeat(line(np.array([at])), len(theta), 0), way

    x, at_middle = limb.frame[:, 0], limb.middle * limb.length
    centre = line(np.array([at_middle]))[0] - limb.start
    return meshed(
        graded(limb.low, limb.high, step_along),
        np.radians(SHELL_HALF_DEG),
        step=step,
        ray=ray,
        away=lambda t, theta: _away(limb, tube, t, theta, radius),
        frame_origin=limb.start + limb.middle * limb.along + (centre - (centre @ x) * x),
        frame=limb.frame,
        length_m=limb.region_length,
        radius_m=radius,
        axis_depth_m=float(radius_at(at_middle, np.zeros(1))[0]),
    )


def _away(limb: _Limb, tube: Tube, t: Array | float, theta: Array, radius: float) -> Array:
    """Return the distance (n,) [m] from the fine patch along the surface; 0 inside it."""

    def outside(middle: float, half_length: float, half_deg: float) -> Array:
        round_ = distance_outside(theta, np.radians(half_deg)) * radius
        return np.hypot(distance_outside(np.asarray(t - middle), half_length), round_)

    top = outside(*limb.fine, FINE_HALF_ROUND_DEG)
    side = (limb.low + limb.high) / 2, SIDE_HALF_LENGTH_M, SIDE_HALF_ROUND_DEG
    return np.minimum(top, outside(*side)) if tube.pushed_from_side else top


WIDTH_SHARE = 0.82
"""Half width of the patch as a share of the narrowest section's half breadth: the trunk's side, farther out, cannot be
sampled by rays from behind."""
FINE_HALF_WIDTH_M, FINE_MARGIN_M = 0.080, 0.03
"""Largest half width of the fine patch, and its least distance from the shell's border."""
TRUNK_SAMPLES = 41
"""Number of rays in each direction over the abdomen."""
NAVEL_BALL_M = 0.20
"""A ball of this radius that rolls over the abdomen spans the navel, and so does the shell: the skin in a navel is a
fold that bears no load, and on its rim a tool met up to 30 % more force. The abdomen of man-adult, which the laws are
fitted on, is lifted by 2.4 mm at most and 0.2 mm in the mean."""


@dataclass(frozen=True, kw_only=True)
class _Belly:
    """Place of the soft patch, and the trunk's back plane from which the skin is measured."""

    low: float
    high: float
    """Ends of the patch, as heights in the mesh frame [m]."""
    half_width: float
    back: Array
    """(3,) point of the back plane at height 0"""
    frame: Array
    """(3, 3) columns x (up the trunk), y, z (outward)"""

    def foot(self, t: Array | float, s: Array) -> Array:
        """Return points (n, 3) of the back plane."""
        x, y, _ = self.frame.T
        return self.back + np.asarray(s)[:, None] * y + np.broadcast_to(t, np.shape(s))[:, None] * x

    def away(self, t: Array | float, s: Array) -> Array:
        """Return the distance (n,) [m] from the fine patch; 0 inside it."""
        half_length = (self.high - self.low) / 2 - FINE_MARGIN_M
        half_width = min(FINE_HALF_WIDTH_M, self.half_width - FINE_MARGIN_M)
        along = distance_outside(np.asarray(t - (self.low + self.high) / 2), half_length)
        return np.hypot(along, distance_outside(s, half_width))


def trunk_shell(body: Body, outward: Array, tissue: Tissue) -> Shell:
    """Return a patch over the abdomen between the lower ribs and the pelvis."""
    x, z = np.array([0.0, 0.0, 1.0]), outward / np.linalg.norm(outward)
    low, high = belly_span(body)
    back = np.array([0.0, body.joint_centre["thorax"][1], 0.0])
    frame = np.stack([x, np.cross(z, x), z], 1)
    belly = _Belly(low=low, high=high, half_width=belly_half_width(body), back=back, frame=frame)
    depth_at = _depth(body, belly)

    def slant(at: Array, to: Array) -> Array:
        """Return the length of the surface for each unit of length of the plane, between points (n, 2) of the plane."""
        gap = np.linalg.norm(to - at, axis=1)
        return np.hypot(1.0, (depth_at(to[:, 0], to[:, 1]) - depth_at(at[:, 0], at[:, 1])) / gap)

    def step_along(u: Array) -> Array:
        middle = np.stack([u, np.zeros(len(u))], 1)
        width = spacing(tissue, belly.away(u, np.zeros(len(u))))
        return ROW_RATIO * width / slant(middle - [1e-3, 0], middle + [1e-3, 0])

    def step(height: float, s: Array) -> Array:
        at = np.stack([np.full(len(s), height), s], 1)
        return spacing(tissue, belly.away(height, s)) / slant(at - [0, 1e-3], at + [0, 1e-3])

    return meshed(
        graded(low, high, step_along),
        belly.half_width,
        step=step,
        ray=lambda height, s: (belly.foot(height, s), depth_at(height, s)[:, None] * z),
        away=belly.away,
        frame_origin=back + (low + high) / 2 * x,
        frame=frame,
        length_m=high - low,
        radius_m=belly.half_width,
        axis_depth_m=float(depth_at((low + high) / 2, np.zeros(1))[0]),
    )


def _depth(body: Body, belly: _Belly) -> Callable[[float | Array, Array], Array]:
    """Return the smoothed distance [m] of the skin from the back plane as a function of height and breadth."""
    low, high = belly.low, belly.high
    faces = body.vertices[body.faces]
    triangles = faces[
        (np.abs(faces[:, :, 2].mean(1) - (low + high) / 2) < (high - low) / 2 + 0.04)
        & (np.abs(faces[:, :, 0].mean(1)) < 0.2)
    ]
    heights = np.linspace(low, high, TRUNK_SAMPLES)
    breadths = np.linspace(-belly.half_width, belly.half_width, TRUNK_SAMPLES)
    surface, ahead = Triangles(triangles), np.repeat(belly.frame[None, :, 2], TRUNK_SAMPLES, 0)
    measured = np.array([surface.first_hits(belly.foot(h, breadths), ahead) for h in heights])
    measured = bridged(heights, breadths, measured, NAVEL_BALL_M)
    sigma = SMOOTHING_M / (high - low), SMOOTHING_M / (2 * belly.half_width)
    return smooth_field(heights, breadths, measured, sigma=sigma, wrap=False)


def belly_span(body: Body) -> tuple[float, float]:
    """Return the heights in the mesh frame between which the trunk's front is soft [m]."""
    return float(body.joint_centre["pelvis"][2]) + 0.02, float(body.joint_centre["thorax"][2]) + 0.07


def belly_half_width(body: Body) -> float:
    """Return half the width of the abdomen's shell [m]."""
    low, high = belly_span(body)
    faces = body.vertices[body.faces_of("pelvis", "abdomen", "thorax", "left_thigh", "right_thigh")]
    heights = np.linspace(low, high, 15)
    middle = np.stack([np.zeros(15), np.full(15, body.joint_centre["thorax"][1]), heights], 1)
    breadth = Triangles(faces).first_hits(middle, np.tile([1.0, 0.0, 0.0], (15, 1)))
    return WIDTH_SHARE * float(breadth.min())


SHAPING = Path(__file__).parent
"""Folder of all modules that shape a person."""


def cached_shell(
    body: Body, region: str, tissue: Tissue, compute: Callable[[], Shell], *, turn: ArmTurn = NOT_TURNED
) -> Shell:
    """Return the shell that ``compute`` gave earlier for the same body, region, tissue, turn of the arm and release; if
    there is none, call it, which takes a tenth of a second, and half a second more to import the splines.
    """
    facts = {
        "body": [body.name, body.sha256],
        "region": [region, repr(REGIONS[region])],
        "tissue": tissue.model_dump(mode="json"),
        "turn": repr(turn),
        "source": source_sha256(SHAPING),
        "numpy": np.__version__,
        "scipy": version("scipy"),
    }

    def arrays() -> Arrays:
        shell = compute()
        return {field.name: np.asarray(getattr(shell, field.name)) for field in fields(Shell)}

    found = cached("shells", facts, arrays)
    values: dict[str, Any] = {name: array if array.ndim else float(array) for name, array in found.items()}
    return Shell(**values)
