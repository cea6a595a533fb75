"""Contact is counted by part of the robot: hand and links that rest on the person are no touch of the tool."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.contract.action import Action
from carecontact.contract.geometry import matrix_from_quat, quat_from_matrix
from carecontact.contract.policy import PolicyCard
from carecontact.contract.trial import TrialSpec
from carecontact.episode.episode import Episode
from carecontact.recording import SEGMENTS, Recording
from carecontact.reports.cause_words import cause_text
from carecontact.scoring import score_recording
from carecontact.validation.moves import axes, in_base, surface_point
from tests.scoring.exam_gates import GENTLE
from tests.scoring.synthetic import PROTOCOL

UNDERSIDE_M = 0.051
"""How far the cap reaches out of the hand's underside."""
BESIDE_M = 0.084
WAY = ((0.12, 60), (0.02, 20), (-0.03, 20))
"""Heights [m] of the tool's target over the skin of the place, and steps there, before the last one."""


def pressed(*, along_m: float = 0.0, across_m: float = 0.0, depth_m: float) -> Recording:
    """The touch of the forearm with the hand's long side across the arm: from above, then ``depth_m`` below the skin at
    the place (along, across) of the region."""
    spec = TrialSpec(protocol=GENTLE, task_id="T1", seed=0, policy="scripted")
    with Episode(spec, card=PolicyCard(name="scripted", cameras=(), control_hz=20)) as episode:
        episode.reset()
        simulation = episode.simulation
        simulation.refresh()
        along, across = axes(simulation, "forearm")
        place = surface_point(simulation, "forearm") + along_m * along + across_m * across
        down = np.array([0.0, 0.0, -1.0])
        base = matrix_from_quat(simulation.pose_base_in_world[3:])
        quat = quat_from_matrix(base.T @ np.stack([np.cross(across, down), across, down], 1))
        for height, steps in (*WAY, (-depth_m, 70)):
            pose = np.r_[in_base(simulation, place + [0.0, 0.0, height]), quat]
            for _ in range(steps):
                episode.step(Action(pose_tcp_in_base=pose), observe=False)
        episode.step(Action(done=True), observe=False)
        return episode.finish()


def by_part(recording: Recording, segment: str) -> tuple[np.ndarray, np.ndarray]:
    """Normal force (T,) on a segment, and what hand and links did of it (T, 2)."""
    column = SEGMENTS.index(segment)
    return recording["scorer/normal_force"][:, column], recording["scorer/beside_normal_force"][:, :, column]


@pytest.fixture(scope="module")
def resting() -> Recording:
    """The hand's underside rests on the forearm with about 2 N; the tool is beside it, in the air."""
    return pressed(across_m=BESIDE_M, depth_m=UNDERSIDE_M + 0.007)


def test_a_hand_that_rests_on_the_arm_is_no_touch(resting: Recording) -> None:
    score = score_recording(resting)
    assert (score.reported_segment, score.c3_success, score.failure_mode) == ("right_forearm", False, "not_by_tool")
    assert score.additional["gentle_hold@2"] == 0.0
    assert "The forearm was touched by the hand, not by the tool, which applied 0% of" in (score.evidence or "")
    assert cause_text(score) == "the region was touched by the robot's hand or links, not by its tool"


def test_it_was_a_touch_where_any_part_of_the_robot_counted(resting: Recording) -> None:
    arrays = {path: array for path, array in resting.arrays.items() if not path.startswith("scorer/beside_")}
    assert score_recording(Recording(header=resting.header, arrays=arrays)).c3_success


def test_hand_and_links_are_a_part_of_the_whole_force(resting: Recording) -> None:
    whole, beside = by_part(resting, "right_forearm")
    assert whole.max() > 1.0
    np.testing.assert_array_equal(beside[:, 0], whole)
    assert not beside[:, 1].any()
    force = resting["scorer/force_human_from_robot_in_world"]
    np.testing.assert_array_equal(resting["scorer/beside_force_in_world"].sum(1), force)


def test_the_paper_s_gates_count_any_part(resting: Recording) -> None:
    spec = resting.header.spec.model_copy(update={"protocol": PROTOCOL})
    header = resting.header.model_copy(update={"spec": spec})
    assert score_recording(Recording(header=header, arrays=resting.arrays)).c3_success


def test_the_tool_alone_leaves_no_account_of_other_parts() -> None:
    recording = pressed(depth_m=0.012)
    assert not any(path.startswith("scorer/beside_") for path in recording)
    score = score_recording(recording)
    assert (score.c3_success, score.failure_mode) == (True, None)


def test_rigid_surfaces_know_the_part_too() -> None:
    """The person's hand is rigid: sensors and not the tissue feel what touches it."""
    whole, beside = by_part(pressed(along_m=0.2, across_m=BESIDE_M, depth_m=0.09), "right_hand")
    assert whole.max() > 5.0
    np.testing.assert_array_equal(beside.sum(1), whole)
    tool = pressed(along_m=0.2, depth_m=0.06)
    assert tool["scorer/normal_force"][:, SEGMENTS.index("right_hand")].max() > 5.0
    assert not any(path.startswith("scorer/beside_") for path in tool)
