"""The soft regions' shells against the body they were sampled from."""

from __future__ import annotations

from collections import Counter
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from carecontact.errors import SceneError
from carecontact.human.body import Body
from carecontact.human.library import load_body
from carecontact.human.pose import free_middle
from carecontact.human.shell import (
    FINE_HALF_LENGTH_M,
    FINE_HALF_ROUND_DEG,
    SIDE_HALF_ROUND_DEG,
    Shell,
    belly_half_width,
    belly_span,
    cached_shell,
    trunk_shell,
)
from carecontact.interface.regions import REGIONS, STANDARD_REGIONS
from carecontact.protocol.load import load_protocol
from carecontact.system import CACHE_VARIABLE
from carecontact.world.scene import region_shell
from tests.human.conftest import SOME_QUICK

TISSUE = load_protocol("bathing-v3").person.tissue
FRONT = np.array([0.0, -1.0, 0.0])


def sampled(body: Body, region: str) -> Shell:
    return region_shell(body, region, TISSUE[region])


@pytest.fixture(scope="module", params=SOME_QUICK)
def body(request: pytest.FixtureRequest) -> Body:
    return load_body(request.param)


@pytest.fixture(scope="module", params=STANDARD_REGIONS)
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


def edges_of(shell: Shell) -> np.ndarray:
    """(E, 2)"""
    pairs = np.concatenate([shell.triangles[:, [0, 1]], shell.triangles[:, [1, 2]], shell.triangles[:, [2, 0]]])
    return np.unique(np.sort(pairs, axis=1), axis=0)


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
    assert np.percentile(agreement, 1) > 0.5


def test_vertices_lie_on_the_bodys_smoothed_surface(body: Body, shell: Shell) -> None:
    """The body's own faces are flat and 20 mm wide; the shell rounds their ridges by a millimetre or two."""
    distance = distance_to_surface(body, shell.vertices)
    over = distance[np.isfinite(distance)]  # a point beside a convex edge lies over no face
    assert len(over) > 0.9 * len(distance)
    assert np.median(over) < 1.5e-3
    assert np.percentile(over, 97) < 5e-3


def test_shell_is_the_outer_surface(body: Body, shell: Shell) -> None:
    """A millimetre outward is outside the body and a centimetre inward is inside: parity of crossings along a ray."""
    points, normals = shell.vertices[::3], shell.normals[::3]
    assert inside(body, points - 0.01 * normals).mean() > 0.99
    assert inside(body, points + 0.006 * normals).mean() < 0.06


def test_shell_lies_on_its_segment_and_its_neighbours(body: Body, region: str, shell: Shell) -> None:
    expected = {
        "forearm": {"right_forearm"},
        "upper_arm": {"right_upper_arm"},
        "abdomen": {"abdomen", "thorax", "pelvis", "left_thigh", "right_thigh"},
    }[region]
    nearest = cKDTree(body.vertices).query(shell.vertices)[1]
    owners = Counter(body.segments[k] for k in body.owner[nearest])
    assert sum(owners[s] for s in expected) > 0.9 * owners.total(), owners


def test_the_shell_is_one_sheet(shell: Shell) -> None:
    edges = Counter(tuple(sorted(e)) for t in shell.triangles for e in ((t[0], t[1]), (t[1], t[2]), (t[2], t[0])))
    assert set(edges.values()) == {1, 2}


def test_fine_patch_is_as_fine_as_asked(region: str, shell: Shell) -> None:
    """On the patch neighbours stand about the spacing apart, nowhere half again, and the patch is all that the tool
    reaches."""
    spacing = TISSUE[region].spacing_m
    edges = edges_of(shell)
    length = np.linalg.norm(np.diff(shell.vertices[edges], axis=1)[:, 0], axis=1)
    fine = length[shell.fine[edges].all(1)]
    assert np.mean(fine) <= spacing * 1.03
    assert fine.max() <= spacing * 1.45
    assert length.max() <= TISSUE[region].coarse_spacing_m * 1.5
    x, y = shell.grid.T
    x = x - (x.min() + x.max()) / 2
    if region == "abdomen":
        reached = (np.abs(x) < x.max() - 0.031) & (np.abs(y) < min(0.08, y.max() - 0.03))
    else:
        # The skin between a region and a chest that crowds it stays coarse.
        in_region = region_coordinates(shell)[:, 0] > -shell.length_m / 2 + 0.001
        half_length = min(FINE_HALF_LENGTH_M, x.max() - 0.01)
        reached = in_region & (np.abs(x) < half_length) & (np.abs(np.degrees(y)) < FINE_HALF_ROUND_DEG)
        if region == "forearm":
            reached |= (np.abs(x) < 0.035) & (np.abs(np.degrees(y)) < SIDE_HALF_ROUND_DEG)
    assert reached.sum() > 200
    assert shell.fine[reached].all()


def test_shell_of_the_belly_keeps_clear_of_the_sides(body: Body) -> None:
    low, high = belly_span(body)
    trunk = body.vertices_of("pelvis", "abdomen", "thorax")
    trunk = trunk[(trunk[:, 2] > low) & (trunk[:, 2] < high)]
    assert 0.06 < belly_half_width(body) < np.abs(trunk[:, 0]).max()


