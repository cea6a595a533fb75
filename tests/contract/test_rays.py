"""Rays onto triangles, on walls with known distances."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.contract.rays import Triangles
from carecontact.errors import SceneError


def test_rays_hit_the_nearer_of_two_walls() -> None:
    wall = np.array([[[0.0, -1, -1], [0, 1, -1], [0, 0, 2]]])
    walls = np.concatenate([wall + [2.0, 0, 0], wall + [3.0, 0, 0], wall - [1.0, 0, 0]])
    rng = np.random.default_rng(1)
    origins = np.stack([np.zeros(20), rng.uniform(-0.2, 0.2, 20), rng.uniform(-0.2, 0.2, 20)], 1)
    ahead = np.tile([1.0, 0, 0], (20, 1))
    np.testing.assert_allclose(Triangles(walls).first_hits(origins, ahead), 2.0)
    np.testing.assert_allclose(Triangles(walls).first_hits(origins[0], ahead[:1]), 2.0)
    slanted = np.array([[np.cos(0.05), np.sin(0.05), 0.0]])
    np.testing.assert_allclose(Triangles(walls).first_hits(np.zeros(3), slanted), 2.0 / np.cos(0.05))


def test_a_ray_that_misses_is_named_or_infinitely_long() -> None:
    wall = np.array([[[1.0, -1, -1], [1, 1, -1], [1, 0, 2]]])
    rays = np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    assert Triangles(wall).distances(np.zeros(3), rays).tolist() == [pytest.approx(1.0), np.inf]
    assert Triangles(wall[:0]).distances(np.zeros(3), rays).tolist() == [np.inf, np.inf]
    with pytest.raises(SceneError, match=r"a ray from \[0.0, 0.0, 0.0\] misses"):
        Triangles(wall).first_hits(np.zeros(3), rays)
