"""Wipes on both sides of every line of the yes-or-no metrics: each metric says yes on one side alone, and a metric with
another line, or another metric in its place, is refused."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from carecontact.recording import Recording
from carecontact.scoring import METRICS
from carecontact.scoring.contact import find_contact
from carecontact.scoring.metrics import pressure, wiping
from carecontact.scoring.touched_cells import MMHG_PA
from tests.scoring.metrics.test_cells import ACROSS, CELL_M, PERIOD_S, Wipe, recording_of

Case = tuple[Recording, float]


def scrubbed(*, share: float = 0.86, strokes: int = 3, mmhg: float = 12.0) -> Recording:
    """Strokes over 6.4 rows and 21.2 columns of cells: cells that they leave out are made as large as it takes that
    this share of all area is wiped."""
    recording = recording_of(
        Wipe(strokes=strokes, pressure_pa=mmhg * MMHG_PA, width_m=ACROSS * CELL_M, way_m=0.14, length_m=0.019)
    )
    left_out = ~recording["scorer/cell_touch_m2s"].any(axis=0)
    wiped = (ACROSS * CELL_M - 0.012) * 0.159
    rest = wiped / share - float((~left_out).sum()) * CELL_M**2
    area = np.where(left_out, rest / left_out.sum(), CELL_M**2)
    recording.arrays["scorer/cell_area_m2"] = area.astype(np.float32)
    return recording


def firm(periods: int, *, low: float, high: float) -> Recording:
    """80 control periods of wiping with one pressure [mmHg], and some with a higher one."""
    hard = Wipe(strokes=1, pressure_pa=high * MMHG_PA, way_m=0.1 * PERIOD_S * periods)
    return recording_of(Wipe(strokes=2, pressure_pa=low * MMHG_PA), hard)


def effective() -> list[Case]:
    return [
        *((scrubbed(share=share), float(share > 0.8)) for share in (0.72, 0.78, 0.82, 0.86)),
        (scrubbed(strokes=2), 0.0), (scrubbed(strokes=2, mmhg=60.0), 0.0), (scrubbed(strokes=4), 1.0),
        (scrubbed(mmhg=9.0), 0.0), (scrubbed(mmhg=11.0), 1.0),
    ]  # fmt: skip


def comfortable(limit: float) -> list[Case]:
    """2 of 82 and 3 of 83 periods above the limit are less than 5 %, 5 of 85 and 9 of 89 are more."""
    low, high = limit - 1, limit + 1
    return [
        *((firm(periods, low=low, high=high), float(periods < 4)) for periods in (2, 3, 5, 9)),
        (firm(9, low=low - 1, high=low), 1.0), (firm(2, low=high, high=high + 20), 0.0),
    ]  # fmt: skip


CASES: dict[str, Callable[[], list[Case]]] = {
    "effective@1": effective,
    "comfortable@2": lambda: comfortable(25.0),
    "comfortable_fragile@2": lambda: comfortable(14.0),
}
OTHER_LINES = {
    "effective@1": [
        (wiping, "EFFECTIVE_SHARE", 0.7), (wiping, "EFFECTIVE_SHARE", 0.75), (wiping, "EFFECTIVE_SHARE", 0.85),
        (wiping, "EFFECTIVE_SHARE", 0.9), (wiping, "EFFECTIVE", ((2, 10 * MMHG_PA),)),
        (wiping, "EFFECTIVE", ((4, 10 * MMHG_PA),)), (wiping, "EFFECTIVE", ((3, 5 * MMHG_PA),)),
        (wiping, "EFFECTIVE", ((3, 20 * MMHG_PA),)), (wiping, "EFFECTIVE", wiping.CLEANS),
    ],
    "comfortable@2": [
        (pressure, "MOST_OF_TIME", 0.99), (pressure, "MOST_OF_TIME", 0.9), (pressure, "MOST_OF_TIME", 0.97),
        (pressure, "MOST_OF_TIME", 0.5), (pressure, "COMFORT_MMHG", 20.0), (pressure, "COMFORT_MMHG", 35.0),
        (pressure, "COMFORT_MMHG", 14.0),
    ],
    "comfortable_fragile@2": [
        (pressure, "MOST_OF_TIME", 0.99), (pressure, "MOST_OF_TIME", 0.9), (pressure, "FRAGILE_MMHG", 10.0),
        (pressure, "FRAGILE_MMHG", 25.0),
    ],
}  # fmt: skip
IN_ITS_PLACE = ("coverage@1", "effective_wiping@1", "pressure_mean@2", "exposure_uncomfortable@2", "exposure_fragile@2")


def said(metric: str, cases: list[Case]) -> list[float | None]:
    return [METRICS[metric].compute(find_contact(recording)) for recording, _ in cases]


@pytest.mark.parametrize("metric", CASES)
def test_yes_on_one_side_of_each_line_and_no_other_rule_says_the_same(
    metric: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    cases = CASES[metric]()
    known = [answer for _, answer in cases]
    assert said(metric, cases) == known
    for other in (*IN_ITS_PLACE, *(name for name in CASES if name != metric)):
        assert said(other, cases) != known, other
    for module, name, value in OTHER_LINES[metric]:
        with monkeypatch.context() as patch:
            patch.setattr(module, name, value)
            assert said(metric, cases) != known, (name, value)