def test_coarser_tissue_makes_a_coarser_shell_of_the_same_area(body: Body, region: str, shell: Shell) -> None:
    row = TISSUE[region]
    coarse = row.model_copy(update={"spacing_m": row.coarse_spacing_m, "coarse_spacing_m": 2 * row.coarse_spacing_m})
    other = region_shell(body, region, coarse)
    assert len(other.vertices) < 0.5 * len(shell.vertices)
    assert other.area.sum() == pytest.approx(shell.area.sum(), rel=0.06)
    np.testing.assert_allclose(other.frame, shell.frame, atol=1e-9)
    assert other.axis_depth_m == pytest.approx(shell.axis_depth_m)


def test_region_frame(body: Body, region: str, shell: Shell) -> None:
    """x from elbow to hand (abdomen: to the head), z out of the middle of the patch."""
    np.testing.assert_allclose(shell.frame.T @ shell.frame, np.eye(3), atol=1e-12)
    assert np.linalg.det(shell.frame) == pytest.approx(1)
    x, _, z = shell.frame.T
    if region == "abdomen":
        np.testing.assert_allclose((x, z), ([0, 0, 1], FRONT), atol=1e-12)
        trunkward = shell.length_m / 2
        assert shell.length_m == pytest.approx(np.diff(belly_span(body))[0])
    else:
        np.testing.assert_allclose(x, body.direction(REGIONS[region].segment), atol=1e-12)
        # Where a chest crowds the arm, the middle lies nearer the elbow; the skin towards the trunk stays in the shell.
        bone = float(np.linalg.norm(body.axis_vector(REGIONS[region].segment)))
        middle = free_middle(body, REGIONS[region].segment) if region == "upper_arm" else 0.5
        assert shell.length_m == pytest.approx(2 * (1 - middle) * bone)
        trunkward = middle * bone
    local = region_coordinates(shell)
    top = local[np.argmin(np.hypot(local[:, 0], local[:, 1]) + np.where(local[:, 2] < 0, 1, 0))]
    assert top[2] == pytest.approx(shell.axis_depth_m, abs=0.008)
    assert local[:, 0].min() > -trunkward - 1e-9
    assert local[:, 0].max() < shell.length_m / 2 + 1e-9


def test_limb_radius_is_that_of_an_arm(body: Body) -> None:
    radius = {region: sampled(body, region).radius_m for region in ("forearm", "upper_arm")}
    # Girth 16 to 31 cm at the forearm's and 26 to 38 cm at the upper arm's middle would be any adult's.
    assert 0.025 < radius["forearm"] < radius["upper_arm"] < 0.060


def test_region_that_leaves_the_body_is_refused(body: Body) -> None:
    tissue = TISSUE["abdomen"]
    with pytest.raises(SceneError, match=r"a ray from .* misses the body's surface"):
        trunk_shell(body, np.array([0.0, 0.0, 1.0]), tissue)


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
    """(n,) whether a ray leaves the surface an odd number of times: once for each triangle that it meets."""
    ray = np.array([0.231, -0.117, 0.966])
    ray /= np.linalg.norm(ray)
    across = np.cross(ray, [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    flat = np.stack([across, np.cross(ray, across)], 1)
    corners = body.vertices[body.faces[~body.is_eye[body.faces].any(1)]]
    seen, height = corners @ flat, corners @ ray
    (left, bottom), (right, top) = seen.min(1).T.copy(), seen.max(1).T.copy()
    out = np.empty(len(points), bool)
    for k, (place, above) in enumerate(zip(points @ flat, points @ ray, strict=True)):
        near = (left <= place[0]) & (place[0] <= right) & (bottom <= place[1]) & (place[1] <= top)
        (a, b, c), z = np.moveaxis(seen[near], 1, 0), height[near]
        u, v, w = b - a, c - a, place - a
        area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
        beta = (w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0]) / area
        gamma = (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]) / area
        crossing = z[:, 0] + beta * (z[:, 1] - z[:, 0]) + gamma * (z[:, 2] - z[:, 0])
        out[k] = np.count_nonzero((beta >= 0) & (gamma >= 0) & (beta + gamma <= 1) & (crossing > above)) % 2
    return out


PROTOCOL = load_protocol("bathing-v3")
BODY, FOREARM = load_body(PROTOCOL.person.body), PROTOCOL.person.tissue["forearm"]


def forbidden() -> Shell:
    raise AssertionError("computed again")


def test_a_kept_shell_has_the_same_bits_and_belongs_to_one_body_region_and_tissue(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    shell = region_shell(BODY, "forearm", FOREARM)
    cached_shell(BODY, "forearm", FOREARM, lambda: shell)
    again = cached_shell(BODY, "forearm", FOREARM, forbidden)
    for field in fields(Shell):
        value = getattr(again, field.name)
        assert type(value) is type(getattr(shell, field.name))
        np.testing.assert_array_equal(value, getattr(shell, field.name))
    coarse = FOREARM.model_copy(update={"spacing_m": 2 * FOREARM.spacing_m})
    for other in (
        (replace(BODY, name="other"), "forearm", FOREARM),
        (BODY, "upper_arm", FOREARM),
        (BODY, "forearm", coarse),
    ):
        with pytest.raises(AssertionError, match="computed again"):
            cached_shell(*other, forbidden)
