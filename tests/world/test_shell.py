"""The soft regions' shells against the body they were sampled from."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from carecontact.errors import SceneError
from carecontact.protocols import load_protocol
from carecontact.world.human.body import Body
from carecontact.world.human.shell import FINE_HALF_LENGTH_M, Shell, belly_span, graded, limb_shell, trunk_shell
from carecontact.world.human.skeleton import SOFT_SEGMENTS
from carecontact.world.scene import upward_in_bind

TISSUE = load_protocol().person.tissue
FRONT = np.array([0.0, -1.0, 0.0])


def sampled(body: Body, region: str) -> Shell:
    if region == "abdomen":
        return trunk_shell(body, FRONT, TISSUE["abdomen"])
    segment = SOFT_SEGMENTS[region]
    return limb_shell(body, segment, upward_in_bind(body, segment), TISSUE[region])


@pytest.fixture(scope="module", params=list(SOFT_SEGMENTS))
def region(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def shell(body: Body, region: str) -> Shell:
    return sampled(body, region)


def corners(shell: Shell) -> np.ndarray:
    return shell.vertices[shell.triangles]


def face_vectors(shell: Shell) -> np.ndarray:
    a, b, c = np.moveaxis(corners(shell), 1, 0)
    return np.cross(b - a, c - a)


def region_coordinates(shell: Shell) -> np.ndarray:
    """(N, 3) in the region frame."""
    return (shell.vertices - shell.frame_origin) @ shell.frame


def columns(shell: Shell) -> int:
    """Of the structured grid: its first cells are joined to the next row, which starts one row of vertices later."""
    return int(np.diff(np.sort(shell.triangles, axis=1), axis=1).sum(1).max()) - 1


def grid(shell: Shell, values: np.ndarray) -> np.ndarray:
    return values.reshape(-1, columns(shell), *values.shape[1:])


def test_areas_share_out_the_triangles(shell: Shell) -> None:
    """Heron's formula, so that the shell's own cross products are not checked against themselves."""
    a, b, c = (np.linalg.norm(corners(shell)[:, k] - corners(shell)[:, k - 1], axis=1) for k in range(3))
    s = (a + b + c) / 2
    heron = np.sqrt(s * (s - a) * (s - b) * (s - c))
    assert shell.area.sum() == pytest.approx(heron.sum(), rel=1e-9)
    expected = np.zeros(len(shell.vertices))
    np.add.at(expected, shell.triangles.ravel(), np.repeat(heron / 3, 3))
    np.testing.assert_allclose(shell.area, expected, rtol=1e-9)


def test_normals_are_unit_and_point_out(shell: Shell) -> None:
    np.testing.assert_allclose(np.linalg.norm(shell.normals, axis=1), 1.0, atol=1e-12)
    outward = region_coordinates(shell) * [0.0, 1.0, 1.0] @ shell.frame.T
    assert np.einsum("ij,ij->i", shell.normals, outward).min() > 0


def test_triangles_are_wound_outward_like_their_corners(shell: Shell) -> None:
    face = face_vectors(shell)
    agreement = np.einsum(
        "ij,ikj->ik", face / np.linalg.norm(face, axis=1, keepdims=True), shell.normals[shell.triangles]
    )
    assert agreement.min() > 0
    assert agreement[~shell.pinned[shell.triangles]].min() > 0.5


def test_tangents_lie_in_the_surface_along_the_region(shell: Shell) -> None:
    np.testing.assert_allclose(np.linalg.norm(shell.tangents, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(np.einsum("ij,ij->i", shell.tangents, shell.normals), 0.0, atol=1e-12)
    along = shell.tangents @ shell.frame[:, 0]
    assert along.min() > 0
    assert along[~shell.pinned].min() > 0.7


def test_vertices_lie_on_the_bodys_surface(body: Body, shell: Shell) -> None:
    assert distance_to_surface(body, shell.vertices).max() < 1e-3


def test_shell_is_the_outer_surface(body: Body, shell: Shell) -> None:
    """A millimetre outward is outside the body and a centimetre inward is inside: parity of crossings along a ray."""
    free = np.flatnonzero(~shell.pinned)[::3]
    points, normals = shell.vertices[free], shell.normals[free]
    assert inside(body, points - 0.01 * normals).mean() > 0.99
    assert inside(body, points + 0.001 * normals).mean() < 0.01


def test_shell_lies_on_its_segment_and_its_neighbours(body: Body, region: str, shell: Shell) -> None:
    expected = {
        "forearm": {"right_forearm"},
        "upper_arm": {"right_upper_arm"},
        "abdomen": {"abdomen", "thorax", "pelvis", "left_thigh", "right_thigh"},
    }[region]
    nearest = cKDTree(body.vertices).query(shell.vertices[~shell.pinned])[1]
    owners = Counter(body.segments[k] for k in body.owner[nearest])
    assert sum(owners[s] for s in expected) > 0.9 * owners.total(), owners


def test_border_is_pinned(region: str, shell: Shell) -> None:
    edges = Counter(tuple(sorted(e)) for t in shell.triangles for e in ((t[0], t[1]), (t[1], t[2]), (t[2], t[0])))
    border = {v for edge, count in edges.items() if count == 1 for v in edge}
    assert set(edges.values()) == {1, 2}
    assert shell.pinned[sorted(border)].all()
    if region == "abdomen":
        assert set(np.flatnonzero(shell.pinned)) == border
    else:
        # The underside lies on the board: it is fixed to the bone too.
        pinned = grid(shell, shell.pinned)
        assert (pinned[1:-1] == pinned[1]).all()
        y, z = grid(shell, region_coordinates(shell))[len(pinned) // 2, :, 1:].T
        angle = np.abs(np.degrees(np.arctan2(y, z)))
        np.testing.assert_array_equal(pinned[1], angle > (128 if region == "forearm" else 105))


def test_fine_patch_is_as_fine_as_asked(region: str, shell: Shell) -> None:
    spacing = TISSUE[region].spacing_m
    local, points = grid(shell, region_coordinates(shell)), grid(shell, shell.vertices)
    along = local[:, 0, 0]
    centre, half = (along[0] + along[-1]) / 2, (along[-1] - along[0]) / 2
    reach = min(FINE_HALF_LENGTH_M, half - 0.01) if region != "abdomen" else half - 0.03
    fine_rows = np.abs(along - centre) <= reach + 1e-6
    assert fine_rows.sum() > 8
    assert np.diff(along[fine_rows]).max() <= spacing + 1e-9
    if region == "abdomen":
        across = local[0, :, 1]
        fine_columns = np.abs(across) <= 0.085 + 1e-6
        assert np.abs(np.diff(across[fine_columns])).max() <= spacing + 1e-9
    else:
        middle = local[len(local) // 2]
        fine_columns = np.abs(np.degrees(np.arctan2(middle[:, 1], middle[:, 2]))) < 63
    # Round a limb the spacing is that at its middle; where the limb is thicker or the belly slopes it stretches.
    step = np.linalg.norm(np.diff(points[:, fine_columns], axis=1), axis=2)[fine_rows]
    assert np.median(step) <= spacing * 1.15
    assert step.max() <= spacing * 1.6


def test_coarser_tissue_makes_a_coarser_shell_of_the_same_area(body: Body, region: str, shell: Shell) -> None:
    row = TISSUE[region]
    coarse = row.model_copy(
        update={"spacing_m": row.off_target_spacing_m, "coarse_spacing_m": row.off_target_spacing_m}
    )
    segment = SOFT_SEGMENTS[region]
    other = (
        trunk_shell(body, FRONT, coarse)
        if region == "abdomen"
        else limb_shell(body, segment, upward_in_bind(body, segment), coarse)
    )
    assert len(other.vertices) < 0.5 * len(shell.vertices)
    assert other.area.sum() == pytest.approx(shell.area.sum(), rel=0.06)
    np.testing.assert_allclose(other.frame, shell.frame, atol=1e-9)


def test_region_frame(body: Body, region: str, shell: Shell) -> None:
    """x from elbow to hand (belly: to the head), z out of the middle of the patch."""
    np.testing.assert_allclose(shell.frame.T @ shell.frame, np.eye(3), atol=1e-12)
    assert np.linalg.det(shell.frame) == pytest.approx(1)
    x, _, z = shell.frame.T
    if region == "abdomen":
        np.testing.assert_allclose((x, z), ([0, 0, 1], FRONT), atol=1e-12)
        assert shell.length_m == pytest.approx(np.diff(belly_span(body))[0])
    else:
        np.testing.assert_allclose(x, body.direction(SOFT_SEGMENTS[region]), atol=1e-12)
        assert shell.length_m == pytest.approx(np.linalg.norm(body.axis_vector(SOFT_SEGMENTS[region])))
    local = region_coordinates(shell)
    top = local[np.argmin(np.hypot(local[:, 0], local[:, 1]) + np.where(local[:, 2] < 0, 1, 0))]
    assert top[2] == pytest.approx(shell.axis_depth_m, abs=0.008)
    assert local[:, 0].min() > -shell.length_m / 2 - 1e-9
    assert local[:, 0].max() < shell.length_m / 2 + 1e-9


def test_limb_radius_is_that_of_an_arm(body: Body) -> None:
    radius = {region: sampled(body, region).radius_m for region in ("forearm", "upper_arm")}
    # Girth 23 to 31 cm at the forearm's and 26 to 38 cm at the upper arm's middle would be any adult's.
    assert 0.028 < radius["forearm"] < radius["upper_arm"] < 0.060


def test_region_that_leaves_the_body_is_refused(body: Body) -> None:
    tissue = TISSUE["abdomen"]
    with pytest.raises(SceneError, match=r"a ray from .* misses the body's surface"):
        trunk_shell(body, np.array([0.0, 0.0, 1.0]), tissue)


millimetres = st.integers(1, 400)


@given(st.integers(-200, 200), millimetres, millimetres, millimetres, st.integers(2, 40), st.floats(1.0, 4.0))
def test_graded(start: int, left: int, middle: int, right: int, spacing_mm: int, ratio: float) -> None:
    fine = np.array([start + left, start + left + middle]) / 1000
    span = np.array([start, start + left + middle + right]) / 1000
    spacing = spacing_mm / 1000
    at = graded(span, fine, spacing, spacing * ratio)
    steps = np.diff(at)
    np.testing.assert_allclose(at[[0, -1]], span, atol=1e-12)
    assert (steps > 0).all()
    for edge in fine:
        assert np.abs(at - edge).min() < 1e-12
    inner = (at[:-1] > fine[0] - 1e-9) & (at[1:] < fine[1] + 1e-9)
    assert steps[inner].max() <= spacing + 1e-12
    # No finer than needed either: one vertex less would be too coarse.
    assert inner.sum() - 1 < middle / 1000 / spacing + 1e-9
    # Outside a whole number of steps has to fit: the coarse spacing within a half of itself.
    outer = steps[~inner]
    assert outer.max() <= spacing * ratio * 1.5 + 1e-12


@given(millimetres, st.integers(2, 40))
@example(99, 9)
def test_graded_without_margins_is_even(length: int, spacing_mm: int) -> None:
    span = np.array([0.0, length / 1000])
    at = graded(span, span, spacing_mm / 1000, 1.0)
    np.testing.assert_allclose(np.diff(at), span[1] / (len(at) - 1), rtol=1e-9)
    assert len(at) == -(-length // spacing_mm) + 1


def distance_to_surface(body: Body, points: np.ndarray) -> np.ndarray:
    """(n,) to the nearest face over whose inside a point lies, by barycentric coordinates."""
    a, b, c = np.moveaxis(body.vertices[body.faces], 1, 0)
    ab, ac = b - a, c - a
    d00, d01, d11 = (np.einsum("ij,ij->i", p, q) for p, q in ((ab, ab), (ab, ac), (ac, ac)))
    det = d00 * d11 - d01**2
    normal = np.cross(ab, ac)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    out = np.empty(len(points))
    neighbours = cKDTree(a).query_ball_point(points, 0.06)
    for k, (point, near) in enumerate(zip(points, neighbours, strict=True)):
        off = point - a[near]
        d20, d21 = np.einsum("ij,ij->i", off, ab[near]), np.einsum("ij,ij->i", off, ac[near])
        v = (d11[near] * d20 - d01[near] * d21) / det[near]
        w = (d00[near] * d21 - d01[near] * d20) / det[near]
        over = (v > -1e-6) & (w > -1e-6) & (v + w < 1 + 1e-6)
        out[k] = np.abs(np.einsum("ij,ij->i", off, normal[near]))[over].min(initial=np.inf)
    return out


def inside(body: Body, points: np.ndarray) -> np.ndarray:
    """(n,) whether a ray leaves the surface an odd number of times."""
    ray = np.array([0.231, -0.117, 0.966])
    a, b, c = np.moveaxis(body.vertices[body.faces[~body.is_eye[body.faces].any(1)]], 1, 0)
    out = np.empty(len(points), bool)
    e1, e2 = b - a, c - a
    p = np.cross(ray, e2)
    det = np.einsum("ij,ij->i", e1, p)
    usable = np.abs(det) > 1e-14
    e1, e2, p, det, a = e1[usable], e2[usable], p[usable], det[usable], a[usable]
    for k, point in enumerate(points):
        s = point - a
        u = np.einsum("ij,ij->i", s, p) / det
        q = np.cross(s, e1)
        v, t = q @ ray / det, np.einsum("ij,ij->i", e2, q) / det
        out[k] = np.count_nonzero((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)) % 2
    return out
