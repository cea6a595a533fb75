from __future__ import annotations

import numpy as np

from carecontact.validation.fem import contact
from carecontact.validation.fem.contact import balance


def test_springs_under_a_cone_push_with_their_own_gap_and_never_pull() -> None:
    push, active = balance(np.diag(1 / np.array([100.0, 200.0, 300.0])), 0.0015 - 0.001 * np.arange(3))
    np.testing.assert_allclose(push, [0.15, 0.1, 0.0])
    np.testing.assert_array_equal(active, [True, True, False])


def test_changing_one_patch_at_a_time_gives_the_same_balance(monkeypatch) -> None:
    place = np.arange(30)
    compliance = np.exp(-np.abs(place[:, None] - place) / 6) + 0.05 * np.eye(30)
    gap = 0.002 - 0.002 * np.sin(0.7 * place) ** 2 - 0.0001 * place
    together, _ = balance(compliance, gap)
    monkeypatch.setattr(contact, "TOGETHER", 0)
    np.testing.assert_allclose(balance(compliance, gap)[0], together, atol=1e-12)
    assert (together >= 0).all()
    assert 0 < np.count_nonzero(together) < 30


def test_any_guess_ends_in_the_same_balance() -> None:
    place = np.arange(20)
    compliance = np.exp(-np.abs(place[:, None] - place) / 4) + 0.1 * np.eye(20)
    gap = 0.001 - 0.0002 * place
    usual, _ = balance(compliance, gap)
    np.testing.assert_allclose(balance(compliance, gap, place % 2 == 0)[0], usual, atol=1e-12)
