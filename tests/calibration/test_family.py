"""The laws that calibration chooses among."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.calibration.family import TERMS, Family
from carecontact.contract.protocol import Tissue
from carecontact.contract.protocol.person import LARGEST_CONTACT
from carecontact.protocols import load_protocol

BASE = load_protocol().person.tissue["abdomen"]
DEPTH = 0.012


def family(*terms: str, damping: bool = True) -> Family:
    return Family(base=BASE, depth_m=DEPTH, damping=damping, terms=terms)


def pressure(tissue: Tissue, x: float) -> float:
    return tissue.a_n_m3 * x + tissue.b_n_m4 * x**2 + tissue.c_n_m5 * x**3


def test_every_choice_within_the_bounds_is_a_law() -> None:
    rng = np.random.default_rng(0)
    made = family(*TERMS)
    for _ in range(300):
        p = rng.uniform(made.low, made.high)
        # Tissue refuses what softens under load.
        tissue = Tissue.model_validate(made.tissue(p).model_dump())
        if tissue.a_n_m3 > 1.02 * (BASE.contact_n_m3 or 0.0) / LARGEST_CONTACT:
            assert pressure(tissue, DEPTH) == pytest.approx(np.exp(p[0]) * pressure(BASE, DEPTH))
        half = tissue.damping_ns_m3 + tissue.damping_growth_ns_m4 * DEPTH / 2
        assert half == pytest.approx(np.exp(p[1]))


def test_bend_softens_and_rise_stiffens() -> None:
    straight = family().tissue(np.array([0.0, 10.0]))
    assert (straight.b_n_m4, straight.c_n_m5, straight.damping_growth_ns_m4) == (0.0, 0.0, 0.0)
    bent = family("bend").tissue(np.array([0.0, 10.0, 0.6]))
    assert bent.b_n_m4 < 0
    assert pressure(bent, DEPTH / 4) > pressure(straight, DEPTH / 4)
    risen = family("rise").tissue(np.array([0.0, 10.0, 1.0]))
    assert risen.b_n_m4 == 0.0
    assert pressure(risen, DEPTH / 4) < pressure(straight, DEPTH / 4)
    grown = family("growth").tissue(np.array([0.0, 10.0, 0.5]))
    assert grown.damping_growth_ns_m4 * DEPTH == pytest.approx(2 * grown.damping_ns_m3)


def test_a_new_term_begins_at_the_law_without_it() -> None:
    p = np.array([0.2, 10.0])
    for term in family().candidates:
        assert family().plus(term).tissue(np.r_[p, 0.0]) == family().tissue(p)


def test_damping_that_is_not_fitted_keeps_its_ratio_and_cannot_grow() -> None:
    made = family(damping=False)
    assert made.names == ("level",)
    assert "growth" not in made.candidates
    twice = made.tissue(np.array([np.log(2.0)]))
    assert twice.damping_ns_m3 == pytest.approx(2 * BASE.damping_ns_m3)
