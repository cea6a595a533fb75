from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carecontact.behaviours import Sweep
from carecontact.behaviours.touch import Touch
from carecontact.contract.protocol import BEHAVIOURS
from carecontact.errors import ConfigError
from carecontact.protocols import load_protocol
from carecontact.recording import Recording
from carecontact.scoring import TrialScore, score_recording
from carecontact.scoring.gate_sweep import own_value, protocol_sweeps
from tests.scoring.synthetic import back_and_forth, before_start, hold, make_recording, push, scrub, touch

SWEEPS = protocol_sweeps(load_protocol())
OWN = {"floor_n": "0.5", "push_force_n": "3", "push_wrist_m": "0.02", "scrub_stroke_m": "0.1", "scrub_extent_m": "0.05"}


def levels(recording: Recording, gate: str) -> list[int]:
    return list(score_recording(recording).gate_sweep[gate].values())


def own_level(score: TrialScore) -> int:
    return score.c3_success + score.region_correct + score.safety_gated


RECORDINGS = {
    "touch": touch(), "hard": touch(force=60.0), "push": push(), "weak": push(force=2.0), "scrub": scrub(),
    "short": scrub(amplitude=0.02), "elsewhere": make_recording(normal={"right_hand": hold(3.0, 1.0, 2.0, 5.0)}),
    "nothing": make_recording(), "died": before_start(),
}  # fmt: skip


@pytest.mark.parametrize("name", RECORDINGS)
def test_at_the_protocols_own_gates_a_sweep_gives_the_verdict(name: str) -> None:
    score = score_recording(RECORDINGS[name])
    assert {gate: list(row) for gate, row in score.gate_sweep.items()} == {
        gate: [f"{v:g}" for v in sweep.values] for gate, (_, sweep) in SWEEPS.items()
    }
    assert {score.gate_sweep[gate][value] for gate, value in OWN.items()} == {own_level(score)}


def test_the_protocols_own_value_is_one_of_each_sweep() -> None:
    found = {name: f"{own_value(load_protocol(), action, sweep):g}" for name, (action, sweep) in SWEEPS.items()}
    assert found == OWN


def test_each_gate_decides_where_its_value_says() -> None:
    assert levels(push(force=4.0), "push_force_n") == [3, 3, 0]
    assert levels(push(force=4.0, shift=0.025), "push_wrist_m") == [3, 3, 0]
    assert levels(scrub(amplitude=0.03), "scrub_extent_m") == [3, 3, 0]
    assert levels(scrub(amplitude=0.02), "scrub_extent_m") == [3, 0, 0]
    brief = make_recording(
        "T3",
        duration=6.0,
        normal={"right_forearm": hold(6.0, 1.0, 3.4, 5.0)},
        tcp_in_region=back_and_forth(6.0, "forearm", amplitude=0.03, period=2.0),
    )
    assert score_recording(brief).stroke_m == pytest.approx(0.14, abs=0.02)
    assert levels(brief, "scrub_stroke_m") == [3, 0]


def test_the_floor_decides_who_is_touched() -> None:
    assert levels(touch(force=0.4), "floor_n") == [3, 0, 0, 0]
    assert levels(touch(force=1.5), "floor_n") == [3, 3, 3, 0]
    assert levels(touch(force=5.0), "floor_n") == [3, 3, 3, 3]


def test_a_swept_floor_keeps_the_ratio_of_off_to_on() -> None:
    """5 N with a dip to 0.7 N between: at a floor of 2 N contact is off below 1 N, at 1 N below 0.5 N."""
    dipping = hold(3.0, 1.0, 1.3, 5.0) + hold(3.0, 1.3, 1.5, 0.7) + hold(3.0, 1.5, 1.8, 5.0)
    assert levels(make_recording(normal={"right_forearm": dipping}), "floor_n") == [3, 3, 3, 0]


def test_gates_of_another_action_leave_a_trial_alone() -> None:
    assert levels(touch(), "push_force_n") == [3, 3, 3]
    assert levels(push(shift=0.0), "scrub_extent_m") == [0, 0, 0]


@settings(max_examples=15, deadline=None)
@given(force=st.floats(0.5, 60), shift=st.floats(0, 0.05))
def test_a_stricter_gate_never_helps(force: float, shift: float) -> None:
    score = score_recording(push(force=force, shift=shift))
    for gate in ("push_force_n", "push_wrist_m"):
        row = list(score.gate_sweep[gate].values())
        assert row == sorted(row, reverse=True)


@pytest.mark.parametrize(("name", "owner"), [("floor_n", "the contact floor"), ("push_force_n", "action 'push'")])
def test_a_sweep_with_the_name_of_another_is_refused(name: str, owner: str, monkeypatch: pytest.MonkeyPatch) -> None:
    class Tap(Touch):
        sweeps = (Sweep(name=name, field="duration_s", values=(1.0,), title="x", unit="s"),)

    monkeypatch.setitem(BEHAVIOURS._rows, "touch", Tap())
    with pytest.raises(ConfigError, match=f"{owner}.* both have a sweep named '{name}'; begin"):
        protocol_sweeps(load_protocol())


def test_a_sweep_of_a_field_that_the_gate_does_not_have_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"^Tap\.sweeps: the gate has no field 'tapps'; valid: duration_s$"):

        class Tap(Touch):
            sweeps = (Sweep(name="tap_taps", field="tapps", values=(1.0,), title="x", unit="1"),)
