"""Scripted contacts whose wiping, pressure, shear, knock and joints are computed by hand, at five levels of one thing.

As the probes of C1 to C5 (``validation.probes``), each metric must be what is known of every level, within 5 %, and any
other metric in its place is refused. Here nothing is simulated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from carecontact.lab.validation import probes
from carecontact.lab.validation.probes import Probe, Trial, judge
from carecontact.recording import Recording
from carecontact.scoring import METRICS
from carecontact.scoring.contact import Contact, find_contact
from carecontact.scoring.metrics import cells
from carecontact.scoring.metrics.cells import MMHG_PA, touched_cells
from tests.scoring.synthetic import DT, hold, make_recording, seconds
from tests.scoring.test_cells import ACROSS, AREA_M2, CELL_M, PERIOD_S, Wipe, recording_of

CLOSE = 0.05
"""Share of the known value by which a metric may be off."""
Compute = Callable[[Contact], float | None]
Level = Callable[[float], tuple[Recording, float]]
WIDE_M = 0.045
STROKE_S = 0.8
"""Length of a stroke of ``Wipe``."""


def strip(width_m: float) -> float:
    """Share of the region that a wipe of this width slides over."""
    return Wipe(width_m=width_m).wiped_m2 / AREA_M2


def wiped(width_m: float) -> tuple[Recording, float]:
    """One stroke, and a wide one under which the skin sticks."""
    return recording_of(Wipe(strokes=1, width_m=width_m), Wipe(strokes=1, width_m=WIDE_M, sticks=True)), strip(width_m)


def cleaned(width_m: float) -> tuple[Recording, float]:
    """Three strokes at 12 mmHg over a strip that is wiped once at 20 and three times at 5 beyond it, too."""
    firm, weak, once = (
        Wipe(strokes=strokes, pressure_pa=mmhg * MMHG_PA, width_m=width)
        for strokes, mmhg, width in ((3, 12, width_m), (3, 5, WIDE_M), (1, 20, WIDE_M))
    )
    return recording_of(firm, weak, once), strip(width_m)


def mean_pressed(kilopascals: float) -> tuple[Recording, float]:
    """As long at this pressure as at 20 kPa."""
    both = (Wipe(strokes=1, pressure_pa=1000 * p, width_m=WIDE_M) for p in (kilopascals, 20.0))
    return recording_of(*both), (kilopascals + 20.0) / 2


def peak_pressed(kilopascals: float) -> tuple[Recording, float]:
    """Three strokes at 5 kPa, and one narrow one at this pressure."""
    return recording_of(Wipe(pressure_pa=5000.0), Wipe(strokes=1, pressure_pa=1000 * kilopascals, width_m=0.015)), (
        kilopascals
    )


def utilised(kilopascals: float) -> tuple[Recording, float]:
    """Over the 180 N/cm^2 of ISO/TS 15066 for the forearm."""
    return peak_pressed(kilopascals)[0], kilopascals / 1800


def above(mmhg: float) -> Level:
    """So many strokes 5 mmHg above a level, three at 5 below it, and one that lasts as long as the other strokes at
    a tenth of the level."""

    def made(strokes: float) -> tuple[Recording, float]:
        high, low = (Wipe(strokes=n, pressure_pa=p * MMHG_PA) for n, p in ((round(strokes), mmhg + 5), (3, mmhg - 5)))
        return recording_of(high, low, Wipe(strokes=7 - round(strokes), pressure_pa=0.1 * mmhg * MMHG_PA)), (
            STROKE_S * strokes
        )

    return made


def sheared(friction: float) -> tuple[Recording, float]:
    wipe = Wipe(friction=friction, pressure_pa=3000.0, width_m=WIDE_M)
    return recording_of(wipe), friction * wipe.pressure_pa * wipe.width_m * wipe.length_m * 3 * STROKE_S


def knocked(newton: float) -> tuple[Recording, float]:
    """50 ms with this force, then 8 N for a second, and later another touch with 20 N that begins softly."""
    force = hold(5, 1.0, 1.05, newton) + hold(5, 1.05, 2.0, 8.0)
    slow = np.clip((seconds(5) - 3.0) / 0.5, 0, 1) * 20.0 * (seconds(5) < 4.5)
    return make_recording(duration=5, normal={"right_forearm": force + slow}), 0.05 * newton + 0.05 * 8.0


def landed(millimetres: float) -> tuple[Recording, float]:
    """A spring of 1 N/mm is pressed so deep within 50 ms and let go, then 12 mm deep within half a second."""
    time = seconds(4)
    blow = np.clip(1 - np.abs(time - 1.05) / 0.05, 0, None) * millimetres / 1000
    slow = 0.012 * np.clip(1 - np.abs(time - 2.5) / 0.5, 0, None)
    tip = np.zeros((len(time), 3))
    tip[:, 2] = -(blow + slow)
    made = make_recording(duration=4, normal={"right_forearm": 1000.0 * (blow + slow)}, tcp_in_region=tip)
    centre = made["scorer/pose_tcp_in_world"][:, None, :3] * np.ones((1, len(made.header.segments), 1))
    made.arrays["scorer/centroid_in_world"] = centre.astype(np.float32)
    return made, 0.5 * 1000.0 * (millimetres / 1000) ** 2


def turned(share: float) -> tuple[Recording, float]:
    """A joint that settled 0.8 rad from its end loses this share of it; another rests 0.05 rad from its end."""
    time = seconds(3)
    joints = np.stack([np.full(len(time), 0.05), 2.4 - 0.8 + 0.8 * share * np.clip(time - 1, 0, 1)], 1)
    joints[:, 0] += JOINTS_LOW
    made = make_recording(normal={"right_forearm": hold(3, 1, 2.5, 6.0)}, joints=joints)
    made.arrays["scorer/human_joint_settled"] = joints[0]
    return made, share


JOINTS_LOW = -0.5
"""Lower end of the first joint of the synthetic recordings."""


def stopped(newton_metres: float) -> tuple[Recording, float]:
    """One end stop pushes back with this torque for 0.2 s, downward, and another upward with 0.3 N m for a second."""
    made = make_recording(normal={"right_forearm": hold(3, 1, 2.5, 6.0)})
    reaction = np.stack([-hold(3, 1.4, 1.6, newton_metres), hold(3, 1.2, 2.2, 0.3)], 1)
    made.arrays["scorer/human_joint_reaction"] = reaction.astype(np.float32)
    return made, newton_metres


@dataclass(frozen=True, kw_only=True)
class Family:
    levels: tuple[float, ...]
    level: Level


WIDTHS = (0.015, 0.0225, 0.030, 0.0375, WIDE_M)
FAMILIES = {
    "coverage@1": Family(levels=WIDTHS[:4], level=wiped),
    "effective_wiping@1": Family(levels=WIDTHS[:4], level=cleaned),
    "pressure_mean@2": Family(levels=(2.0, 5.0, 8.0, 12.0, 16.0), level=mean_pressed),
    "pressure_peak@2": Family(levels=(8.0, 12.0, 16.0, 24.0, 32.0), level=peak_pressed),
    "pressure_utilisation@2": Family(levels=(8.0, 12.0, 16.0, 24.0, 32.0), level=utilised),
    "exposure_uncomfortable@2": Family(levels=(1, 2, 3, 4, 5), level=above(25.0)),
    "exposure_fragile@2": Family(levels=(1, 2, 3, 4, 5), level=above(14.0)),
    "shear_dose@2": Family(levels=(0.2, 0.4, 0.6, 0.8, 1.0), level=sheared),
    "knock_impulse@1": Family(levels=(30.0, 50.0, 80.0, 120.0, 180.0), level=knocked),
    "knock_energy@1": Family(levels=(8.0, 10.0, 13.0, 17.0, 22.0), level=landed),
    "C2@2": Family(levels=(0.2, 0.4, 0.6, 0.8, 1.05), level=turned),
    "end_stop_torque@1": Family(levels=(0.5, 1.0, 2.0, 4.0, 8.0), level=stopped),
}


def probe_of(metric: str, known: np.ndarray) -> Probe:
    return Probe(
        metric=metric, title=metric, level="level", region="forearm", levels=FAMILIES[metric].levels, direction=1,
        step=0.5 * float(np.diff(known).min()), known="value by hand", tolerance=CLOSE * float(known.mean()),
        script=lambda simulation, region, level: trials_of(metric)[0],
    )  # fmt: skip


def trials_of(metric: str) -> list[Trial]:
    family = FAMILIES[metric]
    made = [family.level(level) for level in family.levels]
    return [Trial(recording=recording, known=known, held={}) for recording, known in made]


@pytest.fixture(scope="module")
def stored() -> dict[str, tuple[Probe, list[Trial], list[Contact]]]:
    out = {}
    for metric in FAMILIES:
        trials = trials_of(metric)
        probe = probe_of(metric, np.array([trial.known for trial in trials]))
        out[metric] = probe, trials, [find_contact(trial.recording) for trial in trials]
    return out


def right(metric: str) -> Compute:
    return METRICS[metric].compute


def scaled(metric: str, factor: float) -> Compute:
    return lambda contact: factor * (right(metric)(contact) or 0.0)


def array(contact: Contact, name: str) -> np.ndarray:
    return contact.recording[f"scorer/{name}"].astype(np.float64)


def of_cells(reduce: Callable[..., float]) -> Compute:
    def compute(contact: Contact) -> float | None:
        cells = touched_cells(contact)
        return None if cells is None else float(reduce(cells))

    return compute


def area_where(contact: Contact, chosen: np.ndarray) -> float:
    area = array(contact, "cell_area_m2")
    return float(area[chosen].sum() / area.sum())


GENERAL: dict[str, Compute] = {
    "constant": lambda contact: 1.0,
    "never": lambda contact: None,
    "not a number": lambda contact: float("nan"),
    "duration": lambda contact: len(contact.time_s) * contact.dt_s,
    "contact time": lambda contact: float(contact.window.sum() * contact.dt_s),
    "largest force": lambda contact: float(contact.force_norm.max()),
    "mean force": lambda contact: float(contact.force_norm.sum(axis=1).mean()),
    "impulse": lambda contact: float(contact.impulse_ns.sum()),
}
SPECIAL: dict[str, dict[str, Compute]] = {
    "coverage@1": {
        "share that was touched": lambda c: area_where(c, np.asarray((array(c, "cell_touch_m2s") > 0).any(axis=0))),
        "cells that were slid over, partly or not": lambda c: area_where(c, array(c, "cell_slip_m3").sum(axis=0) > 0),
    },
    "effective_wiping@1": {
        "one pass at 10 mmHg": of_cells(lambda t: (t.share_passed(1, 10 * MMHG_PA) * t.area_m2).sum() / AREA_M2),
        "three passes at any pressure": of_cells(lambda t: (t.share_passed(3) * t.area_m2).sum() / AREA_M2),
        "three passes at 15 mmHg": of_cells(lambda t: (t.share_passed(3, 15 * MMHG_PA) * t.area_m2).sum() / AREA_M2),
    },
    "pressure_mean@2": {
        "mean over cells, touched or not": of_cells(lambda t: t.pressure_pa.mean() / 1000),
        "force over the whole region": of_cells(
            lambda t: t.press_ns.sum() / (t.period_s.sum() * t.area_m2.sum()) / 1000
        ),
        "pascals": scaled("pressure_mean@2", 1000.0),
    },
    "pressure_peak@2": {
        "99th percentile": of_cells(lambda t: np.percentile(t.pressure_pa, 99) / 1000),
        "over whole cells": of_cells(lambda t: (t.press_ns.sum(axis=1) / t.area_m2.sum() / t.period_s).max() / 1000),
        "mmHg": scaled("pressure_peak@2", 1000 / MMHG_PA),
    },
    "pressure_utilisation@2": {
        "of the upper arm's limit": scaled("pressure_utilisation@2", 1800 / 1900),
        "of the strictest limit": scaled("pressure_utilisation@2", 1800 / 1200),
        "of the mean pressure": lambda c: (right("pressure_mean@2")(c) or 0.0) / 1800,
        "of what is comfortable": lambda c: (right("pressure_peak@2")(c) or 0.0) * 1000 / (25 * MMHG_PA),
    },
    "exposure_uncomfortable@2": {
        "cells times time": of_cells(lambda t: ((t.pressure_pa > 25 * MMHG_PA) * t.period_s[:, None]).sum()),
        "share of the time": of_cells(lambda t: t.time_above(25 * MMHG_PA) / t.period_s.sum()),
    },
    "exposure_fragile@2": {
        "cells times time": of_cells(lambda t: ((t.pressure_pa > 14 * MMHG_PA) * t.period_s[:, None]).sum()),
        "any touch": of_cells(lambda t: t.time_above(0.0)),
    },
    "shear_dose@2": {
        "impulse of the normal force": of_cells(lambda t: t.press_ns.sum()),
        "work": of_cells(lambda t: (t.shear_ns * 0.1).sum()),
        "largest cell": of_cells(lambda t: t.shear_ns.sum(axis=0).max()),
        "kilonewton seconds": scaled("shear_dose@2", 1e-3),
    },
    "knock_impulse@1": {
        "first 50 ms": lambda c: float(c.force_norm[(c.time_s > 1.0) & (c.time_s <= 1.05)].sum() * DT),
        "whole touch": lambda c: float(c.force_norm[c.time_s < 2.5].sum() * DT),
        "last touch": lambda c: float(c.force_norm[(c.time_s > 3.0) & (c.time_s <= 3.1)].sum() * DT),
        "force": scaled("knock_impulse@1", 10.0),
    },
    "knock_energy@1": {
        "both ways": scaled("knock_energy@1", 2.0),
        "force times depth": lambda c: float(c.force_norm.max() ** 2 / 1000),
        "deepest press": lambda c: 0.5 * 1000 * 0.012**2,
    },
    "C2@2": {
        "least margin": lambda c: right("C2@1")(c),
        "radians": scaled("C2@2", 0.8),
        "of the joint nearest to its end": lambda c: 0.0,
        "never above one": lambda c: min(1.0, right("C2@2")(c) or 0.0),
        "share that is left": lambda c: 1 - (right("C2@2")(c) or 0.0),
        "of the whole range": lambda c: (right("C2@2")(c) or 0.0) * 0.8 / 2.4,
    },
    "end_stop_torque@1": {
        "signed": lambda c: float(array(c, "human_joint_reaction").max()),
        "sum over joints": lambda c: float(np.abs(array(c, "human_joint_reaction")).sum(axis=1).max()),
        "mean over time": lambda c: float(np.abs(array(c, "human_joint_reaction")).mean(axis=0).max()),
        "last sample": lambda c: float(np.abs(array(c, "human_joint_reaction"))[-1].max()),
        "torque times time": lambda c: float(np.abs(array(c, "human_joint_reaction")).sum(axis=0).max() * DT),
    },
}


def wrong_metrics(metric: str) -> dict[str, Compute]:
    swapped = {f"{other} in its place": right(other) for other in FAMILIES if other != metric}
    sizes = {
        "negated": scaled(metric, -1.0),
        "a thousand times": scaled(metric, 1000.0),
        "a thousandth": scaled(metric, 1e-3),
        "a tenth too much": scaled(metric, 1.1),
        "a tenth too little": scaled(metric, 0.9),
    }
    return {**GENERAL, **sizes, **swapped, **SPECIAL[metric]}


Stored = dict[str, tuple[Probe, list[Trial], list[Contact]]]


@pytest.mark.parametrize("metric", FAMILIES)
def test_the_right_metric_is_what_is_computed_by_hand(metric: str, stored: Stored) -> None:
    probe, trials, contacts = stored[metric]
    result = judge(probe, trials, METRICS[metric])
    assert result.passed, result.missed
    found = [right(metric)(contact) for contact in contacts]
    np.testing.assert_allclose(np.array(found, float), [trial.known for trial in trials], rtol=CLOSE)


@pytest.mark.parametrize("metric", FAMILIES)
def test_wrong_metrics_are_refused(metric: str, stored: Stored, monkeypatch: pytest.MonkeyPatch) -> None:
    probe, trials, contacts = stored[metric]
    found = {id(trial.recording): contact for trial, contact in zip(trials, contacts, strict=True)}
    monkeypatch.setattr(probes, "find_contact", lambda recording: found[id(recording)])
    passed = [
        name
        for name, compute in wrong_metrics(metric).items()
        if judge(probe, trials, replace(METRICS[metric], measure=compute)).passed
    ]
    assert not passed, f"these pass for {metric}: {passed}"


# Wipes on both sides of every line of the yes-or-no metrics: each metric says yes on one side alone, and a metric with
# another line, or another metric in its place, is refused.

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
        (scrubbed(strokes=2), 0.0),
        (scrubbed(strokes=2, mmhg=60.0), 0.0),
        (scrubbed(strokes=4), 1.0),
        (scrubbed(mmhg=9.0), 0.0),
        (scrubbed(mmhg=11.0), 1.0),
    ]


def comfortable(limit: float) -> list[Case]:
    """2 of 82 and 3 of 83 periods above the limit are less than 5 %, 5 of 85 and 9 of 89 are more."""
    low, high = limit - 1, limit + 1
    return [
        *((firm(periods, low=low, high=high), float(periods < 4)) for periods in (2, 3, 5, 9)),
        (firm(9, low=low - 1, high=low), 1.0),
        (firm(2, low=high, high=high + 20), 0.0),
    ]


CASES: dict[str, Callable[[], list[Case]]] = {
    "effective@1": effective,
    "comfortable@2": lambda: comfortable(25.0),
    "comfortable_fragile@2": lambda: comfortable(14.0),
}
OTHER_LINES = {
    "effective@1": [
        (cells, "EFFECTIVE_SHARE", 0.7), (cells, "EFFECTIVE_SHARE", 0.75), (cells, "EFFECTIVE_SHARE", 0.85),
        (cells, "EFFECTIVE_SHARE", 0.9), (cells, "EFFECTIVE", ((2, 10 * MMHG_PA),)),
        (cells, "EFFECTIVE", ((4, 10 * MMHG_PA),)), (cells, "EFFECTIVE", ((3, 5 * MMHG_PA),)),
        (cells, "EFFECTIVE", ((3, 20 * MMHG_PA),)), (cells, "EFFECTIVE", cells.CLEANS),
    ],
    "comfortable@2": [
        (cells, "MOST_OF_TIME", 0.99), (cells, "MOST_OF_TIME", 0.9), (cells, "MOST_OF_TIME", 0.97),
        (cells, "MOST_OF_TIME", 0.5), (cells, "COMFORT_MMHG", 20.0), (cells, "COMFORT_MMHG", 35.0),
        (cells, "COMFORT_MMHG", 14.0),
    ],
    "comfortable_fragile@2": [
        (cells, "MOST_OF_TIME", 0.99), (cells, "MOST_OF_TIME", 0.9), (cells, "FRAGILE_MMHG", 10.0),
        (cells, "FRAGILE_MMHG", 25.0),
    ],
}  # fmt: skip
IN_ITS_PLACE = ("coverage@1", "effective_wiping@1", "pressure_mean@2", "exposure_uncomfortable@2", "exposure_fragile@2")


def answers(metric: str, cases: list[Case]) -> list[float | None]:
    return [METRICS[metric].compute(find_contact(recording)) for recording, _ in cases]


@pytest.mark.parametrize("metric", CASES)
def test_yes_on_one_side_of_each_line_and_no_other_rule_says_the_same(
    metric: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    cases = CASES[metric]()
    known = [answer for _, answer in cases]
    assert answers(metric, cases) == known
    for other in (*IN_ITS_PLACE, *(name for name in CASES if name != metric)):
        assert answers(other, cases) != known, other
    for module, name, value in OTHER_LINES[metric]:
        with monkeypatch.context() as patch:
            patch.setattr(module, name, value)
            assert answers(metric, cases) != known, (name, value)
