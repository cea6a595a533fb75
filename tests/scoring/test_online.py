"""Progress toward a gate, of every beginning of a trial: it is full exactly where the score says that it is met."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.protocol.protocol import Protocol
from carecontact.recording import Recording
from carecontact.scoring import score_recording
from carecontact.scoring.actions import BEHAVIOURS, Judgement
from carecontact.scoring.behaviour import Gate
from carecontact.scoring.online import NEEDED, progress_of
from tests.scoring.synthetic import GENTLE, PROTOCOL, back_and_forth, hold, make_recording

DURATION_S = 6.0


def trial(task_id: str, protocol: Protocol, force_n: float) -> Recording:
    """A trial that meets the paper's gate of its task: the tool comes, presses, wipes, and the wrist goes with it."""
    region = protocol.task(task_id).region
    segment = {"forearm": "right_forearm", "upper_arm": "right_upper_arm", "abdomen": "abdomen"}[region]
    moved = np.linspace(0.0, 0.05, round(DURATION_S / 0.002))
    return make_recording(
        task_id,
        duration=DURATION_S,
        normal={segment: hold(DURATION_S, 1.0, 5.5, force_n)},
        tcp_in_region=back_and_forth(DURATION_S, region, amplitude=0.06, period=2.0),
        wrist_shift=moved,
        protocol=protocol,
        ended="time_limit",
    )


def until(recording: Recording, steps: int) -> Recording:
    """The first physics steps of a trial."""
    kept = {len(recording["scorer/time_s"]): steps, len(recording["scorer/period_time_s"]): steps // 10}
    cut = {path: array[: kept.get(len(array))] for path, array in recording.arrays.items()}
    return Recording.trusted(recording.header, cut)


@pytest.mark.parametrize("protocol", [PROTOCOL, GENTLE], ids=["paper", "exam"])
@pytest.mark.parametrize("task_id", ["T1", "T2", "T3"])
@pytest.mark.parametrize("force_n", [0.2, 4.0, 30.0])
def test_it_is_full_exactly_where_the_gate_is_met(task_id: str, protocol: Protocol, force_n: float) -> None:
    recording = trial(task_id, protocol, force_n)
    shares, met = [], []
    for steps in range(250, 3001, 250):
        cut = until(recording, steps)
        found, score = progress_of(cut), score_recording(cut)
        assert 0.0 <= found.share <= 1.0
        assert found.success == score.c3_success
        assert found.safety_gated == score.safety_gated
        assert found.safe == (not score.over_limit and not score.joints_beyond)
        # A gate that is met without valid contact is no success.
        assert found.share == 1.0 or not found.success
        shares.append(found.share)
        met.append(found.success)
    assert shares[0] == 0.0
    if force_n == 4.0:
        assert met[-1]
        assert shares[-1] == 1.0
        assert any(0.0 < share < 1.0 for share in shares), shares
    if force_n == 0.2:
        assert max(shares) < 1.0


def test_the_needed_streams_suffice() -> None:
    recording = trial("T3", GENTLE, 4.0)
    constants = {path: recording[path] for path in recording if path not in NEEDED and len(recording[path]) < 20}
    bare = Recording.trusted(recording.header, {path: recording[path] for path in NEEDED} | constants)
    assert progress_of(bare) == progress_of(recording)


def test_forces_and_distance_are_those_of_the_end() -> None:
    duration = 2.0
    above = np.tile([0.0, 0.0, 0.045 + 0.07], (1000, 1))
    pressed = {"right_forearm": hold(duration, 1.0, 2.0, 5.0), "abdomen": hold(duration, 1.96, 2.0, 3.0)}
    found = progress_of(make_recording("T1", duration=duration, normal=pressed, tcp_in_region=above))
    assert found.force_n == pytest.approx(5.0, abs=1e-5)
    assert found.elsewhere_n == pytest.approx(3.0, abs=1e-5)
    assert found.distance_m == pytest.approx(0.07, abs=1e-6)


def test_an_action_of_another_package_has_the_share_of_its_parts() -> None:
    touch = BEHAVIOURS["touch"]
    default = type(touch).__mro__[2].reached
    met = Judgement(time_met=True, progress_met=True, band_met=False)
    gate = Gate(**vars(met), success=False, longest_on_s=0.0, best=None, wrist_m=0.0, wrist_any_m=0.0)
    assert default(touch, None, None, gate) == pytest.approx(2 / 3)
