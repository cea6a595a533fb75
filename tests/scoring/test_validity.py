"""Well-formed recordings that cannot have happened: each is reported with the array, the place and what is valid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from carecontact.errors import RecordingError
from carecontact.recording import SEGMENTS, Failure, Recording
from carecontact.scoring import METRICS, score_recording
from carecontact.scoring.commanded import target_poses
from tests.scoring.synthetic import before_start, hold, make_recording, push, touch
from tests.scoring.test_force import STIFFNESS, SWING, r2, recording

FOREARM = SEGMENTS.index("right_forearm")
FORCE, NORMAL = "scorer/force_human_from_robot_in_world", "scorer/normal_force"
MM, DEG = 1000.0, 180 / np.pi
Change = Callable[[Recording], object]


def good() -> Recording:
    """A push with what the base of all tests leaves out: commands."""
    return push(targets_in_region=[(0.1, (0.0, 0.0, 0.04)), (0.9, (0.0, 0.0, 0.03))])


def times(path: str, factor: float) -> Change:
    return lambda r: r.arrays.__setitem__(path, (r[path] * factor).astype(r[path].dtype))


def plus(path: str, offset: float) -> Change:
    return lambda r: r.arrays.__setitem__(path, r[path] + offset)


def put(path: str, place: object, value: object) -> Change:
    return lambda r: r[path].__setitem__(place, value)


def cut_samples(recording: Recording) -> None:
    """Half of the scorer's stream at physics rate is lost; control periods and actions run on."""
    steps = len(recording["scorer/time_s"])
    for path, array in list(recording.arrays.items()):
        if path.startswith("scorer/") and len(array) == steps:
            recording.arrays[path] = array[: steps // 2]


def drop_period(recording: Recording) -> None:
    for path in ("scorer/period_time_s", "scorer/indentation_m", "scorer/target_in_base"):
        recording.arrays[path] = np.delete(recording[path], 50, axis=0)


WRONG: dict[str, tuple[Change, str]] = {
    "normals in kN": (times(NORMAL, 1e-3), r"8 N at 1.00\d* s and scorer/normal_force 0.008 N; .* at most 0.04298 N"),
    "no normals": (times(NORMAL, 0.0), r"scorer/normal_force 0 N; .* at most 0.01 N"),
    "a normal below zero": (put(NORMAL, (3, 1), -1.0), r"normal_force holds -1 at \(3, 1\); valid: 0 to inf N"),
    "joint range reversed": (
        lambda r: r.arrays.__setitem__("scorer/human_joint_range", r["scorer/human_joint_range"][:, ::-1].copy()),
        r"human_joint_range of right_shoulder_abduction is 2.5 to -0.5 rad; expected low below high",
    ),
    "an end stop inside the range": (
        lambda r: r.arrays.__setitem__("scorer/human_joint_reaction", np.full((1500, 2), 0.5, np.float32)),
        r"human_joint_reaction holds 0.5 N m for right_shoulder_abduction at 1 rad; expected 0 inside -0.5 to 2.5 rad",
    ),
    "joints in degrees": (times("scorer/human_joint_position", DEG), r"human_joint_position holds 57.* rad"),
    "joint range in degrees": (times("scorer/human_joint_range", DEG), r"human_joint_range holds -28.* rad"),
    "settled joints in degrees": (times("scorer/human_joint_settled", DEG), r"human_joint_settled holds 57.* rad"),
    "wrist in mm": (times("scorer/wrist_in_world", MM), r"wrist_in_world holds 420 at \(0, 0\); valid: -5 to 5 m"),
    "settled wrist in mm": (times("scorer/wrist_settled_in_world", MM), r"wrist_settled_in_world holds 420"),
    "tool in mm": (
        put("scorer/pose_tcp_in_world", (slice(None), 0), 300.0),
        r"pose_tcp_in_world holds 300 at \(0, 0\); valid: -5 to 5 m",
    ),
    "regions in mm": (
        put("scorer/region_pose_in_world", (slice(None), 0, 0), 300.0),
        r"region_pose_in_world holds 300",
    ),
    "contact in mm": (put("scorer/centroid_in_world", (7, 1, 2), 700.0), r"centroid_in_world holds 700 at \(7, 1, 2\)"),
    "target in mm": (put("scorer/target_in_base", (7, 2), 300.0), r"target_in_base holds 300 at \(7, 2\)"),
    "size in mm": (times("scorer/region_size_m", MM), r"region_size_m holds 240 at \(0, 0\); valid: 0.001 to 1 m"),
    "size in km": (times("scorer/region_size_m", 1e-3), r"region_size_m holds 0.00024"),
    "speed below zero": (times("scorer/tcp_speed", -1.0), r"tcp_speed holds -0.1 at \(0,\); valid: 0 to inf m/s"),
    "rotation below zero": (put("scorer/tcp_rotation_speed", 5, -1.0), r"tcp_rotation_speed holds -1 at \(5,\)"),
    "indentation below zero": (times("scorer/indentation_m", -1.0), r"indentation_m holds -0.003 at \(0, 0\)"),
    "base in mm": (
        lambda r: r.header.pose_base_in_world.__setitem__(slice(0, 3), [-220.0, 620.0, 620.0]),
        r"pose_base_in_world holds \[-220.*at most 5 m",
    ),
    "late start": (plus("scorer/time_s", 1000.0), r"time_s begins at 1000 s; valid: 0 or one step of 0.002 s"),
    "early start": (plus("scorer/time_s", -5.0), r"time_s begins at -4.998 s"),
    "samples cut": (cut_samples, r"period_time_s ends at 3 s and scorer/time_s at 1.5 s; one of them is incomplete"),
    "periods cut": (
        lambda r: (
            [r.arrays.__setitem__(p, r[p][:100]) for p in ("scorer/period_time_s", "scorer/indentation_m")]
            and r.arrays.__setitem__("scorer/target_in_base", r["scorer/target_in_base"][:100])
        ),
        r"period_time_s ends at 2 s and scorer/time_s at 3 s",
    ),
    "no periods": (
        lambda r: [
            r.arrays.__setitem__(p, r[p][:0])
            for p in ("scorer/period_time_s", "scorer/indentation_m", "scorer/target_in_base")
        ],
        r"period_time_s ends at 0 s",
    ),
    "a period lost": (drop_period, r"period_time_s holds 1.04 s at 50, 0.04 s after .* up to the 0.02 s of a period"),
    "periods reversed": (
        lambda r: r.arrays.__setitem__("scorer/period_time_s", r["scorer/period_time_s"][::-1].copy()),
        r"period_time_s holds 3 s at 0",
    ),
    "periods beyond the end": (plus("scorer/period_time_s", 0.01), r"period_time_s holds 0.03 s at 0"),
    "actions run back": (
        lambda r: r.arrays.__setitem__("actions/time_s", r["actions/time_s"][::-1].copy()),
        r"actions/time_s runs back from 0.9 to 0.1 s at 1",
    ),
    "an action before the start": (put("actions/time_s", 0, -0.5), r"actions/time_s holds -0.5 s at 0, outside"),
    "an action after the end": (put("actions/time_s", 1, 3.5), r"actions/time_s holds 3.5 s at 1, outside .* 3.25 s"),
    "an observation after the end": (
        lambda r: r.arrays.update(
            {
                "policy/observation_time_s": np.array([0.0, 3.1]),
                "policy/observation_sha256": np.zeros((2, 32), np.uint8),
            }
        ),
        r"policy/observation_time_s holds 3.1 s at 1, outside the trial: 0 to 3.002 s",
    ),
    "stiffness infinite": (put("actions/stiffness", (0, 1), np.inf), r"actions/stiffness holds inf at \(0, 1\)"),
    "stiffness is no number": (put("actions/stiffness", 0, np.nan), r"actions/stiffness holds nan at \(0, 0\)"),
    "an infinite action": (put("actions/pose_tcp_in_base", (1, 0), np.inf), r"pose_tcp_in_base holds inf at \(1, 0\)"),
    "half an action": (put("actions/pose_tcp_in_base", (1, 3), np.nan), r"pose_tcp_in_base holds nan at \(1, 3\)"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_cannot_have_happened_is_named(name: str) -> None:
    change, message = WRONG[name]
    recording = good()
    assert score_recording(recording).safety_gated
    change(recording)
    with pytest.raises(RecordingError, match=rf"^T2-s000: .*{message}"):
        score_recording(recording)


def test_a_trial_may_not_outlast_its_limit() -> None:
    recording = make_recording("T1", duration=0.4)
    protocol = recording.header.spec.protocol
    short = protocol.model_copy(update={"phases": protocol.phases.model_copy(update={"time_limit_s": 0.3})})
    spec = recording.header.spec.model_copy(update={"protocol": short})
    with pytest.raises(RecordingError, match=r"ends at 0.4 s; the time limit is 0.3 s"):
        score_recording(Recording(header=recording.header.model_copy(update={"spec": spec}), arrays=recording.arrays))


@pytest.mark.parametrize("ended", ["done", "time_limit"])
def test_only_a_failure_leaves_no_samples(ended: str) -> None:
    with pytest.raises(RecordingError, match=f"ended '{ended}' without a sample in scorer/time_s; only a trial whose"):
        score_recording(before_start(ended))


def test_an_action_of_a_trial_without_samples_is_at_its_start() -> None:
    recording = before_start()
    late = make_recording("T1", targets_in_region=[(2.0, (0.0, 0.0, 0.04))])
    recording.arrays.update({path: late[path] for path in late.arrays if path.startswith("actions/")})
    with pytest.raises(RecordingError, match=r"actions/time_s holds 2 s at 0, outside the trial"):
        score_recording(recording)


@pytest.mark.parametrize(
    ("force", "ended", "failure", "message"),
    [
        (201.0, "done", None, r"ended 'done' with 201 N on right_forearm; above 200 N a trial is truncated"),
        (250.0, "process_failure", "died", r"ended 'process_failure' with 250 N on right_forearm"),
        (199.0, "safety_truncation", "force", r"truncated because of a force, but .*: 199 N of 200 on right_forearm"),
        (0.0, "safety_truncation", "force", r"truncated because of a force, but .*: none on any segment"),
        (
            250.0,
            "safety_truncation",
            "died",
            r"'safety_truncation' with failure 'died'; valid: force, solver, joint_speed, tool_speed",
        ),
    ],
)
def test_a_cut_and_its_force_belong_together(force: float, ended: str, failure: str | None, message: str) -> None:
    cause = Failure(kind=failure, message="as reported") if failure else None
    with pytest.raises(RecordingError, match=message):
        score_recording(touch(force=force, ended=ended, failure=cause))


def test_a_cut_needs_a_cause() -> None:
    recording = touch(force=250.0, ended="safety_truncation")
    header = recording.header.model_copy(update={"failure": None})
    with pytest.raises(RecordingError, match="'safety_truncation' with failure None"):
        score_recording(Recording(header=header, arrays=recording.arrays))


def test_no_number_that_is_none_gets_into_a_score(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the checks of the streams do not foresee."""
    broken = replace(METRICS["C4@1"], measure=lambda contact: np.nan)
    monkeypatch.setitem(METRICS._rows, "C4@1", broken)
    with pytest.raises(RecordingError, match="T2-s000: c4_motion_activity comes out as nan"):
        score_recording(good())


def test_what_can_happen_is_scored() -> None:
    """Otherwise a check that refuses everything would do: the line itself, a short cancellation, friction, one kept
    target."""
    assert score_recording(touch(force=200.0)).c3_success
    recording = good()
    recording[FORCE][600:675, FOREARM] = 0.0
    score_recording(recording)
    bounce = make_recording("T1", normal={"right_forearm": hold(3.0, 1.0, 1.01, 5.0)})
    bounce[FORCE][:] = 0.0
    score_recording(bounce)
    recording = good()
    recording[FORCE][:, FOREARM, 0] = 1.9 * recording[NORMAL][:, FOREARM]
    recording["actions/pose_tcp_in_base"][0] = np.nan
    assert score_recording(recording).region_correct


def test_diverged_physics_is_a_failed_trial_and_not_a_lost_one() -> None:
    whole, diverged = touch(), touch(ended="safety_truncation")
    for trial in (whole, diverged):
        trial["scorer/wrist_in_world"][-5:] = 500.0
    with pytest.raises(RecordingError, match="wrist_in_world"):
        score_recording(whole)
    assert diverged.header.failure == Failure(kind="solver", message="cut")
    scored = score_recording(diverged)
    assert (scored.c3_success, scored.region_correct, scored.safety_gated) == (False, False, False)


# Actions in joint space: what a recording may hold of them, and what the scorer reads from it.


def in_joints() -> Recording:
    made = recording(SWING, STIFFNESS * SWING)
    count = len(made["actions/time_s"])
    made.arrays["actions/pose_tcp_in_base"] = np.full((count, 7), np.nan)
    made.arrays["actions/stiffness"] = np.full((count, 2), np.nan)
    made.arrays["actions/joint"] = np.zeros((count, 7))
    return made


def test_joint_actions_are_scored_from_the_pose_of_their_targets() -> None:
    made = in_joints()
    assert score_recording(made).trial_id == made.header.spec.trial_id
    assert r2(made) == pytest.approx(1.0)
    np.testing.assert_allclose(target_poses(made)[0], made["scorer/target_in_base"][0], atol=1e-6)


def test_half_a_joint_action_is_refused() -> None:
    made = in_joints()
    made["actions/joint"][0] = [1, np.nan, 0, 0, 0, 0, 0]
    with pytest.raises(RecordingError, match=r"actions/joint holds nan at \(0, 1\)"):
        score_recording(made)
