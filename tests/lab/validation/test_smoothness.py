from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carecontact.lab.validation import knocks, smoothness
from carecontact.lab.validation.passive_response import lock_arm
from carecontact.lab.validation.result import CheckResult
from carecontact.lab.validation.smoothness import (
    HALF_WAY_M,
    Ends,
    Scrub,
    dropouts,
    glides,
    room,
    scrub,
    sliding_friction,
)
from carecontact.lab.validation.subject import HOVER_M, Subject, surface_point
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden
from carecontact.sim.simulation import Samples, Simulation
from carecontact.tissue.plugin import Cells
from tests.lab.validation.defects import ActsInContactOnly, frictionless, hard_plates, slippery


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


@pytest.mark.slow
@pytest.mark.parametrize("tool", ["caps", "mitt"])
def test_a_tool_glides_over_plates_only_where_one_of_both_gives_way(tool: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rules = overridden(load_protocol("bathing-v3"), {"scene.tool": tool})
    assert [m.name for m in glides(Subject(rules), quick=True) if not m.met] == []
    monkeypatch.setattr(knocks, "make_giving", lambda *_: None)
    found = list(glides(Subject(rules, make_scene=hard_plates), quick=True))
    assert {m.name for m in found if not m.met} >= {m.name for m in found if m.unit == "N"}
    assert len(found) == 3 + (tool == "mitt")


@pytest.mark.parametrize(
    ("tool", "rattles_at_s", "met"), [("caps", 0.42, True), ("caps", 0.6, False), ("mitt", 0.42, False)]
)
def test_a_rigid_tool_may_jump_where_it_lands_on_the_next_plate_and_nowhere_else(
    monkeypatch: pytest.MonkeyPatch, tool: str, rattles_at_s: float, met: bool
) -> None:
    """It lands after 0.4 s, and loses contact in a single step 20 or 200 ms later."""
    time = np.arange(400) * 0.002
    force = np.where(time < 0.4, 3.0, 9.0)
    force[round(rattles_at_s / 0.002)] = 0.0
    still = SimpleNamespace(restore=lambda *_, **__: None, model=SimpleNamespace(opt=SimpleNamespace(timestep=0.002)))
    monkeypatch.setattr(smoothness, "Simulation", lambda _: still)
    monkeypatch.setattr(smoothness, "glide", lambda *_: (force, 0.4))
    monkeypatch.setattr(knocks, "with_striker", lambda *_: None)
    monkeypatch.setattr(knocks, "settled", lambda _: None)
    found = list(glides(Subject(overridden(load_protocol("bathing-v3"), {"scene.tool": tool})), quick=True))
    assert {m.met for m in found} == {met}


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


TIME_S = np.arange(1000) * 0.002


def a_scrub(**changes: Any) -> Scrub:
    """A smooth scrub with 15 N, always at speed and turning round, over skin with a friction of 0.5."""
    always, nine = np.ones(1000, bool), np.ones(9)
    fields: dict[str, Any] = {
        "time_s": TIME_S,
        "force_n": 15.0 * always,
        "along_n": np.zeros((1000, 2)),
        "steady": always,
    }
    return Scrub(**{**fields, "whole_s": 2.0, "turning": always, "friction": 0.5 * nine, "sliding": nine, **changes})


def test_a_rattling_scrub_fails() -> None:
    """Its force swings by 1 N at 50 Hz."""
    swings = 15 + np.sin(2 * np.pi * 50 * TIME_S)
    done = a_scrub(force_n=swings, steady=TIME_S > 0.5, turning=TIME_S < 0.1)
    measures = tuple(done.measures("abdomen", wanted=15.0, friction=0.5))
    result = CheckResult(check="smoothness", title="made up", measures=measures)
    assert [m.name for m in result.missed] == [
        "abdomen: force noise above 20 Hz, rms", "abdomen: force noise where it turns round above 20 Hz, rms",
    ]  # fmt: skip
    assert not result.passed


def test_a_force_that_turns_from_side_to_side_fails_though_its_size_is_steady() -> None:
    """Where the tool turns round, and in a slow stroke."""
    across = np.where(TIME_S < 0.5, 0.3 * np.sin(2 * np.pi * 100 * TIME_S), 0.0)
    done = a_scrub(along_n=np.stack([np.zeros(1000), across], 1), steady=TIME_S > 1.0, turning=TIME_S < 0.5)
    missed = [m for m in done.measures("abdomen", wanted=15.0, friction=0.5) if m.met is False]
    assert [m.name for m in missed] == ["abdomen: force noise along the skin where it turns round above 20 Hz, rms"]
    assert missed[0].value == pytest.approx(0.3 / np.sqrt(2), rel=0.05)
    assert [m.value for m in done.slow_measures("abdomen")] == pytest.approx([0.0, 0.3 / np.sqrt(8)], abs=0.01)


@pytest.mark.parametrize(("periods", "missed"), [(2, set()), (5, {"share"}), (9, {"share", "deviation"})])
def test_where_the_tool_takes_the_skin_along_there_is_no_friction_to_judge(periods: int, missed: set[str]) -> None:
    """In so many of nine periods, no cell slides: that counts as not sliding, and not as friction."""
    still = np.arange(9) < periods
    done = a_scrub(friction=np.where(still, np.nan, 0.5), sliding=np.where(still, 0.0, 1.0))
    measures = done.measures("abdomen", wanted=15.0, friction=0.5)
    assert {m.name.partition(": ")[2].partition(" ")[0] for m in measures if m.met is False} == missed


@pytest.mark.parametrize(("whole_s", "met"), [(1.9, True), (2.1, False)])
def test_the_time_at_speed_is_judged_against_that_of_whole_strokes(whole_s: float, met: bool) -> None:
    """Short strokes: 0.5 s of 2 s at speed, as many as would fill ``whole_s`` on a whole way."""
    measures = a_scrub(steady=TIME_S < 0.499, whole_s=whole_s).measures("arm", wanted=15.0, friction=0.5)
    (share,) = [m for m in measures if "time at speed" in m.name]
    assert (share.value, share.met) == (pytest.approx(100 * 0.5 / whole_s), met)


def test_a_scrub_that_never_moved_meets_no_limit_of_noise() -> None:
    none = np.zeros(0)
    still = a_scrub(steady=np.zeros(1000, bool), friction=none, sliding=none)
    missed = {m.name.partition(": ")[2] for m in still.measures("abdomen", wanted=15.0, friction=0.5) if m.met is False}
    assert missed >= {"force noise above 20 Hz, rms", "time at speed, of that of whole strokes"}


@given(st.floats(0.0, 0.1), st.floats(0.0, 0.1))
def test_the_way_is_as_long_and_as_near_as_there_is_room(before: float, beyond: float) -> None:
    ends = Ends.within(-before, beyond)
    assert -before - 1e-12 <= ends.low_m <= ends.high_m <= beyond + 1e-12
    assert ends.high_m - ends.low_m == pytest.approx(min(2 * HALF_WAY_M, before + beyond))
    if min(before, beyond) >= HALF_WAY_M:
        assert (ends.low_m, ends.high_m) == (-HALF_WAY_M, HALF_WAY_M)


@given(st.floats(0.025, 0.08), st.floats(0.025, 0.08))
def test_a_tool_that_lags_behind_turns_at_the_ends_of_its_way(up: float, down: float) -> None:
    """A tool that follows the target at so great a distance, and stays where it is until the target has passed it."""
    ends = Ends.within(-0.02, 0.03)
    target = tool = 0.0
    turned: list[float] = []
    before = ends.turns
    while before < 8:
        target += 0.002 * ends.direction
        tool = max(tool, target - up) if ends.direction > 0 else min(tool, target + down)
        ends.moved(target, tool)
        if ends.turns > before:
            before = ends.turns
            turned.append(tool)
    # The target moves by 2 mm at a time.
    assert sorted(turned[-2:]) == pytest.approx([-0.02, 0.03], abs=0.0025)


def with_tool(tool: str, *, body: str) -> Subject:
    return Subject(overridden(load_protocol("bathing-v3"), {"person.body": body, "scene.tool": tool}))


def test_a_mitt_has_less_room_before_the_elbow_than_a_cap_and_is_put_back() -> None:
    """By half of what it is longer along the arm: 27 mm and 13 mm."""
    high: dict[str, float] = {}
    for tool in ("caps", "mitt"):
        simulation = with_tool(tool, body="woman-old-light").hovering("upper_arm")
        behind, ahead = (surface_point(simulation, "upper_arm", (off, 0.0)) for off in (-0.03, 0.03))
        slope = (ahead - behind) / 0.06
        before = simulation.data.geom_xpos.copy()
        # As deep as if it had been pressed.
        _, high[tool] = room(simulation, lambda off, slope=slope: off * slope - [0, 0, HOVER_M + 0.01])
        np.testing.assert_array_equal(simulation.data.geom_xpos, before)
    assert 0.0 < high["mitt"] < high["caps"] - 0.006


def test_a_mitt_that_scrubs_a_short_arm_stays_on_its_soft_skin() -> None:
    """Round the same middle as the cap, it ran into the elbow with 60 N and rattled there."""
    simulation = with_tool("mitt", body="woman-old-light").hovering("upper_arm")
    lock_arm(simulation)
    met: set[str] = set()
    advance = simulation.advance

    def watched(steps: int) -> list[Samples]:
        samples = advance(steps)
        met.update(rigid_contacts(simulation))
        return samples

    simulation.advance = watched
    done = scrub(simulation, 15.0, strokes=2, region="upper_arm")
    assert met == set()
    assert done.force_n.max() < 25.0
    assert [m.name for m in done.measures("arm", wanted=15.0, friction=0.5) if m.met is False] == []


def rigid_contacts(simulation: Simulation) -> set[str]:
    """Names of the geoms that the robot touches where no soft skin covers them."""
    model = simulation.model
    names = {model.geom(g).name for contact in simulation.data.contact for g in contact.geom}
    return {name for name in names if name.startswith("human_hull_")}


def test_every_region_is_scrubbed_with_both_forces_and_stroked_slowly(
    subject: Subject, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[str, float, float]] = []

    def noted(
        simulation: object, newton: float, *, strokes: int, region: str, speed_m_s: float = smoothness.SPEED_M_S
    ) -> Scrub:
        asked.append((region, newton, speed_m_s))
        return a_scrub()

    monkeypatch.setattr(smoothness, "scrub", noted)
    smoothness.run(subject, quick=False)
    each = ((5.0, 0.1), (15.0, 0.1), (8.0, 0.01), (8.0, 0.02), (8.0, 0.03))
    assert asked == [(region, *how) for region in subject.regions() for how in each]
