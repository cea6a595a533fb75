"""The kernel answers the script of contacts as it did when the frozen protocols were made."""

from __future__ import annotations

import platform

import numpy as np
import pytest

from carecontact.kernel.behaviour import TOLERANCE, behaviour, stored


def test_person_v1_is_answered_as_it_was() -> None:
    answers, before = behaviour(), stored()

    assert answers.keys() == before.keys()
    if platform.machine().lower() in ("x86_64", "amd64"):
        assert answers == before
    for name, answer in answers.items():
        assert answer == pytest.approx(before[name], rel=0, abs=TOLERANCE * np.abs(before[name]).max()), name
