from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carecontact.kernel.readings import Cells
from carecontact.validation import smoothness
from carecontact.validation.smoothness import dropouts, sliding_friction
from carecontact.validation.subject import Subject
from tests.validation.defects import ActsInContactOnly, frictionless, slippery


def steady_force(count: int = 200, dt: float = 0.002) -> tuple[np.ndarray, np.ndarray]:
    time = np.arange(count) * dt
    return time, 5.0 + 0.5 * np.sin(2 * np.pi * 2.0 * time)


@given(st.integers(2, 197))
def test_a_single_low_sample_is_found_where_it_is(at: int) -> None:
    time, force = steady_force()
    force[at] *= 0.5
    assert np.flatnonzero(dropouts(time, force)).tolist() == [at]


@pytest.mark.parametrize("factor", [0.75, 1.0, 1.5])
def test_a_shallow_dip_and_a_spike_are_none(factor: float) -> None:
    time, force = steady_force()
    force[100] *= factor
    assert not dropouts(time, force).any()


def test_small_forces_do_not_count() -> None:
    time, force = steady_force()
    force = force * 0.05
    force[100] = 0.0
    assert not dropouts(time, force).any()


def test_a_lasting_step_is_no_dropout() -> None:
    time, force = steady_force()
    force[100:] *= 0.3
    assert dropouts(time, force).sum() <= 1
    assert not dropouts(time, np.minimum(force, 100.0))[102:].any()


def test_skin_more_slippery_than_declared_is_found(subject: Subject) -> None:
    result = smoothness.run(ActsInContactOnly(subject, slippery), quick=True)
    assert [m.name for m in result.missed] == [
        "scrubbing at 5 N: deviation of the sliding friction from the declared one"
    ]
    assert result.missed[0].value == pytest.approx(10.0, abs=1.0)


def test_skin_without_friction_is_found(subject: Subject) -> None:
    missed = smoothness.run(ActsInContactOnly(subject, frictionless), quick=True).missed
    assert "scrubbing at 5 N: deviation of the sliding friction from the declared one" in {m.name for m in missed}


def test_friction_is_that_of_the_cells_over_which_the_tool_slides() -> None:
    """Of three cells, the first slides with the tool's speed, the second sticks, and nothing touches the third."""
    zero = Cells(press_ns=np.zeros(3), shear_ns=np.zeros(3), slip_m3=np.zeros(3), touch_m2s=np.zeros(3))
    area, time, speed = 5e-5, 0.02, 0.1
    after = Cells(
        press_ns=np.array([3.0, 1.0, 0.0]), shear_ns=np.array([1.5, 0.1, 0.0]),
        slip_m3=np.array([speed * time * area, 0.3 * speed * time * area, 0.0]),
        touch_m2s=np.array([time * area, time * area, 0.0]),
    )  # fmt: skip
    assert sliding_friction(zero, after, speed_m_s=speed) == (0.5, 0.75)
    friction, share = sliding_friction(zero, after, speed_m_s=10 * speed)
    assert np.isnan(friction)
    assert share == 0.0
