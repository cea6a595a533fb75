"""Wipes whose coverage and pressure are known: a rectangle glides over a grid of cells at a given pressure."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carecontact.errors import RecordingError
from carecontact.recording import Recording
from carecontact.scoring import METRICS, score_recording
from carecontact.scoring.contact import find_contact
from carecontact.scoring.metrics.cells import MMHG_PA, touched_cells
from tests.scoring.synthetic import hold, make_recording, push, touch

CELL_M, PERIOD_S = 0.0075, 0.02
ACROSS, ALONG = 8, 24
AREA_M2 = ACROSS * ALONG * CELL_M**2


@dataclass(frozen=True, kw_only=True)
class Wipe:
    """Strokes in one direction, lifted between, at one height across the region."""

    strokes: int = 3
    pressure_pa: float = 2000.0
    width_m: float = 0.030
    """Across the motion."""
    length_m: float = 0.020
    way_m: float = 0.080
    friction: float = 0.5
    sticks: bool = False
    """Whether the skin goes along with the tool instead of sliding under it."""
    speed_m_s: float = 0.1
    lifted_s: float = 0.3

    @property
    def wiped_m2(self) -> float:
        return self.width_m * (self.way_m + self.length_m)


def recording_of(*wipes: Wipe) -> Recording:
    edge = [np.arange(n + 1) * CELL_M for n in (ALONG, ACROSS)]
    touched = []
    for wipe in wipes:
        steps = round(wipe.way_m / wipe.speed_m_s / PERIOD_S)
        low = [0.021, 0.012]
        for _ in range(wipe.strokes):
            for k in range(steps):
                start = low[0] + (k + 0.5) / steps * wipe.way_m
                along = overlap(edge[0], start, start + wipe.length_m)
                across = overlap(edge[1], low[1], low[1] + wipe.width_m)
                touched.append((np.outer(along, across).ravel(), wipe))
            touched += [(np.zeros(ALONG * ACROSS), wipe)] * round(wipe.lifted_s / PERIOD_S)
    area = np.array([a for a, _ in touched])
    pressure, friction, slid = (
        np.array([[f(wipe)] for _, wipe in touched])
        for f in (lambda w: w.pressure_pa, lambda w: w.friction, lambda w: 0.0 if w.sticks else w.speed_m_s * PERIOD_S)
    )
    duration = len(touched) * PERIOD_S
    cells = ACROSS * ALONG
    return make_recording(
        duration=duration,
        normal={"right_forearm": np.repeat((area * pressure).sum(1), round(PERIOD_S / 0.002))},
        extra={
            "scorer/cell_in_region": np.zeros((cells, 3), np.float32),
            "scorer/cell_area_m2": np.full(cells, CELL_M**2, np.float32),
            "scorer/cell_press_ns": (area * pressure * PERIOD_S).astype(np.float32),
            "scorer/cell_shear_ns": (area * pressure * friction * PERIOD_S).astype(np.float32),
            "scorer/cell_slip_m3": (area * slid).astype(np.float32),
            "scorer/cell_touch_m2s": (area * PERIOD_S).astype(np.float32),
        },
    )


def overlap(edges: np.ndarray, low: float, high: float) -> np.ndarray:
    """(n,) how much of each stretch between neighbouring edges lies between two places."""
    return np.maximum(0.0, np.minimum(edges[1:], high) - np.maximum(edges[:-1], low))


def value(metric: str, recording: Recording) -> float | None:
    return METRICS[metric].compute(find_contact(recording))


@pytest.mark.parametrize("strokes", [1, 3])
def test_coverage_is_the_strip_over_which_the_tool_slid(strokes: int) -> None:
    wipe = Wipe(strokes=strokes)
    assert value("coverage@1", recording_of(wipe)) == pytest.approx(wipe.wiped_m2 / AREA_M2, rel=0.05)


@pytest.mark.parametrize(
    ("strokes", "mmhg", "clean"),
    [(3, 11, True), (3, 9, False), (2, 11, False), (2, 41, True), (1, 49, False), (1, 51, True)],
)
def test_skin_is_clean_after_enough_passes_for_the_pressure(strokes: int, mmhg: float, clean: bool) -> None:
    wipe = Wipe(strokes=strokes, pressure_pa=mmhg * MMHG_PA)
    expected = wipe.wiped_m2 / AREA_M2 if clean else 0.0
    assert value("effective_wiping@1", recording_of(wipe)) == pytest.approx(expected, rel=0.05)


def test_passes_of_different_pressure_are_counted_by_what_each_reaches() -> None:
    """Two passes at 12 mmHg and one at 5 are not three at 10; two at 12 and one at 41 are."""
    soft, weak, hard = (Wipe(strokes=n, pressure_pa=p * MMHG_PA) for n, p in ((2, 12), (1, 5), (1, 41)))
    assert value("effective_wiping@1", recording_of(soft, weak)) == 0.0
    assert value("effective_wiping@1", recording_of(soft, hard)) == pytest.approx(soft.wiped_m2 / AREA_M2, rel=0.05)


def test_skin_that_sticks_to_the_tool_is_not_wiped() -> None:
    recording = recording_of(Wipe(sticks=True))
    assert value("coverage@1", recording) == value("effective_wiping@1", recording) == 0.0
    assert value("pressure_mean@2", recording) == pytest.approx(2.0)


def test_a_short_interruption_does_not_make_two_passes() -> None:
    once, twice = (Wipe(strokes=3, way_m=0.004, speed_m_s=0.05, lifted_s=gap) for gap in (0.08, 0.14))
    assert value("effective_wiping@1", recording_of(once)) == 0.0
    assert value("effective_wiping@1", recording_of(twice)) == pytest.approx(twice.wiped_m2 / AREA_M2, rel=0.1)


@settings(max_examples=15, deadline=None)
@given(kilopascals=st.floats(0.5, 20), width=st.sampled_from([0.015, 0.02, 0.04]))
def test_pressure_is_that_of_the_tool_however_the_cells_lie(kilopascals: float, width: float) -> None:
    recording = recording_of(Wipe(strokes=1, pressure_pa=1000 * kilopascals, width_m=width))
    assert value("pressure_mean@2", recording) == pytest.approx(kilopascals, rel=1e-5)
    assert value("pressure_peak@2", recording) == pytest.approx(kilopascals, rel=1e-5)
    assert value("pressure_utilisation@2", recording) == pytest.approx(kilopascals / 1800, rel=1e-5)


def test_time_above_a_pressure_and_dose_of_shear() -> None:
    soft, firm = Wipe(strokes=1, pressure_pa=20 * MMHG_PA), Wipe(strokes=1, pressure_pa=30 * MMHG_PA)
    recording = recording_of(soft, firm)
    assert value("exposure_uncomfortable@2", recording) == pytest.approx(0.8)
    assert value("exposure_fragile@2", recording) == pytest.approx(1.6)
    area = soft.width_m * soft.length_m
    assert value("shear_dose@2", recording) == pytest.approx(0.5 * area * 50 * MMHG_PA * 0.8, rel=1e-4)


def everywhere(strokes: int = 3, mmhg: float = 12.0, width_m: float = ACROSS * CELL_M) -> Wipe:
    """Over all of the cells, as far as the fixed corner of a wipe lets it."""
    return Wipe(strokes=strokes, pressure_pa=mmhg * MMHG_PA, width_m=width_m, way_m=0.14, length_m=0.019)


def test_a_wipe_that_leaves_a_quarter_out_is_not_effective() -> None:
    """The corner where these wipes begin leaves out two rows of eight."""
    assert value("effective@1", recording_of(everywhere())) == 0.0


@pytest.mark.parametrize(("strokes", "mmhg", "clean"), [(3, 11, 1.0), (2, 60, 0.0), (3, 9, 0.0)])
def test_a_region_is_effectively_wiped_by_three_passes_at_ten_mmhg(strokes: int, mmhg: float, clean: float) -> None:
    recording = recording_of(everywhere(strokes=strokes, mmhg=mmhg))
    untouched = ~recording["scorer/cell_touch_m2s"].any(axis=0)
    recording.arrays["scorer/cell_area_m2"] = np.where(untouched, 1e-9, recording["scorer/cell_area_m2"])
    assert value("effective@1", recording) == clean


@pytest.mark.parametrize(("firm_s", "comfortable"), [(0.0, 1.0), (0.1, 0.0)])
def test_wiping_is_comfortable_while_nearly_all_of_it_is_soft(firm_s: float, comfortable: float) -> None:
    """1.6 s at 13 mmHg, then so long at 30 mmHg: 6 % of the time is too much."""
    wipes = [Wipe(strokes=2, pressure_pa=13 * MMHG_PA)]
    if firm_s:
        wipes.append(Wipe(strokes=1, pressure_pa=30 * MMHG_PA, way_m=0.1 * firm_s))
    recording = recording_of(*wipes)
    assert value("comfortable@2", recording) == comfortable
    assert value("comfortable_fragile@2", recording) == comfortable


def test_a_hard_edge_of_the_tool_is_no_hard_wipe() -> None:
    """One cell in the middle bears three times the pressure; over the tool it is the mean that counts."""
    recording = recording_of(Wipe(strokes=1, pressure_pa=20 * MMHG_PA))
    press = recording["scorer/cell_press_ns"].copy()
    press[:, 60] *= 3
    recording.arrays["scorer/cell_press_ns"] = press
    assert value("exposure_uncomfortable@2", recording) > 0
    assert value("comfortable@2", recording) == 1.0
    assert value("comfortable_fragile@2", recording) == 0.0


def test_nothing_touched_is_nothing_wiped_and_no_pressure() -> None:
    empty = recording_of(Wipe(pressure_pa=0.0, width_m=0.0))
    assert touched_cells(find_contact(empty)) is None
    assert value("coverage@1", empty) == 0.0
    assert value("pressure_mean@2", empty) is None
    assert value("shear_dose@2", empty) is None
    assert value("coverage@1", touch()) is None, "a recording without cells says nothing"


def test_a_knock_is_the_beginning_of_a_touch() -> None:
    """20 N for 1 s: 2 N s in the first tenth of a second."""
    assert value("knock_impulse@1", make_recording(normal={"right_forearm": hold(3, 1, 2, 20.0)})) == pytest.approx(2.0)
    assert value("knock_impulse@1", make_recording()) is None


def test_the_energy_of_a_knock_is_the_work_of_the_tool_on_the_way_in() -> None:
    """A spring of 1 N/mm is pressed by 10 mm within 50 ms and let go: 0.05 J."""
    recording = make_recording()
    time = recording["scorer/time_s"]
    depth = 0.010 * np.clip(1 - np.abs(time - 1.05) / 0.05, 0, None)
    normal = {"right_forearm": 1000.0 * depth}
    tip = np.zeros((len(time), 3))
    tip[:, 2] = -depth
    made = make_recording(normal=normal, tcp_in_region=tip)
    centre = made["scorer/pose_tcp_in_world"][:, None, :3] * np.ones((1, len(made.header.segments), 1))
    made.arrays["scorer/centroid_in_world"] = centre.astype(np.float32)
    assert METRICS["knock_energy@1"].compute(find_contact(made)) == pytest.approx(0.05, rel=0.02)


@pytest.mark.parametrize(
    ("path", "factor", "message"),
    [
        ("scorer/cell_press_ns", -1.0, r"cell_press_ns holds -.* valid: 0 to inf N s"),
        ("scorer/cell_touch_m2s", 1.1, r"cell_touch_m2s holds .*at most the cell's area times the period, 1.125e-06"),
    ],
)
def test_cells_that_cannot_be_are_refused(path: str, factor: float, message: str) -> None:
    recording = recording_of(Wipe(strokes=1))
    score_recording(recording)
    recording.arrays[path] = recording[path] * np.float32(factor)
    with pytest.raises(RecordingError, match=message):
        score_recording(recording)


# Contacts of which the cells feel a known share: numbers about pressure exist where it is most of the force.

OF_CELLS = (
    "pressure_mean",
    "pressure_peak",
    "exposure_uncomfortable",
    "exposure_fragile",
    "comfortable",
    "comfortable_fragile",
    "pressure_utilisation",
    "shear_dose",
)


def felt(share: float, segment: str = "right_forearm") -> Recording:
    """A light wipe, and beside the cells so much force on a segment that the cells feel this share of it all."""
    made = recording_of(Wipe(pressure_pa=1000.0))
    normal = made["scorer/normal_force"].copy()
    column, forearm = (made.header.segments.index(name) for name in (segment, "right_forearm"))
    normal[:, column] += normal[:, forearm] * (1 / share - 1)
    return replace(made, arrays=made.arrays | {"scorer/normal_force": normal})


def values(recording: Recording) -> dict[str, float | None]:
    contact = find_contact(recording)
    return {name: METRICS[f"{name}@2"].compute(contact) for name in OF_CELLS}


@pytest.mark.parametrize("segment", ["right_forearm", "abdomen"])
@pytest.mark.parametrize("share", [0.02, 0.4, 0.6, 1.0])
def test_the_share_is_that_of_the_force_on_all_segments(share: float, segment: str) -> None:
    found = METRICS["cell_share@1"].compute(find_contact(felt(share, segment)))
    assert found == pytest.approx(share, rel=1e-3)


def test_a_press_beside_the_cells_is_no_comfortable_wipe() -> None:
    """It is a light brush of the cells beside a hard press."""
    assert values(felt(1.0))["comfortable"] == 1.0
    assert values(felt(0.02)) == dict.fromkeys(OF_CELLS)


def test_where_the_cells_felt_most_of_the_force_the_rest_does_not_count() -> None:
    assert values(felt(0.6)) == values(felt(1.0))
    assert None not in values(felt(0.6)).values()


def test_without_cells_or_force_there_is_no_share() -> None:
    compute = METRICS["cell_share@1"].compute
    assert compute(find_contact(push())) is None
    untouched = recording_of(Wipe())
    still = {name: np.zeros_like(untouched[name]) for name in ("scorer/normal_force", "scorer/cell_press_ns")}
    assert compute(find_contact(replace(untouched, arrays=untouched.arrays | still))) is None
    assert compute(find_contact(make_recording())) is None
    pressed = replace(untouched, arrays=untouched.arrays | {"scorer/cell_press_ns": still["scorer/cell_press_ns"]})
    assert compute(find_contact(pressed)) == 0.0
