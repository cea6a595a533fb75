"""Foam whose cleaned share and place are known by hand, and the verdicts on them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carecontact.errors import RecordingError
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording import SEGMENTS, Recording
from carecontact.scoring import METRICS, score_recording
from carecontact.scoring.contact import find_contact
from carecontact.scoring.foam import HURRIED, LIGHT, MISSED, SELDOM, RecordedWiping, Wiping, place_share
from carecontact.scoring.metrics.cells import MMHG_PA, touched_cells
from tests.protocol.foamy import FOAMY
from tests.scoring.synthetic import DT, SIZE, back_and_forth, before_start, hold, make_recording
from tests.scoring.test_cells import ACROSS, ALONG, Wipe, recording_of

FOREARM = SEGMENTS.index("right_forearm")
POSE = np.array([0.02, 0.0, SIZE["forearm"][2], 1.0, 0.0, 0.0, 0.0])
"""On top of the forearm, 20 mm from its middle toward the hand."""


def under_foam(rows: slice = slice(0, ACROSS), columns: slice = slice(0, ALONG)) -> np.ndarray:
    """(C,) cells of ``recording_of`` that are under foam."""
    share = np.zeros((ALONG, ACROSS), np.float32)
    share[columns, rows] = 1.0
    return share.ravel()


def foamy(
    recording: Recording, share: np.ndarray, *, task_id: str = "T3", extra: dict[str, np.ndarray] | None = None
) -> Recording:
    """The same contact with foam on the skin, under a protocol that judges it."""
    spec = TrialSpec(protocol=FOAMY, task_id=task_id, seed=0, policy="synthetic")
    header = recording.header.model_copy(update={"spec": spec, "embodiment": "panda-mitt"})
    foam = {
        "scorer/foam_cell_share": share,
        "scorer/foam_pose_in_region": POSE,
        "scorer/foam_half_m": np.array([0.05, 0.02]),
    }
    return Recording.trusted(header, {**recording.arrays, **foam, **(extra or {})})


def wiping_of(recording: Recording) -> Wiping:
    found = RecordedWiping.of(recording)
    assert found is not None
    return found.until(np.inf)


@pytest.mark.parametrize(
    ("strokes", "mmhg", "left"), [(1, 11, 2 / 3), (2, 11, 1 / 3), (3, 11, 0.0), (5, 11, 0.0), (3, 9, 1.0)]
)
def test_each_pass_with_enough_pressure_takes_a_third_of_the_foam(strokes: int, mmhg: float, left: float) -> None:
    """Of the cells that lie under the tool as a whole; the ones beside its way keep theirs."""
    found = wiping_of(foamy(recording_of(Wipe(strokes=strokes, pressure_pa=mmhg * MMHG_PA)), under_foam()))
    cells = found.left.reshape(ALONG, ACROSS)
    assert cells[8, 3] == pytest.approx(left)
    assert (cells[:, [0, 6, 7]] == 1.0).all()
    assert (found.cleaned > 0) == (left == 0.0)


def test_the_share_is_of_the_foam_and_not_of_the_region() -> None:
    recording = recording_of(Wipe(pressure_pa=11 * MMHG_PA))
    inside, half = under_foam(slice(2, 4), slice(5, 10)), under_foam(slice(2, 8), slice(5, 10))
    assert wiping_of(foamy(recording, inside)).cleaned == pytest.approx(1.0)
    # Of six rows, three lie under the tool, and the tool covers 0.6 of a fourth.
    assert wiping_of(foamy(recording, half)).cleaned == pytest.approx(3.6 / 6, abs=0.01)
    assert (
        METRICS["foam_cleaned@1"].compute(find_contact(foamy(recording, half)))
        == wiping_of(foamy(recording, half)).cleaned
    )
    assert METRICS["foam_cleaned@1"].compute(find_contact(recording)) is None


@settings(max_examples=20, deadline=None)
@given(
    wipes=st.lists(
        st.builds(
            Wipe,
            strokes=st.integers(1, 3),
            # With exactly 10 mmHg all along, rounding decides whether a visit as it stands is firm enough.
            pressure_pa=st.floats(5, 20).filter(lambda mmhg: abs(mmhg - 10) > 1e-6).map(lambda mmhg: mmhg * MMHG_PA),
            width_m=st.sampled_from([0.01, 0.02, 0.03]),
            way_m=st.sampled_from([0.02, 0.05, 0.08]),
            lifted_s=st.sampled_from([0.04, 0.08, 0.14, 0.3]),
            sticks=st.booleans(),
        ),
        min_size=1,
        max_size=3,
    ),
    look_s=st.lists(st.floats(0, 3), max_size=4),
)
def test_it_counts_as_effective_wiping_does_whenever_anyone_looks(wipes: list[Wipe], look_s: list[float]) -> None:
    """The rule of the cells' metric counts whole visits afterwards; this one counts them as they come."""
    recording, share = recording_of(*wipes), under_foam()
    known = touched_cells(find_contact(recording))
    assert known is not None
    expected = [known.share_passed(times, 10 * MMHG_PA) for times in (1, 2, 3)]
    found, before = RecordedWiping.of(foamy(recording, share)), np.ones(len(share))
    assert found is not None
    for time_s in sorted(look_s):
        left = found.until(time_s).left
        assert (left <= before + 1e-12).all(), "foam never comes back"
        before = left
    assert found.until(np.inf).left == pytest.approx(1 - np.mean(expected, axis=0), abs=1e-6)
    assert found.until(np.inf).cleaned == pytest.approx(expected[2].mean(), abs=1e-6)


