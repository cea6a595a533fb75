from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, eye_array

from carecontact.validation.fem import contact
from carecontact.validation.fem.contact import press
from carecontact.validation.fem.surface import Surface
from carecontact.validation.result import Array


def springs(stiffness: Array) -> Surface:
    """Independent springs at 0, 1, 2 ... mm."""
    n = len(stiffness)
    radius, none = 0.001 * np.arange(n), np.zeros((n, n))
    return Surface(
        normal=np.diag(1 / stiffness), cross=none, radial=none, distance_m=radius, mean=csr_matrix(eye_array(n)),
        mean_distance_m=radius, outline_m=radius, outline=np.diag(1 / stiffness),
    )  # fmt: skip


def test_springs_under_a_cone_push_with_their_own_gap_and_never_pull() -> None:
    found = press(springs(np.array([100.0, 200.0, 300.0])), lambda r: r, 0.0015)
    np.testing.assert_allclose(found.nodal_n, [0.15, 0.1, 0.0])
    assert found.force_n == found.nodal_n.sum()
    assert found.radius_m == 0.001


def test_changing_one_node_at_a_time_gives_the_same_balance(monkeypatch) -> None:
    n = 30
    place = np.arange(n)
    compliance = np.exp(-np.abs(place[:, None] - place) / 6) + 0.05 * np.eye(n)
    surface = springs(np.ones(n))
    surface = Surface(**{**{f: getattr(surface, f) for f in surface.__dataclass_fields__}, "normal": compliance})
    bumpy = lambda r: 0.002 * np.sin(r * 700) ** 2 + 0.1 * r  # noqa: E731
    together = press(surface, bumpy, 0.002)
    monkeypatch.setattr(contact, "TOGETHER", 0)
    np.testing.assert_allclose(press(surface, bumpy, 0.002).nodal_n, together.nodal_n, atol=1e-12)
    assert (together.nodal_n >= 0).all()
    assert 0 < np.count_nonzero(together.nodal_n) < n
