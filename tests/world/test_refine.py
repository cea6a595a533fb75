from __future__ import annotations

from dataclasses import replace

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
    assert areas(fine.vertices, fine.faces).sum() == pytest.approx(areas(body.vertices, body.faces).sum(), rel=1e-12)
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

    assert volume(fine) == pytest.approx(volume(body), rel=1e-12)


def test_weights_sum_to_one(fine: Body) -> None:
    np.testing.assert_allclose(fine.weight.sum(1), 1.0, atol=1e-12)
    assert fine.weight.min() >= 0
    assert len(fine.weight) == len(fine.weight_segment) == len(fine.is_eye) == len(fine.vertices)


def test_a_midpoint_follows_both_ends(body: Body) -> None:
    fine = refined(body, SEGMENT, times=1)
    dense = np.zeros((len(fine.vertices), len(fine.segments)))
    np.add.at(dense, (np.arange(len(dense))[:, None], fine.weight_segment), fine.weight)
    first = len(body.vertices)
    faces = fine.faces[-4 * int(chosen(body).sum()) :]
    corner_faces = faces[(faces < first).sum(1) == 1]
    # A corner triangle is (corner, middle, middle); the far ends are the corner mirrored at the middles.
    for corner, *middles in (np.roll(f, -int(np.flatnonzero(f < first)[0])) for f in corner_faces[:200]):
        for middle in middles:
            end = 2 * fine.vertices[middle] - fine.vertices[corner]
            other = np.linalg.norm(body.vertices - end, axis=1).argmin()
            np.testing.assert_allclose(body.vertices[other], end, atol=1e-9)
            np.testing.assert_allclose(dense[middle], (dense[corner] + dense[other]) / 2, atol=0.05)


def test_weights_sum_to_one_where_a_midpoint_would_need_more_than_four_segments(body: Body) -> None:
    face = body.faces[chosen(body)][0]
    mine = body.segments.index(SEGMENT)
    others = [k for k in range(len(body.segments)) if k != mine]
    weight_segment, weight = body.weight_segment.copy(), body.weight.copy()
    for n, vertex in enumerate(face[:2]):
        weight_segment[vertex] = [mine, *others[3 * n : 3 * n + 3]]
        weight[vertex] = [0.4, 0.2, 0.2, 0.2]
    fine = refined(replace(body, weight_segment=weight_segment, weight=weight), SEGMENT, times=1)
    middle = body.vertices[face[:2]].mean(0)
    made = len(body.vertices) + np.linalg.norm(fine.vertices[len(body.vertices) :] - middle, axis=1).argmin()
    assert fine.weight[made].sum() == pytest.approx(1.0)
    # The shared segment keeps the largest share of the four that are left: 0.4 of 0.4 + 3 x 0.1.
    assert fine.weight[made].max() == pytest.approx(0.4 / 0.7)
    assert fine.owner[made] == mine


def test_original_vertices_and_the_source_are_untouched(body: Body, fine: Body) -> None:
    count = len(body.vertices)
    np.testing.assert_array_equal(fine.vertices[:count], body.vertices)
    np.testing.assert_array_equal(fine.owner[:count], body.owner)
    assert body.weight.shape == (count, 4)
    assert fine.joint_centre is body.joint_centre


def test_no_split_is_no_change(body: Body) -> None:
    assert refined(body, SEGMENT, times=0) is body
