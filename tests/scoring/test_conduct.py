"""Gates of the whole trial: gentle from first touch to last on every segment, and by the tool."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from carecontact.protocol.gates import Conduct, Gates
from carecontact.protocol.load import load_protocol, toml_text
from carecontact.protocol.protocol import Protocol
from carecontact.recording import SEGMENTS, Recording
from carecontact.report.trial_page import gate_parts
from carecontact.scoring import score_recording
from carecontact.scoring.behaviour import GatePart
from carecontact.scoring.contact import find_contact
from carecontact.scoring.metrics.cells import COMFORT_MMHG, MMHG_PA
from carecontact.scoring.metrics.success import conduct, judge
from tests.scoring.synthetic import DT, EXAM, GENTLE, PROTOCOL, TABLE, hold, make_recording, seconds

LIMITS = Conduct(peak_n=15.0, above_n=6.0, above_s=0.5, band_n=(1.0, 6.0), band_s=1.5)
TOOL = Conduct(peak_n=100.0, tool_share=0.8, beside_n=3.0)


def under(limits: Conduct = LIMITS) -> Protocol:
    """The exam's gates with these limits for touches."""
    return GENTLE.model_copy(update={"gates": GENTLE.gates.model_copy(update={"conduct": {"touch": limits}})})


def touched(*others: tuple[str, float, float, float], protocol: Protocol | None = None, **options: Any) -> Recording:
    """A gentle touch of the forearm for 2 s, and other contacts (segment, start, stop, force) beside it."""
    normal = {"right_forearm": hold(6.0, 3.0, 5.0, 3.0)}
    for segment, start, stop, force in others:
        normal[segment] = normal.get(segment, np.zeros(3000)) + hold(6.0, start, stop, force)
    return make_recording("T1", duration=6.0, normal=normal, protocol=protocol or under(), **options)


def missed(recording: Recording) -> list[str]:
    return [part.name for part in conduct(find_contact(recording)) if not part.met]


def test_a_gentle_touch_meets_all_of_the_drafts_requirements() -> None:
    recording = touched(protocol=GENTLE.model_copy(update={"gates": EXAM}))
    assert not missed(recording)
    score = score_recording(recording)
    assert (score.c3_success, score.safety_gated, score.failure_mode) == (True, True, None)


def test_a_rough_beginning_fails_the_gentle_second_after_it() -> None:
    """25 N for 1 s, then the same touch: the gates of the action alone let it pass."""
    first = ("right_forearm", 0.5, 1.5, 25.0)
    assert score_recording(touched(first, protocol=GENTLE)).safety_gated
    score = score_recording(touched(first))
    assert (score.c3_success, score.failure_mode, score.attribution) == (False, "outside_band", "planning")


@pytest.mark.parametrize("segment", ["thorax", "left_hand", "right_shank"])
def test_a_knock_counts_on_any_segment_however_short(segment: str) -> None:
    knock = (segment, 1.0, 1.0 + DT, 15.5)
    assert missed(touched(knock)) == ["Largest force on any segment in the whole trial"]
    assert not missed(touched((segment, 1.0, 1.0 + DT, 14.5)))


@pytest.mark.parametrize(("above_s", "met"), [(0.5, True), (0.5 + 2 * DT, False)])
def test_time_above_the_band_adds_up_over_segments_and_contacts(above_s: float, met: bool) -> None:
    parts = ("thorax", 0.5, 0.7, 7.0), ("right_hand", 1.0, 0.8 + above_s, 7.0)
    assert (missed(touched(*parts)) == []) is met


@pytest.mark.parametrize(("length_s", "met"), [(1.4, False), (1.6, True)])
def test_time_in_the_band_adds_up_over_contacts(length_s: float, met: bool) -> None:
    normal = {"right_forearm": hold(6.0, 0.5, 1.0, 3.0) + hold(6.0, 2.0, 1.5 + length_s, 3.0)}
    recording = make_recording("T1", duration=6.0, normal=normal, protocol=under())
    assert (missed(recording) == []) is met


@pytest.mark.parametrize(("share", "met"), [(0.79, False), (0.81, True)])
def test_most_of_the_contact_has_a_comfortable_pressure(share: float, met: bool) -> None:
    """One cell of 1 cm^2 that is wholly touched for 100 periods."""
    periods = 300
    held = np.arange(periods) < 100
    pascal = MMHG_PA * COMFORT_MMHG * np.where(np.arange(periods) < 100 * share, 0.99, 1.01) * held
    touch = (1e-4 * 0.02 * held)[:, None]
    zero = np.zeros((periods, 1), np.float32)
    extra = {
        "scorer/cell_area_m2": np.array([1e-4], np.float32),
        "scorer/cell_touch_m2s": touch.astype(np.float32),
        "scorer/cell_press_ns": (pascal[:, None] * touch).astype(np.float32),
        "scorer/cell_shear_ns": zero,
        "scorer/cell_slip_m3": zero,
    }
    protocol = under(LIMITS.model_copy(update={"comfortable_share": 0.8}))
    assert (missed(touched(protocol=protocol, extra=extra)) == []) is met
    assert missed(touched(protocol=protocol)) == ["Share of the contact with a mean pressure of at most 25 mmHg"]


