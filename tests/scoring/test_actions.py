"""Every registered action: its schema, its sweeps and its words hold together."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from carecontact.errors import ConfigError, RecordingError, UnknownNameError
from carecontact.protocol.gates import ACTIONS, GATES, Gates, Section
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import Protocol
from carecontact.recording import SEGMENTS, Recording
from carecontact.scoring import METRICS, TrialScore, score_recording
from carecontact.scoring.actions import BEHAVIOURS, Behaviour
from carecontact.scoring.behaviour import Attempt, GatePart, actions_that_move, ask, behaviour_of
from carecontact.scoring.commanded import CommandedContact
from carecontact.scoring.contact import find_contact, held_force
from carecontact.scoring.gate_sweep import own_value, protocol_sweeps
from carecontact.scoring.metrics.success import judge
from carecontact.scoring.progress import Track, Wiping, wiping
from tests.scoring.synthetic import (
    F64,
    GENTLE,
    PROTOCOL,
    SIZE,
    TABLE,
    back_and_forth,
    hold,
    make_recording,
    push,
    scrub,
    seconds,
    touch,
)

BEHAVIOURS_PROTOCOL = load_protocol("bathing-v3")
GOOD = {"touch": touch, "push": push, "scrub": scrub}
PROGRESS = {
    "touch": (r"touched for 1\.\d+ s", r"touched for 1\.\d+ s, 1\.\d+ s of it gently"),
    "push": (r"wrist moved \d+ mm, pressed for \d\.\d+ s", r"wrist moved \d+ mm from where .*, pressed for .*"),
    "scrub": (r"stroke \d+ mm, extent \d+ mm, \d reversals", r"\d+ mm passed three times, \d+% of the sliding gently"),
}
"""Action -> what a progress line says of a good trial under the gates of the paper and of the exam."""
ASKED = {
    "touch": {"hold_s": 1.0},
    "push": {"hold_s": 1.0, "way_m": 0.02},
    "scrub": {"extent_m": 0.06, "reversals": 2},
}
"""Action -> the commanded contact that is just enough for the exam."""


def test_the_shipped_actions_are_registered() -> None:
    assert set(GOOD) <= set(BEHAVIOURS)
    assert actions_that_move() >= {"push"}
    assert not actions_that_move() & {"touch", "scrub"}


@pytest.mark.parametrize("gates", ["paper", "exam"])
@pytest.mark.parametrize("action", sorted(BEHAVIOURS))
def test_sweeps_move_fields_of_the_gate(action: str, gates: str) -> None:
    behaviour = behaviour_of(action, gates)
    assert issubclass(behaviour.gate, Section)
    for sweep in behaviour.sweeps:
        assert sweep.field in behaviour.gate.model_fields
        assert sweep.name.startswith(f"{action}_")
        assert sorted(sweep.values) == list(sweep.values)


@pytest.mark.parametrize("protocol", [BEHAVIOURS_PROTOCOL, GENTLE], ids=lambda protocol: protocol.gates.set)
@pytest.mark.parametrize("action", sorted(GOOD))
def test_a_good_trial_passes_and_an_empty_one_is_shown_what_is_missing(action: str, protocol: Protocol) -> None:
    score = score_recording(GOOD[action](protocol=protocol))
    assert score.c3_success
    behaviour = behaviour_of(action, protocol.gates.set)
    assert re.fullmatch(PROGRESS[action][protocol is GENTLE], behaviour.progress(score))
    task = next(task.id for task in BEHAVIOURS_PROTOCOL.tasks if task.action == action)
    contact = find_contact(make_recording(task, protocol=protocol))
    result = judge(contact)
    assert not result.success
    assert behaviour.shortfall(contact, protocol.gates.of(action), result)


@pytest.mark.parametrize("action", ["touch", "push"])
def test_a_hold_of_just_the_required_time_is_enough(action: str) -> None:
    contact, gate = find_contact(GOOD[action](protocol=GENTLE)), GENTLE.gates.of(action)
    for held, enough in ((500, True), (499, False)):
        attempt = Attempt(held_steps=held, best=None, wrist_m=0.0, wrist_any_m=0.0)
        assert behaviour_of(action, GENTLE.gates.set).judge(contact, gate, attempt).time_met is enough


@pytest.mark.parametrize("action", sorted(ASKED))
def test_a_command_asks_for_enough_where_each_of_its_quantities_does(action: str) -> None:
    gate, behaviour = GENTLE.gates.of(action), behaviour_of(action, GENTLE.gates.set)
    enough = CommandedContact(**ASKED[action])
    assert behaviour.requested(gate, enough)
    for name, value in ASKED[action].items():
        less = value - 1 if isinstance(value, int) else 0.99 * value
        assert behaviour.requested(gate, replace(enough, **{name: less})) is None


def test_an_action_without_a_gate_in_the_protocol_lists_those_that_have_one() -> None:
    with pytest.raises(UnknownNameError, match="no gate named 'hold'; valid: push, scrub, touch"):
        BEHAVIOURS_PROTOCOL.gates.of("hold")


@pytest.mark.parametrize(("row", "what"), [(Behaviour, "the class Behaviour"), ("touch", "a str")])
def test_a_row_that_is_no_behaviour_object_is_refused(row: Any, what: str) -> None:
    with pytest.raises(ConfigError, match=f"^action 'odd' is {what}; expected a Behaviour object$"):
        BEHAVIOURS.register("odd", row)


@pytest.mark.parametrize("action", GATES)
def test_the_protocol_knows_the_gates_of_the_shipped_actions_without_them(action: str) -> None:
    for name, schema in GATES[action].items():
        assert behaviour_of(action, name).gate is schema


def test_an_action_that_a_process_registers_can_be_named_in_its_protocols(monkeypatch: pytest.MonkeyPatch) -> None:
    for registry in (ACTIONS, BEHAVIOURS):
        for state in ("_rows", "_origins"):
            monkeypatch.setattr(registry, state, dict(getattr(registry, state)))
    behaviour = BEHAVIOURS.register("tap", behaviour_of("touch", "paper"))
    assert behaviour_of("tap", "exam") is behaviour_of("touch", "exam")
    assert Gates.model_validate(TABLE | {"tap": TABLE["touch"]}).of("tap") == GENTLE.gates.of("touch")
    assert behaviour.gate_in("paper") is GATES["touch"]["paper"]


# exam on traces whose answer is known: bands of force, passes of the axis, and the wrist since contact.


def touched(*spans: tuple[float, float, float], duration: float = 6.0) -> TrialScore:
    """Start, stop and force of each hold on the forearm."""
    force = np.sum([hold(duration, *span) for span in spans], axis=0)
    return score_recording(make_recording("T1", duration=duration, normal={"right_forearm": force}, protocol=GENTLE))


@pytest.mark.parametrize(
    ("force", "length", "passes"),
    [(1.0, 1.2, True), (6.0, 1.2, True), (0.9, 3.0, False), (6.1, 3.0, False), (3.0, 0.9, False), (3.0, 1.05, True)],
)
def test_a_touch_is_held_in_the_band_for_a_second(force: float, length: float, passes: bool) -> None:
    score = touched((1.0, 1.0 + length, force))
    assert score.c3_success is passes
    in_band = length if 1.0 <= force <= 6.0 else 0.0
    # For the mean over 0.1 s, each of the two steps of the force lies up to 0.05 s earlier or later.
    assert score.additional["gentle_hold@2"] == pytest.approx(in_band, abs=0.101)


def test_a_hard_touch_is_outside_the_band() -> None:
    score = touched((1.0, 4.0, 9.0))
    assert (score.failure_mode, score.attribution) == ("outside_band", "planning")
    commanded = make_recording(
        "T1",
        normal={"right_forearm": hold(3.0, 0.5, 2.9, 9.0)},
        protocol=GENTLE,
        targets_in_region=[(0.1, (0.0, 0.0, SIZE["forearm"][2] - 0.02))],
    )
    score = score_recording(commanded)
    assert "the longest hold with 1 to 6 N was 0.04 s of 1 s; the tool's longest contact was 2.4" in score.evidence
    assert score.evidence.endswith("median 9.0 N.")


def test_a_brief_touch_lacks_time_and_not_gentleness() -> None:
    assert touched((1.0, 1.3, 3.0)).failure_mode == "insufficient_progress"
    assert touched((1.0, 1.7, 3.0)).failure_mode == "lost_contact"


def test_a_ripple_of_single_steps_does_not_leave_the_band_and_a_push_does() -> None:
    def rippled(depth: float, width: float) -> bool:
        force = hold(3.0, 0.5, 2.3, 4.0)
        for start in np.arange(0.7, 2.3, 0.4):
            force[(seconds(3.0) > start) & (seconds(3.0) <= start + width)] += depth
        return score_recording(make_recording("T1", normal={"right_forearm": force}, protocol=GENTLE)).c3_success

    assert rippled(10.0, 0.004)
    assert not rippled(10.0, 0.05)


def wiped(
    amplitude: float, *, periods: float = 2.0, force: float | F64 = 4.0, task: str = "T3", **options: Any
) -> Recording:
    """A scrub that swings to and fro: 2 s a period, in contact all the time."""
    duration = 2.0 * periods
    return make_recording(
        task,
        duration=duration,
        normal={"right_forearm": np.broadcast_to(force, (round(duration / 0.002),))},
        tcp_in_region=back_and_forth(duration, "forearm", amplitude=amplitude, period=2.0),
        **({"protocol": GENTLE} | options),
    )


@pytest.mark.parametrize(
    ("amplitude", "periods", "passed_mm"),
    [(0.05, 2.0, 100), (0.05, 1.5, 48), (0.05, 1.0, 0), (0.028, 2.0, 56), (0.08, 3.0, 160)],
)
def test_the_length_passed_three_times_is_that_of_the_swing(amplitude: float, periods: float, passed_mm: float) -> None:
    """A swing starts in the middle: 1.5 periods pass one half four times and the other twice."""
    recording = wiped(amplitude, periods=periods)
    score = score_recording(recording)
    assert score.additional["axis_passed@2"] == pytest.approx(passed_mm / 1000, abs=0.006)
    assert score.c3_success is (passed_mm > 66)


@given(amplitude=st.floats(0.012, 0.11), periods=st.integers(1, 6))
@settings(max_examples=20, deadline=None)
def test_a_swing_passes_each_place_once_in_each_direction(amplitude: float, periods: int) -> None:
    """A swing passes each place to either side of the middle twice a period."""
    counts = wiping(find_contact(wiped(amplitude, periods=periods))).passes(1.0)
    middle, half = len(counts) // 2, round(amplitude * 1000)
    assert counts[middle + half // 2] == counts[middle - half // 2] == 2 * periods
    assert not counts[middle + half + 6 :].any()
    assert not counts[: middle - half - 6].any()


def test_a_stroke_passes_each_part_between_its_ends_once() -> None:
    axis, on = np.array([-0.05, 0.0, 0.05, -0.05]), np.ones(4, np.bool_)
    track = Track(step=np.arange(4), surface=np.stack([axis, 0 * axis], axis=1), on=on, joined=on[1:])
    for length_m, passed in ((0.24, np.repeat([0, 2, 0], [70, 100, 70])), (0.08, np.full(80, 2))):
        made = Wiping(
            track=track, force=np.full(4, 4.0), whole=np.full(4, 4.0), length_m=length_m, reversal_m=0.01, moving=on[1:]
        )
        assert np.array_equal(made.passes(1.0), passed)


def test_the_held_force_is_the_mean_of_a_tenth_of_a_second_around_each_step() -> None:
    force = np.random.default_rng(4).uniform(0.0, 9.0, 1500)
    found = held_force(replace(find_contact(touch()), neighbourhood_force=force))
    np.testing.assert_allclose(found, [force[max(i - 25, 0) : i + 26].mean() for i in range(1500)], atol=1e-6)


def test_trembling_on_a_place_is_no_wiping() -> None:
    fast = back_and_forth(4.0, "forearm", amplitude=0.004, period=0.5)
    slow = back_and_forth(4.0, "forearm", amplitude=0.05, period=8.0)
    recording = make_recording(
        "T3", duration=4.0, normal={"right_forearm": np.full(2000, 4.0)}, tcp_in_region=fast + slow, protocol=GENTLE
    )
    assert wiping(find_contact(recording)).passes(1.0).max() <= 2


def test_strokes_in_one_direction_count_where_the_tool_is_lifted_between() -> None:
    """Three wipes from one end to the other, the way back through the air."""
    t = seconds(6.0)
    path = np.zeros((len(t), 3))
    path[:, 0] = -0.05 + 0.1 * np.clip(np.minimum((t % 2.0), (2.0 - t % 2.0) / 0.8 * 1.0), 0, 1)
    path[:, 2] = SIZE["forearm"][2]
    pressed = np.where(t % 2.0 < 1.0, 4.0, 0.0)
    score = score_recording(
        make_recording("T3", duration=6.0, normal={"right_forearm": pressed}, tcp_in_region=path, protocol=GENTLE)
    )
    assert score.additional["axis_passed@2"] == pytest.approx(0.095, abs=0.01)
    assert score.c3_success


def test_a_light_scrub_and_a_hard_one_are_outside_of_the_band() -> None:
    for force, words in ((0.7, "0 mm of 60 mm were passed 3 times with at least 1 N (100 mm"), (12.0, "0% of the")):
        recording = wiped(0.05, force=force, targets_in_region=[(0.1, (0.0, 0.0, SIZE["forearm"][2] - 0.02))])
        score = score_recording(recording)
        assert score.failure_mode == "outside_band"
        assert words in score.evidence
    assert score_recording(wiped(0.02)).failure_mode == "insufficient_progress"


@pytest.mark.parametrize(("gentle", "passes"), [(0.75, True), (0.65, False)])
def test_most_of_the_sliding_is_in_the_band(gentle: float, passes: bool) -> None:
    """The first part of 8 s at 4 N, the rest at 12 N."""
    force = np.where(seconds(8.0) <= 8.0 * gentle, 4.0, 12.0)
    score = score_recording(wiped(0.05, periods=4.0, force=force))
    assert score.additional["gentle_share@2"] == pytest.approx(gentle, abs=0.03)
    assert score.c3_success is passes


def pushed(way: F64, *, force: F64 | None = None, duration: float = 6.0) -> TrialScore:
    force = hold(duration, 3.0, 5.0, 8.0) if force is None else force
    return score_recording(
        make_recording(
            "T2",
            duration=duration,
            normal={"right_forearm": force},
            wrist_shift=way,
            protocol=GENTLE,
            targets_in_region=[(0.1, (0.0, 0.0, SIZE["forearm"][2] - 0.02))],
        )
    )


@pytest.mark.parametrize(
    ("way", "force", "length", "mode"),
    [
        (0.03, 8.0, 2.0, None),
        (0.019, 8.0, 2.0, "insufficient_progress"),
        (0.105, 8.0, 2.0, "outside_band"),
        (0.03, 3.1, 1.05, None),
        (0.03, 2.9, 2.0, "insufficient_progress"),
        (0.03, 8.0, 0.6, "lost_contact"),
        (0.03, 8.0, 0.4, "insufficient_progress"),
    ],
)
def test_a_push_has_a_least_and_a_most_way_a_force_and_a_time(
    way: float, force: float, length: float, mode: str | None
) -> None:
    t = seconds(6.0)
    score = pushed(way * np.clip((t - 3.1) / 0.2, 0, 1), force=hold(6.0, 3.0, 3.0 + length, force))
    assert score.failure_mode == mode
    assert score.additional["wrist_from_onset@2"] == pytest.approx(way, abs=1e-4)
    if mode in ("insufficient_progress", "outside_band"):
        assert f"the wrist moved {way * 1000:.0f} mm, where 20 mm to 100 mm are required" in score.evidence


def test_what_a_person_moved_before_the_contact_is_not_pushed() -> None:
    """60 mm of its own a second before; paper lets that pass, and exam fails it and forgives it too."""
    own = 0.06 * np.clip(seconds(6.0) - 1.0, 0, 1)
    alone = pushed(own)
    assert alone.wrist_displacement_m == pytest.approx(0.06, abs=1e-4)
    assert alone.additional["wrist_from_onset@2"] == pytest.approx(0.0, abs=1e-5)
    assert not alone.c3_success
    assert pushed(own + 0.05 * np.clip(seconds(6.0) - 3.2, 0, 1)).c3_success
    assert score_recording(
        make_recording(
            "T2", duration=6.0, normal={"right_forearm": hold(6.0, 3.0, 5.0, 8.0)}, wrist_shift=own, protocol=PROTOCOL
        )
    ).c3_success


def test_each_contact_has_an_onset_of_its_own() -> None:
    """A brush at the beginning, the person moves by itself, then a contact that does not push."""
    force = hold(6.0, 0.5, 0.7, 2.0) + hold(6.0, 3.0, 5.0, 8.0)
    own = 0.06 * np.clip(seconds(6.0) - 1.0, 0, 1)
    assert pushed(own, force=force).additional["wrist_from_onset@2"] == pytest.approx(0.0, abs=1e-5)


@settings(max_examples=12, deadline=None)
@given(force=st.floats(0.3, 9.0), length=st.floats(0.2, 2.0), longer=st.floats(0.0, 2.0))
def test_a_longer_hold_never_takes_a_pass_away(force: float, length: float, longer: float) -> None:
    short, long = touched((0.5, 0.5 + length, force)), touched((0.5, 0.5 + length + longer, force))
    assert long.c3_success >= short.c3_success


@settings(max_examples=8, deadline=None)
@given(amplitude=st.floats(0.01, 0.1), periods=st.integers(1, 3), more=st.integers(0, 2), force=st.floats(0.6, 10.0))
def test_more_wiping_of_the_same_kind_never_takes_a_pass_away(
    amplitude: float, periods: int, more: int, force: float
) -> None:
    few = score_recording(wiped(amplitude, periods=periods, force=force))
    many = score_recording(wiped(amplitude, periods=periods + more, force=force))
    assert many.c3_success >= few.c3_success


@settings(max_examples=8, deadline=None)
@given(force=st.floats(0.5, 20.0), way=st.floats(0.0, 0.15))
def test_a_stricter_gate_never_helps(force: float, way: float) -> None:
    rising = {"touch_most_n", "scrub_most_n", "push_most_wrist_m"}
    for recording in (touch(force, protocol=GENTLE), push(force, way, protocol=GENTLE), scrub(way, protocol=GENTLE)):
        for gate, row in score_recording(recording).gate_sweep.items():
            levels = list(row.values())
            assert levels == sorted(levels, reverse=gate not in rising), gate


def test_the_gates_own_values_are_among_those_of_their_sweeps() -> None:
    for name, (action, sweep) in protocol_sweeps(GENTLE).items():
        assert own_value(GENTLE, action, sweep) in sweep.values, name


@pytest.mark.parametrize(
    ("recording", "harder"),
    [
        (touch(3.0), 0.0),
        (make_recording("T1", normal={"right_forearm": hold(3.0, 0.5, 2.5, 3.0)}), 1.0),
        (make_recording("T1", normal={"right_forearm": hold(3.0, 0.5, 2.5, 5.0)}), 0.0),
        (push(8.0, 0.05), 1.0),
        (push(8.0, 0.07), 0.0),
        (wiped(0.05, periods=1.75, force=1.2, protocol=PROTOCOL), 1.0),
        (wiped(0.035, protocol=PROTOCOL), 0.0),
    ],
)
def test_the_harder_band_is_reported_under_any_gates(recording: Recording, harder: float) -> None:
    assert score_recording(recording).c3_success
    assert score_recording(recording).additional["harder_band@2"] == harder


def test_nothing_touched_is_na_and_no_pass() -> None:
    score = score_recording(make_recording("T3", protocol=GENTLE))
    assert not score.c3_success
    assert score.additional["harder_band@2"] == 0.0
    for name in ("gentle_hold@2", "axis_passed@2", "gentle_share@2", "wrist_from_onset@2"):
        assert score.additional[name] is None
        assert name in METRICS


@pytest.mark.parametrize(
    ("action", "change", "words"),
    [
        ("touch", {"most_n": 1.0}, "least_n 1 has to be below most_n 1"),
        ("push", {"most_wrist_m": 0.02}, "least_wrist_m 0.02 has to be below most_wrist_m 0.02"),
        ("scrub", {"stroke_m": 0.1}, "Extra inputs"),
    ],
)
def test_a_gate_that_cannot_be_met_or_is_of_another_version_is_refused(
    action: str, change: dict[str, float], words: str
) -> None:
    with pytest.raises(ValidationError, match=words):
        Gates.model_validate(TABLE | {action: TABLE[action] | change})


def beside(**parts: F64) -> dict[str, Any]:
    """Arrays of what hand or links of the robot did of the force on the forearm, straight down."""
    count = len(next(iter(parts.values())))
    normal = np.zeros((count, 2, len(SEGMENTS)), np.float32)
    for part, force in parts.items():
        normal[:, ("hand", "links").index(part), SEGMENTS.index("right_forearm")] = force
    vector = np.zeros((*normal.shape, 3), np.float32)
    vector[..., 2] = -normal
    return {"scorer/beside_force_in_world": vector, "scorer/beside_normal_force": normal}


@pytest.mark.parametrize(
    ("whole", "hand", "mode"),
    [
        (3.0, 0.0, None),
        (3.0, 1.0, None),
        (3.0, 2.5, "not_by_tool"),
        (3.0, 3.0, "not_by_tool"),
        # The tool's 4 N are gentle, but the person bears 7 N; of 5 N, the tool's 0.9 N are too light.
        (7.0, 3.0, "outside_band"),
        (1.5, 0.7, "outside_band"),
    ],
)
def test_a_touch_is_the_tool_s_and_gentle_is_what_the_person_bears(whole: float, hand: float, mode: str | None) -> None:
    force, part = (hold(4.0, 1.0, 3.0, newton) for newton in (whole, hand))
    score = score_recording(
        make_recording("T1", duration=4.0, normal={"right_forearm": force}, extra=beside(hand=part), protocol=GENTLE)
    )
    assert (score.c3_success, score.failure_mode) == (mode is None, mode)


def test_a_push_and_a_scrub_are_the_tool_s_too() -> None:
    for trial in (push(5.0, 0.05, protocol=GENTLE), wiped(0.05, periods=1.75)):
        assert score_recording(trial).c3_success
        by_links = beside(links=trial["scorer/normal_force"][:, SEGMENTS.index("right_forearm")])
        score = score_recording(Recording(header=trial.header, arrays={**trial.arrays, **by_links}))
        assert (score.c3_success, score.failure_mode) == (False, "not_by_tool")
        assert "touched by the links, not by the tool" in (score.evidence or "")


def test_parts_beyond_the_whole_are_refused() -> None:
    trial = make_recording("T1", normal={"right_forearm": hold(3.0, 1.0, 2.0, 3.0)}, protocol=GENTLE)
    more = beside(hand=hold(3.0, 1.0, 2.0, 3.5))
    with pytest.raises(RecordingError, match="together at most the whole"):
        score_recording(Recording(header=trial.header, arrays={**trial.arrays, **more}))
    del more["scorer/beside_force_in_world"]
    with pytest.raises(RecordingError, match="both or none"):
        score_recording(Recording(header=trial.header, arrays={**trial.arrays, **more}))


# The requirements of a gate one by one: all of them are met exactly where the gate is.


def parts_of(recording: Any) -> tuple[list[GatePart], bool]:
    contact = find_contact(recording)
    gate = judge(contact)
    found = ask(contact, "parts", contact, contact.protocol.gates.of(contact.task.action), gate)
    return found, gate.time_met and gate.progress_met and gate.band_met


@pytest.mark.parametrize("protocol", [PROTOCOL, GENTLE], ids=["paper", "exam"])
@given(data=st.data())
@settings(max_examples=25, deadline=None)
def test_all_parts_are_met_exactly_where_the_gate_is(protocol: Protocol, data: st.DataObject) -> None:
    force, length = data.draw(st.floats(0.2, 9.0)), data.draw(st.floats(0.1, 3.5))
    action = data.draw(st.sampled_from(["T1", "T2", "T3"]))
    t = seconds(5.0)
    tip = np.zeros((len(t), 3))
    tip[:, 0] = data.draw(st.floats(0.0, 0.09)) * np.sin(2 * np.pi * t / data.draw(st.floats(0.5, 4.0)))
    tip[:, 2] = SIZE["forearm"][2]
    wrist = np.clip((t - 1.0) / length, 0, 1) * data.draw(st.floats(0.0, 0.13))
    found, passed = parts_of(
        make_recording(
            action,
            duration=5.0,
            normal={"right_forearm": hold(5.0, 1.0, 1.0 + length, force)},
            tcp_in_region=tip,
            wrist_shift=wrist,
            protocol=protocol,
        )
    )
    assert found
    assert all(part.met for part in found) is passed


@pytest.mark.parametrize(
    ("recording", "missed"),
    [
        (push(), []),
        (push(force=2.0), [("Pressed with at least 3 N without interruption", "1 s", "0.00 s (largest force 2.0 N)")]),
        (push(shift=0.012), [("Distance the wrist moved while the arm is touched", "at least 20 mm", "12.0 mm")]),
        (
            push(shift=0.15, protocol=GENTLE),
            [("Distance the wrist moved from where it was when the contact began", "20 mm to 100 mm", "150.0 mm")],
        ),
        (
            scrub(amplitude=0.015),
            [
                ("Distance the tool moved along the skin", "at least 100 mm", "104.0 mm"),
                ("Length of the region that it covers", "at least 50 mm", "30.0 mm"),
            ][1:],
        ),
    ],
)
def test_what_was_missed_is_reported_with_what_was_needed(recording: Any, missed: list[tuple[str, str, str]]) -> None:
    found, _ = parts_of(recording)
    message = [(part.name, part.needed, part.reached) for part in found if not part.met]
    assert [(name, needed) for name, needed, _ in message] == [(name, needed) for name, needed, _ in missed]
    for (_, _, reached), (_, _, known) in zip(message, missed, strict=True):
        assert reached.split()[1:] == known.split()[1:]
        assert float(reached.split()[0]) == pytest.approx(float(known.split()[0]), abs=1.5)
