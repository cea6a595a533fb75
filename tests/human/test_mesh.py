"""Rows, triangles and smoothing, on shapes with known answers."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from carecontact.human.body import Body
from carecontact.human.library import load_body
from carecontact.human.mesh import (
    bridged,
    distance_outside,
    graded,
    graded_from_middle,
    normals_and_areas,
    refined,
    smooth_field,
    zip_rows,
)
from tests.human.conftest import SOME_QUICK

lengths = st.floats(0.02, 0.5)
steps = st.floats(0.003, 0.05)


@given(st.floats(-1.0, 1.0), lengths, steps)
def test_even_grading_is_even_and_no_finer_than_asked(low: float, length: float, step: float) -> None:
    at = graded(low, low + length, lambda u: np.full(len(u), step))
    np.testing.assert_allclose(np.diff(at), length / (len(at) - 1), rtol=1e-6)
    assert at[0] == low
    assert at[-1] == pytest.approx(low + length)
    assert length / (len(at) - 1) <= step * (1 + 1e-5)
    assert length / max(1, len(at) - 2) >= step * (1 - 1e-5) or len(at) == 2


@given(lengths, steps, st.floats(1.2, 4.0), st.floats(0.1, 0.9))
def test_grading_is_fine_inside_and_coarse_outside(half: float, fine: float, ratio: float, share: float) -> None:
    def spacing(u: np.ndarray) -> np.ndarray:
        return np.clip(fine + 0.4 * distance_outside(u, share * half), None, ratio * fine)

    for half_step in (False, True):
        at = graded_from_middle(half, spacing, half_step=half_step)
        np.testing.assert_allclose(at, -at[::-1], atol=1e-12)
        assert (np.diff(at) > 0).all()
        middle = (at[1:] + at[:-1]) / 2
        # Where the wished spacing grows along a step, a step may be as wide as at its outer end.
        wide = np.maximum(spacing(at[1:]), spacing(at[:-1]))
        assert (np.diff(at) <= wide * (1 + 1e-3)).all(), middle
        assert (0.0 in at) != half_step or len(at) == 2


def test_rows_of_unlike_length_are_zipped_without_gap_or_overlap() -> None:
    rng = np.random.default_rng(0)
    rows = [
        np.stack([np.full(n, 0.1 * k), np.sort(np.r_[0, rng.uniform(0.01, 0.99, n - 2), 1]), np.zeros(n)], 1)
        for k, n in enumerate((3, 9, 4, 4, 12))
    ]
    triangles, points = zip_rows(rows), np.concatenate(rows)
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    signed = np.cross(b - a, c - a)[:, 2] / 2
    assert (np.sign(signed) == np.sign(signed[0])).all()
    assert np.abs(signed).sum() == pytest.approx(0.4)
    shared = Counter(tuple(sorted(e)) for t in triangles for e in ((t[0], t[1]), (t[1], t[2]), (t[2], t[0])))
    assert max(shared.values()) == 2


def test_normals_and_areas_of_a_square() -> None:
    corners = np.array([[0.0, 0, 0], [2, 0, 0], [2, 3, 0], [0, 3, 0]])
    normals, area = normals_and_areas(corners, np.array([[0, 1, 2], [0, 2, 3]]))
    np.testing.assert_allclose(normals, [[0, 0, 1]] * 4)
    np.testing.assert_allclose(area, [2.0, 1.0, 2.0, 1.0])


@pytest.mark.parametrize("wrap", [False, True])
def test_smoothing_keeps_what_is_smooth_and_damps_ripples(wrap: bool) -> None:
    u, v = np.linspace(0, 1, 41), np.linspace(-np.pi, np.pi, 61)
    slope = 0.3 * u[:, None] + (0.2 * np.cos(v) if wrap else 0.1 * v)
    ripple = 0.05 * np.sin(24 * v)
    field = smooth_field(u, v, slope + ripple, sigma=(0.05, 0.05), wrap=wrap)
    at_u, at_v = np.repeat([0.0, 0.35, 1.0], 9), np.tile(np.linspace(-3, 3, 9), 3)
    expected = 0.3 * at_u + (0.2 * np.exp(-((2 * np.pi * 0.05) ** 2) / 2) * np.cos(at_v) if wrap else 0.1 * at_v)
    np.testing.assert_allclose(field(at_u, at_v), expected, atol=2e-3)


def test_a_ball_spans_a_narrow_dip_and_leaves_domes_slopes_and_wide_valleys() -> None:
    u, v = np.linspace(-0.10, 0.10, 41), np.linspace(-0.08, 0.08, 33)
    x, y = np.meshgrid(u, v, indexing="ij")
    plane, r2 = 0.3 * x - 0.2 * y, x**2 + y**2
    np.testing.assert_allclose(bridged(u, v, plane, 0.06), plane, atol=1e-12)
    dome = plane - r2 / (2 * 0.15)
    np.testing.assert_allclose(bridged(u, v, dome, 0.06), dome, atol=1e-12)
    # A valley rounder than the ball is touched everywhere; samples 5 mm apart leave a little.
    wide = r2 / (2 * 0.25)
    inner = np.s_[8:-8, 8:-8]
    np.testing.assert_allclose(bridged(u, v, wide, 0.06)[inner], wide[inner], atol=1e-4)
    # A conical pit 12 mm wide and 6 mm deep: the ball rests on its rim and sags into it by w^2 / 2R.
    pit = np.where(r2 < 0.012**2, 0.006 * (np.sqrt(r2) / 0.012 - 1), 0.0)
    spanned = bridged(u, v, pit, 0.06)
    assert spanned.min() == pytest.approx(-(0.012**2) / (2 * 0.06), abs=7e-4)
    np.testing.assert_allclose(spanned[r2 > 0.02**2], 0.0, atol=1e-12)
    assert (spanned >= pit).all()


SEGMENT = "right_forearm"


@pytest.fixture(scope="module", params=SOME_QUICK)
def body(request: pytest.FixtureRequest) -> Body:
    return load_body(request.param)


@pytest.fixture(scope="module", params=[1, 2])
def times(request: pytest.FixtureRequest) -> int:
    return request.param


@pytest.fixture(scope="module")
def fine(body: Body, times: int) -> Body:
    return refined(body, SEGMENT, times=times)


def areas(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = np.moveaxis(points[faces], 1, 0)
    if points.shape[1] == 2:
        return ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def chosen(body: Body) -> np.ndarray:
    return (body.owner[body.faces] == body.segments.index(SEGMENT)).all(1)


def test_surface_and_texture_cover_the_same_area(body: Body, fine: Body) -> None:
    # Rounding moves the surface by little.
    before, after = ([areas(*each).sum() for each in ((b.vertices, b.faces), (b.uv, b.uv_faces))] for b in (body, fine))
    assert after[0] == pytest.approx(before[0], rel=1e-3)
    assert after[1] == pytest.approx(before[1], rel=1e-12), "signed, so that a flipped triangle would show"


def test_each_chosen_face_becomes_four(body: Body, fine: Body, times: int) -> None:
    count = int(chosen(body).sum())
    assert count > 100
    assert len(fine.faces) == len(body.faces) + (4**times - 1) * count
    assert fine.faces.shape == fine.uv_faces.shape
    kept = set(map(tuple, body.faces[~chosen(body)]))
    assert kept <= set(map(tuple, fine.faces))
    after, before = (
        np.linalg.norm(np.diff(b.vertices[b.faces[chosen(b)]], axis=1), axis=2).max() for b in (fine, body)
    )
    assert after < 1.5 * before / 2**times


def test_faces_stay_wound_outward(body: Body, fine: Body) -> None:
    def volume(b: Body) -> float:
        corner = b.vertices[b.faces]
        return float(np.einsum("ij,ij->i", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])).sum() / 6)

    assert volume(fine) == pytest.approx(volume(body), rel=1e-3)


def test_rounding_bulges_what_is_convex_and_leaves_the_rim_closed(body: Body) -> None:
    """A forearm is convex round its axis: its new points lie outside the old facets; the surface has no free edge."""
    fine = refined(body, SEGMENT, times=1)
    new = fine.vertices[len(body.vertices) :]
    start, along = body.joint_centre[SEGMENT], body.direction(SEGMENT)
    corner = body.vertices[body.faces[chosen(body)]]

    def radius(points: np.ndarray) -> np.ndarray:
        off = points - start
        return np.linalg.norm(off - np.outer(off @ along, along), axis=1)

    middles = np.concatenate([(corner[:, k] + corner[:, (k + 1) % 3]) / 2 for k in range(3)])
    assert radius(new).mean() > radius(np.unique(middles.round(12), axis=0)).mean() + 5e-5
    pairs = np.sort(np.stack([fine.faces, np.roll(fine.faces, -1, axis=1)], -1), axis=-1).reshape(-1, 2)
    edges, count = np.unique(pairs, axis=0, return_counts=True)
    ends = fine.vertices[edges[count == 1]]
    # Each rim edge that was split lies on the old edge beside it: its halves meet the old edge's middle.
    halves = ends[(edges[count == 1] >= len(body.vertices)).any(1)].reshape(-1, 2, 3)
    old = body.vertices[np.unique(pairs[(pairs < len(body.vertices)).all(1)], axis=0)].mean(1)
    assert cKDTree(old).query(halves)[0].min(axis=1).max() < 1e-9


def test_weights_sum_to_one(fine: Body) -> None:
    np.testing.assert_allclose(fine.weight.sum(1), 1.0, atol=1e-12)
    assert fine.weight.min() >= 0
    rows = (fine.weight, fine.weight_segment, fine.is_eye, fine.vertices)
    assert len({len(row) for row in rows}) == 1


def test_a_new_point_follows_both_ends_of_its_edge(body: Body) -> None:
    fine = refined(body, SEGMENT, times=1)
    dense = np.zeros((len(fine.vertices), len(fine.segments)))
    np.add.at(dense, (np.arange(len(dense))[:, None], fine.weight_segment), fine.weight)
    faces = body.faces[chosen(body)]
    edges = np.unique(np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], -1), axis=-1).reshape(-1, 2), axis=0)
    new = dense[len(body.vertices) :]
    assert len(new) == len(edges)
    # Four weights a vertex are kept, so that a mean of two ends can lose a small fifth.
    np.testing.assert_allclose(new, dense[edges].mean(1), atol=0.05)
    length = np.linalg.norm(np.diff(body.vertices[edges], axis=1)[:, 0], axis=1)
    middle = body.vertices[edges].mean(1)
    assert (np.linalg.norm(fine.vertices[len(body.vertices) :] - middle, axis=1) < 0.3 * length).all()
