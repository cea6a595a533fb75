"""420 short synthetic trials whose outcomes are those that the paper counts. Nothing here was simulated or measured.

What the paper gives as counts is laid down trial by trial. What it gives as a median is constructed: half of the valid
trials below, half above and the printed value in the middle. The paper's counts agree with one another:

    state machine  57+3 = 60, 37+3 = 40, 39+1 = 40; C3 54+25+23 = 102; 140-102 = 38 failures; 102-79 = 23 of 36
                   exceedances are successes; 49 <= 79 <= 100 <= 101 < 102, so one success is above F_pain
    VoxPoser       57+2+1, 34+3+3, 30+9+1; C3 20+11+8 = 39; 140-39 = 101, of which 5 process failures, 14 without
                   contact and 82 with contact on the target, 68 of them short of progress; of what the other 14 failed
                   is not stated, here they lost contact
    pi0.5          19+40+1, 6+32+2, 5+34+1; 30 off-target + 106 without contact + 4 process failures = 140; its one C3
                   was earned off the region

How the regions' counts fall on their tasks is not stated either; VoxPoser's successes are all on Touch, as it states
they mostly are.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording import Recording, empty_arrays
from tests.scoring.synthetic import (
    DT,
    F64,
    JOINT_RANGE,
    JOINTS,
    back_and_forth,
    make_recording,
    target_segment,
)

Kind = Literal["success", "no progress", "lost", "off", "off success", "none", "process"]
PROTOCOL = load_protocol("bathing-v3")
SECONDS = {"touch": 1.0, "push": 1.2, "scrub": 1.2}
LONG_S = 2.0
"""1000 samples, so that 0.883 and 0.999 of them are a whole number."""


@dataclass(frozen=True, kw_only=True)
class Medians:
    c1_n: float
    c2_rad: float
    c4: float
    c5_n: float


@dataclass
class Halves:
    """Hands out places around a median: ``exact`` ones first, then as many below as above."""

    exact: int
    surplus: int = 0
    """Above so far less below so far."""

    def next(self, *, above: bool = False) -> int:
        """-1 below, 0 at the median, 1 above; ``above`` asks for the last, to be made up for later."""
        if self.exact and not above:
            self.exact -= 1
            return 0
        place = 1 if above or self.surplus <= 0 else -1
        self.surplus += place
        return place


def ripple(length: int, peak: float, amplitude: float) -> F64:
    """(T,) force whose largest value is ``peak`` and whose SD over an even number of steps is ``amplitude`` [N]."""
    return peak - amplitude + amplitude * np.where(np.arange(length) % 2, 1.0, -1.0)


def make_trial(
    policy: str,
    task_id: str,
    seed: int,
    kind: Kind,
    *,
    peak_n: float,
    sd_n: float,
    c4: tuple[int, float],
    margin_rad: float,
    long: bool = False,
) -> Recording:
    """``c4``: where around the median (-1, 0, 1), and the median."""
    action = PROTOCOL.task(task_id).action
    duration = LONG_S if long else SECONDS[action]
    steps = round(duration / DT)
    force = ripple(steps, peak_n, sd_n)
    normal: dict[str, F64] = {}
    if kind in ("success", "no progress", "lost"):
        if action == "touch" and kind != "success":
            force = force * (np.arange(steps) * DT < (0.35 if kind == "lost" else 0.15))
        normal = {target_segment(task_id): force}
    elif kind in ("off", "off success"):
        normal = {"right_hand" if kind == "off success" else "left_thigh": force}
    share = c4[1] if c4[0] == 0 else c4[1] * (0.9 if c4[0] < 0 else 1.0) + (1 - c4[1]) * (0.9 if c4[0] > 0 else 0.0)
    joints = np.ones((steps, len(JOINTS)))
    joints[steps // 2, 0] = JOINT_RANGE[0][0] + margin_rad
    region = PROTOCOL.task(task_id).region
    moves = action == "scrub" and kind == "success"
    recording = make_recording(
        task_id,
        duration=duration,
        normal=normal,
        tcp_in_region=back_and_forth(duration, region, amplitude=0.06, period=0.8) if moves else None,
        wrist_shift=np.full(steps, 0.03 if kind == "success" else 0.0),
        joints=joints,
        speed=np.where(np.arange(steps) < round(share * steps), 0.1, 0.0),
        seed=seed,
        policy=policy,
        ended="process_failure" if kind == "process" else "done",
    )
    return never_started(recording) if kind == "process" else recording


def never_started(recording: Recording) -> Recording:
    return Recording(header=recording.header, arrays=empty_arrays(len(JOINTS)))


def trial_specs(cells: dict[str, list[tuple[Kind, int]]]) -> Iterator[tuple[str, int, Kind]]:
    for task_id, rows in cells.items():
        kinds = [kind for kind, count in rows for _ in range(count)]
        assert len(kinds) == 20, task_id
        yield from ((task_id, seed, kind) for seed, kind in enumerate(kinds))


def state_machine() -> Iterator[Recording]:
    cells: dict[str, list[tuple[Kind, int]]] = {
        "T1": [("success", 20)],
        "T2": [("success", 20)],
        "T3": [("success", 14), ("no progress", 3), ("process", 3)],
        "T4": [("success", 20)],
        "T5": [("success", 5), ("no progress", 12), ("process", 3)],
        "T6": [("success", 20)],
        "T7": [("success", 3), ("no progress", 16), ("process", 1)],
    }
    # Of F_pain, 100 N on the arm and 60 N on the abdomen: 49 up to 0.20, 30 up to 0.35, 21 up to 0.70, and one below
    # and one above 1. Above the median of 19.48 N lie the 53 over 0.20 and 13 failures, below it 49 and 17.
    bands = {
        "low": (12.0, 8.0),
        "mid": (25.0, 20.5),
        "hard": (50.0, 30.0),
        "harder": (85.0, 54.0),
        "pain": (120.0, 72.0),
    }
    of_success = iter(["pain", "harder"] + ["hard"] * 21 + ["mid"] * 30 + ["low"] * 49)
    of_failure = iter(["median"] + ["hard"] * 13 + ["low"] * 17)
    activity, margins = Halves(exact=1), Halves(exact=2)
    order = {"T5": 0}  # the failure at the median is one of the upper arm
    specs = sorted(trial_specs(cells), key=lambda spec: (order.get(spec[0], 1), spec))
    for task_id, seed, kind in specs:
        band = next(of_success) if kind == "success" else next(of_failure) if kind == "no progress" else "low"
        peak = 19.48 if band == "median" else bands[band][PROTOCOL.task(task_id).region == "abdomen"]
        sd = {"median": 3.52, "low": 1.0}.get(band, 5.0)
        place = activity.next() if kind != "process" else 1
        yield make_trial(
            "state-machine",
            task_id,
            seed,
            kind,
            peak_n=peak,
            sd_n=sd,
            c4=(place, 0.788),
            long=place == 0,
            margin_rad=-3.61e-4 * (1 + margins.next()) if task_id == "T2" else 0.5,
        )


def voxposer() -> Iterator[Recording]:
    cells: dict[str, list[tuple[Kind, int]]] = {
        "T1": [("success", 20)],
        "T2": [("no progress", 20)],
        "T3": [("no progress", 17), ("none", 2), ("process", 1)],
        "T4": [("success", 11), ("lost", 9)],
        "T5": [("no progress", 14), ("none", 3), ("process", 3)],
        "T6": [("success", 8), ("lost", 5), ("no progress", 2), ("none", 5)],
        "T7": [("no progress", 15), ("none", 4), ("process", 1)],
    }
    forces = {-1: (1.2, 0.1), 0: (1.46, 0.21), 1: (1.8, 0.3)}
    return _around(cells, "voxposer", forces, Medians(c1_n=1.46, c2_rad=-4.07e-4, c4=0.883, c5_n=0.21), exact=(1, 2, 1))


def pi05() -> Iterator[Recording]:
    cells: dict[str, list[tuple[Kind, int]]] = {
        "T1": [("off success", 1), ("off", 6), ("none", 13)],
        "T2": [("off", 6), ("none", 14)],
        "T3": [("off", 6), ("none", 13), ("process", 1)],
        "T4": [("off", 3), ("none", 16), ("process", 1)],
        "T5": [("off", 3), ("none", 16), ("process", 1)],
        "T6": [("off", 3), ("none", 17)],
        "T7": [("off", 2), ("none", 17), ("process", 1)],
    }
    forces = {-1: (12.0, 3.0), 0: (15.39, 4.42), 1: (18.0, 5.0)}
    return _around(cells, "pi05", forces, Medians(c1_n=15.39, c2_rad=-1.37e-3, c4=0.999, c5_n=4.42), exact=(2, 2, 2))


def _around(
    cells: dict[str, list[tuple[Kind, int]]],
    policy: str,
    forces: dict[int, tuple[float, float]],
    medians: Medians,
    *,
    exact: tuple[int, int, int],
) -> Iterator[Recording]:
    """``exact``: trials at the median of force, of margin and of activity, two where their number is even."""
    force, margin, activity = (Halves(exact=n) for n in exact)
    for task_id, seed, kind in trial_specs(cells):
        touches = kind not in ("none", "process")
        # A touch that ends within the trial leaves the filter's tail in its window, and so a larger SD.
        ends = touches and kind in ("lost", "no progress") and PROTOCOL.task(task_id).action == "touch"
        peak, sd = forces[force.next(above=ends) if touches else 1]
        place = activity.next() if kind != "process" else 1
        yield make_trial(
            policy, task_id, seed, kind, peak_n=peak, sd_n=sd, c4=(place, medians.c4), long=place == 0,
            margin_rad=medians.c2_rad * (1 + margin.next()) if task_id == "T2" and touches else 0.5,
        )  # fmt: skip


METHODS = {"State Machine": state_machine, "VoxPoser": voxposer, "pi0.5": pi05}


def trial_id(recording: Recording) -> str:
    spec: TrialSpec = recording.header.spec
    return spec.trial_id
