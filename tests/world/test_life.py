"""What seeds draw for a person that does something by itself."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.contract.protocol import Alive, Breathing, Repositioning, Withdrawal
from carecontact.kernel.life import MOST_MOVES
from carecontact.world.life import REST_S, WIDEST_M, draw_doings, draw_shifts

WANTED = Repositioning(per_minute=8.0)
UNTIL_S = 30.0
STREAMS = ("breathing", "repositioning", "withdrawal")


def rngs(seed: int) -> dict[str, np.random.Generator]:
    return {name: np.random.default_rng([seed, k]) for k, name in enumerate(STREAMS)}


def test_onsets_come_at_a_constant_rate_over_the_whole_trial() -> None:
    drawn = [draw_shifts(np.random.default_rng(seed), WANTED, until_s=UNTIL_S) for seed in range(1500)]
    onsets = np.array([shift.time_s for shifts in drawn for shift in shifts])
    assert len(onsets) / len(drawn) == pytest.approx(8.0 * UNTIL_S / 60, rel=0.1)
    assert onsets.max() < UNTIL_S
    # No early or late part of a trial is safe. The first seconds have a few more, because nothing came before them.
    share = np.histogram(onsets, bins=6, range=(0, UNTIL_S))[0] / len(onsets)
    np.testing.assert_allclose(share, 1 / 6, atol=0.025)
    assert {len(shifts) for shifts in drawn} >= {1, 2, 3, 4, 5, 6}


def test_changes_have_their_sizes_and_do_not_overlap() -> None:
    for seed in range(200):
        at = ended = 0.0
        for shift in draw_shifts(np.random.default_rng(seed), WANTED, until_s=UNTIL_S):
            assert shift.time_s >= ended
            assert 0.04 <= abs(shift.wrist_m) <= 0.08
            assert 0.9 <= shift.duration_s <= 1.2
            at, ended = at + shift.wrist_m, shift.time_s + shift.duration_s + REST_S - 1e-9
            assert abs(at) <= WIDEST_M


def test_a_hurried_person_fills_the_table_and_no_more() -> None:
    hurried = Repositioning(per_minute=20.0, duration_s=(0.4, 0.4))
    assert len(draw_shifts(np.random.default_rng(0), hurried, until_s=600.0)) == MOST_MOVES


def test_each_doing_has_a_stream_of_its_own() -> None:
    whole = Alive(breathing=Breathing(), repositioning=WANTED, withdrawal=Withdrawal())
    everything = draw_doings(rngs(5), whole, until_s=UNTIL_S, wrist_radius_m=0.5)
    for field, names in (
        ("breathing", ("breath_hz", "phase", "breath_m")), ("repositioning", ("moves",)), ("withdrawal", ("pull",))
    ):  # fmt: skip
        alone = draw_doings(rngs(5), Alive(**{field: getattr(whole, field)}), until_s=UNTIL_S, wrist_radius_m=0.5)
        for name in names:
            assert str(getattr(alone, name)) == str(getattr(everything, name))
    assert draw_doings(rngs(5), Alive(), until_s=UNTIL_S, wrist_radius_m=0.5).moves == ()


def test_values_are_those_of_the_ranges_and_of_the_manner() -> None:
    whole = Alive(breathing=Breathing(), repositioning=WANTED, withdrawal=Withdrawal(), manner="holds")
    for seed in range(50):
        doings = draw_doings(rngs(seed), whole, until_s=UNTIL_S, wrist_radius_m=0.5)
        assert 0.20 <= doings.breath_hz <= 0.33
        assert 0.0 <= doings.phase < 1.0
        assert 0.005 <= doings.breath_m[0] <= 0.015
        assert 0.002 <= doings.breath_m[1] <= 0.005
        assert doings.pull is not None
        assert 20.0 <= doings.pull.force_n <= 30.0
        assert doings.pull.shift_rad[0] == pytest.approx(-0.08 / 0.5)
        assert (doings.tone, doings.help) == (0.15, 0.0)
