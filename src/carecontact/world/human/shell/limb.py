"""The shell of a limb: a tube around it, sampled by rays from the line through the centres of its cross-sections."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from carecontact.contract.protocol import Tissue
from carecontact.contract.rays import Triangles
from carecontact.regions import Tube
from carecontact.world.human.body import Array, Body
from carecontact.world.human.shell.shell import ROW_RATIO, SMOOTHING_M, Shell, finish, spacing
from carecontact.world.human.surface_mesh import distance_outside, graded, graded_from_middle, smooth_field

SHELL_HALF_DEG = 150.0
FINE_HALF_LENGTH_M, FINE_HALF_ROUND_DEG = 0.085, 60.0
"""Half length and half angle of the fine patch for tools from above: scrub strokes of +-60 mm plus two tool radii, and
the part of the circumference that a tool from above touches."""
SIDE_HALF_LENGTH_M, SIDE_HALF_ROUND_DEG = 0.035, 100.0
"""Half length and half angle of the fine patch at mid-length of a limb that is pushed sideways."""
SAMPLES = (41, 61)
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
        """Return the line through the centres of the cross-sections (midpoints of opposite surface points) as a cubic
        along the limb.
        """
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
    sections = np.linspace(limb.low, limb.high, SAMPLES[0])
    line = limb.centre_line(surface, sections)
    turns = np.linspace(-np.pi, np.pi, SAMPLES[1])
    directions = limb.directions(turns)
    measured = np.array([surface.first_hits(centre, directions) for centre in line(sections)])
    radius = float(np.median(measured[len(sections) // 2]))
    sigma = SMOOTHING_M / np.ptp(sections), SMOOTHING_M / (2 * np.pi * radius)
    radius_at = smooth_field(sections, turns, measured, sigma=sigma, wrap=True)

    t = graded(limb.low, limb.high, lambda u: ROW_RATIO * spacing(tissue, _away(limb, tube, u, np.zeros(len(u)), 1.0)))
    angles = _angles(limb, tube, tissue, t, radius_at)
    radii = [radius_at(at, theta) for at, theta in zip(t, angles, strict=True)]
    rows = [
        centre + distance[:, None] * limb.directions(theta)
        for centre, distance, theta in zip(line(t), radii, angles, strict=True)
    ]
    counts = [len(theta) for theta in angles]
    grid = np.stack([np.repeat(t, counts), np.concatenate(angles)], 1)
    x = limb.frame[:, 0]
    centre = line(np.array([limb.middle * limb.length]))[0] - limb.start
    return finish(
        rows, grid - [limb.low, 0.0],
        fine=_away(limb, tube, grid[:, 0], grid[:, 1], radius) <= 1e-9,
        axis_points=np.repeat(line(t), counts, 0),
        origin=limb.start + limb.middle * limb.along + (centre - (centre @ x) * x), frame=limb.frame,
        length=limb.region_length, radius=radius, depth=float(radius_at(limb.middle * limb.length, np.zeros(1))[0]),
    )  # fmt: skip


def _away(limb: _Limb, tube: Tube, t: Array, theta: Array, radius: float) -> Array:
    """Return the distance (n,) [m] from the fine patch along the surface; 0 inside it."""

    def outside(middle: float, half_length: float, half_deg: float) -> Array:
        round_ = distance_outside(theta, np.radians(half_deg)) * radius
        return np.hypot(distance_outside(t - middle, half_length), round_)

    top = outside(*limb.fine, FINE_HALF_ROUND_DEG)
    side = (limb.low + limb.high) / 2, SIDE_HALF_LENGTH_M, SIDE_HALF_ROUND_DEG
    return np.minimum(top, outside(*side)) if tube.pushed_from_side else top


def _angles(
    limb: _Limb, tube: Tube, tissue: Tissue, t: Array, radius_at: Callable[[float | Array, Array], Array]
) -> list[Array]:
    """Return the angles [rad] of each row's points."""
    angles = []
    for i, at in enumerate(t):

        def step(theta: Array, at=at) -> Array:
            distance = radius_at(at, theta)
            return spacing(tissue, _away(limb, tube, at, theta, float(np.median(distance)))) / distance

        angles.append(graded_from_middle(np.radians(SHELL_HALF_DEG), step, half_step=bool(i % 2)))
    return angles
