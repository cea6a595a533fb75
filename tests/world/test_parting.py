"""Hulls that meet in planes: no surface is lost, and none is carried by two plates."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from carecontact.world.human.body import Body
from carecontact.world.human.parting import Plane, below, clipped, girdle, parted
from carecontact.world.human.shell import belly_half_width, belly_span

APART_M = 1e-6


def inside(points: np.ndarray, hull: np.ndarray) -> np.ndarray:
    """Whether points (n, 3) lie inside the convex hull of others, by more than APART_M."""
    planes = ConvexHull(hull).equations
    return (points @ planes[:, :3].T + planes[:, 3] < -APART_M).all(1)


def test_edges_are_cut_where_they_cross_a_plane(body: Body) -> None:
    low, _ = belly_span(body)
    points = clipped(body, ("right_thigh",), below(low - 0.13))
    assert points[:, 2].max() == pytest.approx(low - 0.13, abs=1e-9)
    assert (np.abs(points[:, 2] - (low - 0.13)) < 1e-9).sum() > 5
    above = clipped(body, ("right_thigh",), below(low - 0.13).turned)
    assert len(points) + len(above) > len(body.vertices_of("right_thigh"))


def test_no_hull_reaches_into_another_one(body: Body) -> None:
    found = parted(body)
    for side in ("left", "right"):
        names = [f"{side}_{part}" for part in ("chest", "shoulder", "flank", "hip", "thigh")]
        for name in names:
            for other in (n for n in names if n != name):
                assert not inside(found[name], found[other]).any(), (name, other)
    assert not inside(found["left_chest"], found["right_chest"]).any()
    assert not inside(found["left_hip"], found["right_hip"]).any()


def test_no_vertex_of_the_trunks_front_is_left_without_a_plate(body: Body) -> None:
    """Apart from the abdomen's, which its shell covers."""
    low, high = belly_span(body)
    found = np.concatenate(list(parted(body).values()))
    for vertex in body.vertices_of("thorax", "abdomen", "pelvis"):
        bellied = low < vertex[2] < high and abs(vertex[0]) < belly_half_width(body) - 0.01
        if vertex[2] > low - 0.13 and not bellied:
            assert np.linalg.norm(found - vertex, axis=1).min() < 1e-9, vertex


def test_the_plane_between_chest_and_shoulder_leaves_the_joint_to_the_shoulder(body: Body) -> None:
    for side in ("left", "right"):
        plane: Plane = girdle(body, side)
        joint = body.joint_centre[f"{side}_upper_arm"]
        assert np.linalg.norm(plane.normal) == pytest.approx(1.0)
        heights = plane.height_m(np.stack([joint, joint * [0.3, 1, 1], joint - [0, 0, 0.12]]))
        assert heights[0] > 0.015
        assert (heights[1:] < 0).all()
