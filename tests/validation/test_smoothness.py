from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carecontact.kernel.readings import Cells
from carecontact.validation import smoothness
from carecontact.validation.result import CheckResult, Measure
from carecontact.validation.smoothness import Scrub, dropouts, sliding_friction
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
        "forearm scrubbed with 5 N: deviation of the sliding friction from the declared one"
    ]
    assert result.missed[0].value == pytest.approx(10.0, abs=1.0)


def test_skin_without_friction_is_found(subject: Subject) -> None:
    missed = smoothness.run(ActsInContactOnly(subject, frictionless), quick=True).missed
    assert "forearm scrubbed with 5 N: deviation of the sliding friction from the declared one" in {
        m.name for m in missed
    }


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


def rattling(**known: bool) -> list[Measure]:
    """A steady scrub whose force swings by 1 N at 50 Hz."""
    time = np.arange(1000) * 0.002
    done = Scrub(
        time_s=time, force_n=15 + np.sin(2 * np.pi * 50 * time), steady=np.ones(1000, bool), friction=np.full(9, 0.5),
        sliding=np.ones(9),
    )  # fmt: skip
    return done.measures("belly", wanted=15.0, friction=0.5, **known)


def test_a_rattling_scrub_fails_also_where_the_miss_is_known() -> None:
    for known in (False, True):
        measures = tuple(rattling(known_noise=known, known_motion=False))
        result = CheckResult(check="smoothness", title="made up", measures=measures)
        assert [m.name for m in result.missed] == ["belly: force noise above 20 Hz, rms"]
        assert not result.passed
        assert result.fails_as_known is known


def test_a_scrub_that_never_moved_meets_no_limit_of_noise() -> None:
    time = np.arange(100) * 0.002
    none = np.zeros(0)
    still = Scrub(
        time_s=time, force_n=np.full(100, 5.0), steady=np.zeros(100, bool), friction=none, sliding=none
    )  # fmt: skip
    missed = {m.name for m in still.measures("belly", wanted=5.0, friction=0.5, known_noise=False, known_motion=False)
              if m.met is False}  # fmt: skip
    assert {name.partition(": ")[2] for name in missed} >= {
        "force noise above 20 Hz, rms",
        "share of the time at speed",
    }


def test_every_region_is_scrubbed_with_both_forces(subject: Subject, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, float]] = []

    def noted(simulation: object, newton: float, *, strokes: int, region: str) -> Scrub:
        asked.append((region, newton))
        one = np.ones(100)
        return Scrub(time_s=np.arange(100) * 0.002, force_n=one, steady=one > 0, friction=one, sliding=one)

    monkeypatch.setattr(smoothness, "scrub", noted)
    smoothness.run(subject, quick=False)
    assert asked == [(region, newton) for region in subject.regions() for newton in (5.0, 15.0)]