def test_only_the_tool_wipes() -> None:
    """At 15 mmHg, a third by the hand leaves 10 for the tool, and a half leaves too little."""
    recording = recording_of(Wipe(pressure_pa=15.2 * MMHG_PA))
    cleaned = []
    for share in (0.0, 0.3, 0.5, 1.0):
        beside: np.ndarray = np.zeros((len(recording["scorer/time_s"]), 2, len(SEGMENTS)), np.float32)
        beside[:, 0, FOREARM] = share * recording["scorer/normal_force"][:, FOREARM]
        cleaned.append(wiping_of(foamy(recording, under_foam(), extra={"scorer/beside_normal_force": beside})).cleaned)
    assert cleaned[0] == cleaned[1] == wiping_of(foamy(recording, under_foam())).cleaned > 0.2
    assert cleaned[2:] == [0.0, 0.0]


def touched_at(along_m: float, across_m: float = 0.0, *, deep_m: float = 0.0) -> Recording:
    """A gentle touch of 2 s that far from the foam's middle along the skin."""
    path = np.tile(POSE[:3] + [along_m, across_m, -deep_m], (1500, 1))
    force = {"right_forearm": hold(3.0, 0.5, 2.5, 3.0)}
    cells: dict[str, np.ndarray] = {
        f"scorer/cell_{name}": np.zeros((150, 4), np.float32) for name in ("press_ns", "slip_m3", "touch_m2s")
    }
    cells["scorer/cell_area_m2"] = np.full(4, 5e-5, np.float32)
    recording = make_recording("T1", normal=force, tcp_in_region=path, extra=cells)
    return foamy(recording, np.ones(4, np.float32), task_id="T1")


@pytest.mark.parametrize(
    ("along_m", "across_m", "deep_m", "there"),
    [(0.0, 0.0, 0.0, True), (0.029, 0.0, 0.012, True), (-0.021, 0.021, 0.0, True), (0.031, 0.0, 0.0, False),
     (0.025, 0.025, 0.0, False)],
)  # fmt: skip
def test_a_touch_has_to_be_at_the_foam(along_m: float, across_m: float, deep_m: float, there: bool) -> None:
    recording = touched_at(along_m, across_m, deep_m=deep_m)
    assert METRICS["foam_place@1"].compute(find_contact(recording)) == pytest.approx(float(there), abs=0.02)
    score = score_recording(recording)
    assert score.c3_success
    assert (score.region_correct, score.failure_mode) == ((True, None) if there else (False, "wrong_share"))


def test_four_fifths_of_the_impulse_have_to_be_there() -> None:
    """Of 2 s, the tool is at the foam for as much as is asked for or a little less."""
    for seconds, enough in ((1.62, True), (1.58, False)):
        recording = touched_at(0.0)
        tool = recording["scorer/pose_tcp_in_world"].copy()
        tool[round((0.5 + seconds) / DT) :, 0] += 0.05
        moved = Recording.trusted(recording.header, {**recording.arrays, "scorer/pose_tcp_in_world": tool})
        share = place_share(find_contact(moved), 0.03)
        assert share == pytest.approx(seconds / 2, abs=0.02)
        assert score_recording(moved).region_correct is enough


def test_the_mitts_middle_counts_and_not_its_outermost_point() -> None:
    """A tool that is tilted by 60 degrees about its middle above the foam is still there; its tip is 12 mm away."""
    recording = touched_at(0.028)
    tool = recording["scorer/pose_tcp_in_world"].copy()
    half = np.radians(60) / 2
    tool[:, :3] += 0.014 * (np.array([np.sin(2 * half), 0.0, np.cos(2 * half)]) - [0.0, 0.0, 1.0])
    tool[:, 3:] = [np.cos(half), 0.0, np.sin(half), 0.0]
    turned = Recording.trusted(recording.header, {**recording.arrays, "scorer/pose_tcp_in_world": tool})
    assert place_share(find_contact(turned), 0.03) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(("rows", "passes"), [(slice(2, 4), True), (slice(0, 8), False)])
