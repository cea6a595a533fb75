from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carecontact.errors import ConfigError
from carecontact.protocol.load import load_protocol
from carecontact.recording import SEGMENTS, Recording
from carecontact.report.tables import limit_rows
from carecontact.scoring import METRICS, TrialScore, score_recording
from carecontact.scoring.actions import Sweep, Touch
from carecontact.scoring.behaviour import BEHAVIOURS
from carecontact.scoring.contact import find_contact
from carecontact.scoring.gate_sweep import own_value, protocol_sweeps
from carecontact.scoring.limits import LIMIT_PACKS, UNCHECKED, LimitPack, footnote
from tests.scoring.synthetic import back_and_forth, before_start, hold, make_recording, push, scrub, touch

SWEEPS = protocol_sweeps(load_protocol("bathing-v3"))
OWN = {"floor_n": "0.5", "push_force_n": "3", "push_wrist_m": "0.02", "scrub_stroke_m": "0.1", "scrub_extent_m": "0.05"}


def levels(recording: Recording, gate: str) -> list[int]:
    return list(score_recording(recording).gate_sweep[gate].values())


def own_level(score: TrialScore) -> int:
    return score.c3_success + score.region_correct + score.safety_gated


RECORDINGS = {
    "touch": touch(),
    "hard": touch(force=60.0),
    "push": push(),
    "weak": push(force=2.0),
    "scrub": scrub(),
    "short": scrub(amplitude=0.02),
    "elsewhere": make_recording(normal={"right_hand": hold(3.0, 1.0, 2.0, 5.0)}),
    "nothing": make_recording(),
    "died": before_start(),
}


@pytest.mark.parametrize("name", RECORDINGS)
def test_at_the_protocols_own_gates_a_sweep_gives_the_verdict(name: str) -> None:
    score = score_recording(RECORDINGS[name])
    assert {gate: list(row) for gate, row in score.gate_sweep.items()} == {
        gate: [f"{v:g}" for v in sweep.values] for gate, (_, sweep) in SWEEPS.items()
    }
    assert {score.gate_sweep[gate][value] for gate, value in OWN.items()} == {own_level(score)}


def test_the_protocols_own_value_is_one_of_each_sweep() -> None:
    found = {
        name: f"{own_value(load_protocol('bathing-v3'), action, sweep):g}" for name, (action, sweep) in SWEEPS.items()
    }
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
        protocol_sweeps(load_protocol("bathing-v3"))


def test_a_sweep_of_a_field_that_the_gate_does_not_have_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"^Tap\.sweeps: the gate has no field 'tapps'; valid: duration_s$"):

        class Tap(Touch):
            sweeps = (Sweep(name="tap_taps", field="tapps", values=(1.0,), title="x", unit="1"),)


FAST = settings(max_examples=15, deadline=None)


def utilisation(pack: str, recording: Recording) -> float | None:
    return METRICS[f"{pack}_utilisation@1"].compute(find_contact(recording))


@pytest.mark.parametrize("pack", [LIMIT_PACKS[name] for name in LIMIT_PACKS], ids=list(LIMIT_PACKS))
def test_every_pack_has_provenance_and_a_limit_for_every_segment(pack: LimitPack) -> None:
    assert LIMIT_PACKS[pack.id] is pack
    assert pack.title
    assert pack.source
    assert all(pack.limit(segment) > 0 for segment in SEGMENTS)
    assert pack.limit("something else") == min(pack.limits.values())


def test_the_protocols_pack_is_the_registered_one() -> None:
    limits = load_protocol("bathing-v3").limits
    assert dict(LIMIT_PACKS[limits.pack].limits) == limits.f_pain_n


def test_the_iso_pack_says_that_it_is_to_be_checked() -> None:
    pack = LIMIT_PACKS["iso-ts-15066-2016"]
    assert pack.status == "to be checked"
    titles = [pack.title, METRICS["iso_utilisation@1"].title, METRICS["pressure_utilisation@2"].title]
    assert [title.count(UNCHECKED) for title in titles] == [1, 1, 1]
    assert footnote(titles).startswith(f"{UNCHECKED} from secondary sources")
    assert footnote(["Peak force"]) == ""
    assert pack.limit("right_forearm") == pack.limit("left_forearm") == 160.0
    assert pack.limit("abdomen") == 110.0


def test_the_pressure_pack_is_in_pascals_and_in_no_table_of_forces() -> None:
    assert LIMIT_PACKS["iso-ts-15066-2016-pressure"].unit == "Pa"
    assert {pack.unit for name, pack in LIMIT_PACKS.items() if "pressure" not in name} == {"N"}
    shown = " ".join(row.name for row in limit_rows([score_recording(touch())], gamma=0.35))
    assert "Quasi-static force" in shown
    assert "pressure" not in shown


def test_utilisation_is_the_peak_over_the_limit_of_the_worst_segment() -> None:
    """20 N on the forearm is 0.2 of its pain limit, 15 N on the abdomen 0.25 of its own."""
    both = {"right_forearm": hold(3.0, 1.0, 2.0, 20.0), "abdomen": hold(3.0, 1.0, 2.0, 15.0)}
    recording = make_recording(normal=both)
    assert utilisation("pain", recording) == pytest.approx(0.25)
    assert utilisation("iso", recording) == pytest.approx(15 / 110)


def test_a_knock_too_brief_to_be_a_contact_counts() -> None:
    knock = make_recording(normal={"right_forearm": hold(3.0, 2.98, 3.0, 120.0)})
    assert not find_contact(knock).valid
    assert utilisation("pain", knock) == pytest.approx(1.2)


@FAST
@given(force=st.floats(1, 150))
def test_pain_utilisation_and_the_safety_gate_agree(force: float) -> None:
    score = score_recording(touch(force=force))
    used = score.additional["pain_utilisation@1"]
    assert used is not None
    assert score.safety_gated == (used <= score_gamma())
    assert bool(score.over_limit) == (used > score_gamma())


def score_gamma() -> float:
    return load_protocol("bathing-v3").limits.gamma
