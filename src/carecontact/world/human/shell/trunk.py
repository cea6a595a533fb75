"""The shell of the abdomen: a patch sampled by rays from the trunk's back plane to its front."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from carecontact.contract.protocol import Tissue
from carecontact.contract.rays import Triangles
from carecontact.world.human.body import Array, Body
from carecontact.world.human.shell.shell import ROW_RATIO, SMOOTHING_M, Shell, finish, spacing
from carecontact.world.human.surface_mesh import (
    bridged,
    distance_outside,
    graded,
    graded_from_middle,
    smooth_field,
)

WIDTH_SHARE = 0.82
"""Half width of the patch as a share of the narrowest section's half breadth: the trunk's side, farther out, cannot be
sampled by rays from behind."""
FINE_HALF_WIDTH_M, FINE_MARGIN_M = 0.080, 0.03
"""Largest half width of the fine patch, and its least distance from the shell's border."""
SAMPLES = 41
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

    t = graded(low, high, step_along)
    across = []
    for i, height in enumerate(t):

        def step(s: Array, height=height) -> Array:
            at = np.stack([np.full(len(s), height), s], 1)
            return spacing(tissue, belly.away(height, s)) / slant(at - [0, 1e-3], at + [0, 1e-3])

        across.append(graded_from_middle(belly.half_width, step, half_step=bool(i % 2)))
    feet = [belly.foot(height, s) for height, s in zip(t, across, strict=True)]
    rows = [foot + depth_at(height, s)[:, None] * z for foot, height, s in zip(feet, t, across, strict=True)]
    grid = np.stack([np.repeat(t, [len(s) for s in across]), np.concatenate(across)], 1)
    return finish(
        rows, grid - [low, 0.0],
        fine=belly.away(grid[:, 0], grid[:, 1]) <= 1e-9, axis_points=np.concatenate(feet),
        origin=back + (low + high) / 2 * x, frame=frame, length=high - low,
        radius=belly.half_width, depth=float(depth_at((low + high) / 2, np.zeros(1))[0]),
    )  # fmt: skip


def _depth(body: Body, belly: _Belly) -> Callable[[float | Array, Array], Array]:
    """Return a function that gives the smoothed distance [m] of the skin from the back plane at heights and
    breadths.
    """
    low, high = belly.low, belly.high
    faces = body.vertices[body.faces]
    triangles = faces[
        (np.abs(faces[:, :, 2].mean(1) - (low + high) / 2) < (high - low) / 2 + 0.04)
        & (np.abs(faces[:, :, 0].mean(1)) < 0.2)
    ]
    heights = np.linspace(low, high, SAMPLES)
    breadths = np.linspace(-belly.half_width, belly.half_width, SAMPLES)
    surface, ahead = Triangles(triangles), np.repeat(belly.frame[None, :, 2], SAMPLES, 0)
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