def test_a_scrub_passes_where_enough_of_the_foam_is_clean(rows: slice, passes: bool) -> None:
    """Whatever length it passed, and wherever its middle was."""
    strokes = recording_of(Wipe(strokes=4, pressure_pa=11 * MMHG_PA))
    duration = len(strokes["scorer/time_s"]) * DT
    path = back_and_forth(duration, "forearm", amplitude=0.02, period=2.0)
    normal = {"right_forearm": np.full(round(duration / DT), 3.0)}
    cells = {path: values for path, values in strokes.arrays.items() if "/cell_" in path}
    inside = [(0.1, (0.0, 0.0, 0.03))]
    recording = make_recording(
        "T3", duration=duration, normal=normal, tcp_in_region=path, targets_in_region=inside, extra=cells
    )
    score = score_recording(foamy(recording, under_foam(rows, slice(5, 10))))
    assert score.additional["axis_passed@2"] == pytest.approx(0.04, abs=0.003), "less than the 60 mm without foam"
    assert (score.c3_success, score.failure_mode) == ((True, None) if passes else (False, "insufficient_progress"))
    if not passes:
        assert "of the foam was passed 3 times by the tool with at least 10 mmHg, 60% needed; " in str(score.evidence)
        assert f"% {MISSED}" in str(score.evidence)
        assert "asked for" not in str(score.evidence), "a length is not what foam asks for"
        assert score.attribution == "planning"


def test_without_foam_nothing_of_this_is_asked() -> None:
    """L0 and the push have none, under the same gates."""
    plain = touched_at(0.1)
    arrays = {path: values for path, values in plain.arrays.items() if "foam" not in path}
    bare = FOAMY.model_copy(update={"foam": None})
    spec = plain.header.spec.model_copy(update={"protocol": bare})
    score = score_recording(Recording.trusted(plain.header.model_copy(update={"spec": spec}), arrays))
    assert score.safety_gated
    assert score.additional["foam_place@1"] is None


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("scorer/foam_cell_share", np.full(4, -0.1, np.float32), "holds .*; valid: 0 to 1.001 of a cell"),
        ("scorer/foam_cell_share", np.full(4, 1.5, np.float32), "holds .*; valid: 0 to 1.001 of a cell"),
        ("scorer/foam_pose_in_region", np.zeros(7), "not a rotation"),
    ],
)
def test_impossible_foam_is_no_score(path: str, value: np.ndarray, message: str) -> None:
    recording = touched_at(0.0)
    with pytest.raises(RecordingError, match=f"{path}.*{message}"):
        score_recording(Recording.trusted(recording.header, {**recording.arrays, path: value}))


@pytest.mark.parametrize(
    ("wipe", "why"),
    [
        (Wipe(pressure_pa=9 * MMHG_PA), LIGHT),
        (Wipe(strokes=2, pressure_pa=11 * MMHG_PA), SELDOM),
        (Wipe(strokes=4, pressure_pa=11 * MMHG_PA, way_m=0.05, speed_m_s=0.5, lifted_s=0.02), HURRIED),
        (Wipe(pressure_pa=11 * MMHG_PA, sticks=True), SELDOM),
    ],
)
def test_foam_that_is_left_has_a_reason(wipe: Wipe, why: str) -> None:
    """For the cells that lie wholly on the tool's way; all reasons add up to what is not clean."""
    recording = recording_of(wipe)
    columns = slice(5, 8) if wipe.way_m == 0.05 else slice(5, 10)
    found = wiping_of(foamy(recording, under_foam(slice(2, 4), columns)))
    assert found.lacking[why] == pytest.approx(1.0)
    whole = wiping_of(foamy(recording, under_foam()))
    assert sum(whole.lacking.values()) == pytest.approx(1 - whole.cleaned)
    assert whole.lacking[MISSED] > 0.2, "beside the tool's way"


def test_a_trial_that_ended_before_it_began_cleaned_nothing() -> None:
    recording = foamy(before_start(), under_foam())
    cells = {"scorer/cell_area_m2": np.full(ALONG * ACROSS, 5e-5, np.float32)}
    score = score_recording(Recording.trusted(recording.header, {**recording.arrays, **cells}))
    assert (score.failure_mode, score.additional["foam_cleaned@1"]) == ("process_failure", 0.0)
