"""Inertia and damper of the skin, read from its free motion. Defects are planted in the numbers with which the compiled
tissue computes."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from carecontact.validation.free_skin import declared, free_skin, measures
from carecontact.validation.subject import Subject
from carecontact.world.scene import Scene

from .defects import ActsInContactOnly, half_damped, nearly_massless


@pytest.mark.parametrize("region", ["forearm", "abdomen"])
def test_a_sound_person_has_the_declared_times(subject: Subject, region: str) -> None:
    found, wanted = free_skin(subject, region), declared(subject, region)
    assert found.dies_s == pytest.approx(wanted.dies_s, rel=2e-3)
    assert found.returns_s == pytest.approx(wanted.returns_s, rel=2e-3)


@pytest.mark.parametrize(
    ("plant", "dies", "returns"), [(half_damped, 100.0, 50.0), (nearly_massless, 90.0, 0.0)]
)  # fmt: skip
def test_a_wrong_damper_or_inertia_is_found(
    subject: Subject, plant: Callable[[Scene], object], dies: float, returns: float
) -> None:
    found = list(measures(ActsInContactOnly(subject, plant), "forearm"))
    assert [m.value for m in found] == pytest.approx([dies, returns], abs=0.5)
    assert [m.met for m in found] == [False, returns == 0.0]
