from __future__ import annotations

import numpy as np
import pytest

from carecontact.world.human.body import Body
from carecontact.world.human.refine import refined

SEGMENT = "right_forearm"


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
    assert areas(fine.vertices, fine.faces).sum() == pytest.approx(areas(body.vertices, body.faces).sum(), rel=1e-3)
    # Signed, so that a flipped texture triangle would show.
    assert areas(fine.uv, fine.uv_faces).sum() == pytest.approx(areas(body.uv, body.uv_faces).sum(), rel=1e-12)


def test_each_chosen_face_becomes_four(body: Body, fine: Body, times: int) -> None:
    count = int(chosen(body).sum())
    assert count > 100
    assert len(fine.faces) == len(body.faces) + (4**times - 1) * count
    assert fine.faces.shape == fine.uv_faces.shape
    kept = set(map(tuple, body.faces[~chosen(body)]))
    assert kept <= set(map(tuple, fine.faces))
    longest = np.linalg.norm(np.diff(fine.vertices[fine.faces[chosen(fine)]], axis=1), axis=2).max()
    before = np.linalg.norm(np.diff(body.vertices[body.faces[chosen(body)]], axis=1), axis=2).max()
    assert longest < 1.5 * before / 2**times


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
    for a, b in zip(*halves.transpose(1, 0, 2), strict=True):
        assert min(np.linalg.norm(old - a, axis=1).min(), np.linalg.norm(old - b, axis=1).min()) < 1e-9


def test_weights_sum_to_one(fine: Body) -> None:
    np.testing.assert_allclose(fine.weight.sum(1), 1.0, atol=1e-12)
    assert fine.weight.min() >= 0
    assert len(fine.weight) == len(fine.weight_segment) == len(fine.is_eye) == len(fine.vertices)


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