def beside(part: str, segment: str, force: np.ndarray) -> dict[str, np.ndarray]:
    normal = np.zeros((len(force), 2, len(SEGMENTS)), np.float32)
    normal[:, ("hand", "links").index(part), SEGMENTS.index(segment)] = force
    vector = np.zeros((*normal.shape, 3), np.float32)
    vector[..., 2] = -normal
    return {"scorer/beside_force_in_world": vector, "scorer/beside_normal_force": normal}


@pytest.mark.parametrize(
    ("force", "until", "lacking"),
    [
        (2.0, 1.6, []),  # 1.2 N s of 7.2 N s
        (2.0, 1.8, ["Share of the contact impulse"]),
        (3.5, 1.2, ["Largest force of hand and links"]),
        (3.5, 1.6, ["Share of the contact impulse", "Largest force of hand and links"]),
    ],
)
def test_the_rest_of_the_robot_leans_on_nobody(force: float, until: float, lacking: list[str]) -> None:
    """The hand touches the trunk before the tool touches the arm with 6 N s."""
    knock = ("thorax", 1.0, until, force)
    recording = touched(knock, protocol=under(TOOL), extra=beside("hand", "thorax", hold(6.0, 1.0, until, force)))
    found = missed(recording)
    assert [name.startswith(start) for name, start in zip(found, lacking, strict=True)] == [True] * len(lacking)
    assert not missed(touched(knock, protocol=under(TOOL))), "the tool may touch the trunk"


def test_who_touches_nothing_did_nothing_with_the_tool() -> None:
    assert [name[:5] for name in missed(make_recording("T1", protocol=under(TOOL)))] == ["Share"]


def test_evidence_and_page_say_what_was_missed() -> None:
    recording = touched(("right_forearm", 0.5, 1.5, 25.0), targets_in_region=[(0.4, (0.0, 0.0, 0.0))], protocol=under())
    evidence = str(score_recording(recording).evidence)
    assert "but largest force on any segment in the whole trial was 25.0 N, at most 15 N needed; time with" in evidence
    contact = find_contact(recording)
    gate = judge(contact)
    parts = gate_parts(contact, gate, score_recording(recording))
    assert [p for p in parts if not p.met] == [p for p in gate.conduct if not p.met]
    assert (gate.action_met, gate.conduct_met, gate.success) == (True, False, False)


@given(force=st.floats(0.3, 30.0), length=st.floats(0.1, 4.0), peak=st.floats(2.0, 20.0))
@settings(max_examples=25, deadline=None)
def test_a_stricter_limit_never_helps_and_the_gate_is_met_exactly_where_its_parts_are(
    force: float, length: float, peak: float
) -> None:
    normal = {"right_forearm": hold(6.0, 1.0, 1.0 + length, force)}
    found: list[tuple[bool, tuple[GatePart, ...]]] = []
    for limit in (peak, 2 * peak):
        limits = Conduct(peak_n=limit, band_n=(1.0, 2.0), band_s=0.2)
        gate = judge(find_contact(make_recording("T1", duration=6.0, normal=normal, protocol=under(limits))))
        assert gate.success is (gate.action_met and all(part.met for part in gate.conduct))
        found.append((gate.success, gate.conduct))
    assert found[0][0] <= found[1][0]


def test_an_action_without_a_row_and_a_protocol_without_tables_have_no_such_gates() -> None:
    scrub = make_recording("T3", duration=6.0, normal={"right_forearm": hold(6.0, 3.0, 5.0, 30.0)}, protocol=under())
    assert conduct(find_contact(scrub)) == ()
    assert conduct(find_contact(touched(protocol=PROTOCOL))) == ()


def test_tables_that_a_protocol_leaves_out_are_in_neither_its_file_nor_its_hash() -> None:
    dumped = load_protocol("bathing-v3").model_dump(mode="json")
    assert "conduct" not in dumped["gates"]
    assert "arm_errors" not in dumped
    assert "gates.conduct" in toml_text({"gates": EXAM.model_dump(mode="json")})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"conduct": {"touch": {"peak_n": 15, "above_n": 6}}}, "above_n and above_s belong together"),
        ({"conduct": {"touch": {"peak_n": 15, "band_s": 1}}}, "band_n and band_s belong together"),
        ({"conduct": {"touch": {"peak_n": 15, "above_n": 15, "above_s": 1}}}, "above_n 15 has to be below peak_n 15"),
        ({"conduct": {"touch": {"peak_n": 5, "band_n": [1, 6], "band_s": 1}}}, r"band_n: .*got \[1.0, 6.0\]"),
        ({"conduct": {"tap": {"peak_n": 15}}}, "conduct.tap: no table of this action; valid: touch, push, scrub"),
        ({"conduct": {"touch": {"peak_n": 15, "tool_share": 1.2}}}, "less than or equal to 1"),
    ],
)
def test_a_table_that_contradicts_itself_is_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        Gates.model_validate(TABLE | change)


def test_every_step_of_a_long_trial_counts_as_seconds_do() -> None:
    """The sum of the times above and below is the trial's."""
    t = seconds(6.0)
    normal = {"right_forearm": np.where(t % 1.0 < 0.25, 7.0, 3.0)}
    recording = make_recording("T1", duration=6.0, normal=normal, protocol=under())
    (part,) = [part for part in conduct(find_contact(recording)) if "more" in part.name]
    assert part.reached == f"{6 * 0.25:.2f} s"
