from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from carecontact.contract.observation import Observation
from carecontact.contract.session import Session
from carecontact.errors import ProgramError
from carecontact.policies.motion import CAP_RADIUS_M
from carecontact.policies.voxposer import fixed_values as fixed
from carecontact.policies.voxposer.grid import Grid
from carecontact.policies.voxposer.phased import VoxPoserPhased
from carecontact.policies.voxposer.progress import Objective, Pursuit, objective_functions
from carecontact.policies.voxposer.prompts import VOXPOSER_PHASED
from carecontact.policies.voxposer.seen_skin import gap, skin_height, touches
from carecontact.protocols import load_protocol
from tests.policies.voxposer.conftest import scripted
from tests.policies.voxposer.test_policy import BENIGN, follow
from tests.sight.lying_person import Person

DOWN = np.array([0.0, 1.0, 0.0, 0.0])
PLATE = np.array([(x, y, 0.1) for x in np.arange(0.3, 0.7, 0.004) for y in np.arange(-0.1, 0.1, 0.004)])
WALL = np.array([(0.5, y, z) for y in np.arange(-0.1, 0.1, 0.004) for z in np.arange(0.0, 0.2, 0.004)])
X = np.array([1.0, 0.0, 0.0])


def pose(*position: float) -> np.ndarray:
    return np.concatenate([position, DOWN])


def test_a_slide_goes_back_and_forth_under_the_skin_until_its_way_is_done(grid: Grid) -> None:
    slide = Objective(kind="slide", direction=X, distance_m=0.2, span_m=0.1)
    pursuit = Pursuit(objective=slide, skin=PLATE, start=np.array([0.5, 0.0, 0.098]))
    tool, ends = pose(0.5, 0.0, 0.098), []
    while (moved := pursuit.next_motion(tool, grid)) is not None:
        way = np.array([a.pose_tcp_in_base[:3] for a in moved.actions])
        assert way[-1, 2] == pytest.approx(0.1 - fixed.PRESS_M, abs=1e-6)
        speed = np.linalg.norm(np.diff(way, axis=0), axis=1).max() * fixed.CONTROL_HZ
        assert speed <= fixed.SLIDE_SPEED_M_S * 1.01
        tool = moved.actions[-1].pose_tcp_in_base
        ends.append(round(float(tool[0]), 3))
    assert ends == [0.55, 0.45, 0.55]
    assert pursuit.done_m == pytest.approx(0.25)


def test_a_slide_that_the_tool_does_not_follow_is_given_up(grid: Grid) -> None:
    slide = Objective(kind="slide", direction=X, distance_m=0.2, span_m=0.1)
    pursuit = Pursuit(objective=slide, skin=PLATE, start=np.array([0.5, 0.0, 0.098]))
    looks = 0
    while pursuit.next_motion(pose(0.5, 0.0, 0.098), grid) is not None:
        looks += 1
    assert (looks, pursuit.done_m) == (fixed.MAX_PROGRESS_LOOKS, 0)


def test_a_displacement_leads_further_ahead_the_longer_nothing_moves_and_holds_when_met(grid: Grid) -> None:
    push = Objective(kind="displace", direction=X, distance_m=0.04)
    start = np.array([0.5 - CAP_RADIUS_M - 0.01, 0.0, 0.1])
    pursuit = Pursuit(objective=push, skin=WALL, start=start)
    leads = []
    for _ in range(6):
        moved = pursuit.next_motion(pose(*start), grid)
        assert moved is not None
        leads.append(float(moved.actions[-1].pose_tcp_in_base[0] - start[0]))
    np.testing.assert_allclose(leads, [0.015, 0.03, 0.045, 0.06, 0.06, 0.06], atol=1e-9)
    assert pursuit.done_m == pytest.approx(-0.01, abs=1e-6), "the way to the skin does not count"
    held = pursuit.next_motion(pose(*(start + 0.055 * X)), grid)
    assert held is not None
    assert len(held.actions) == fixed.DISPLACE_HOLD_S * fixed.CONTROL_HZ
    ends = np.array([a.pose_tcp_in_base[:3] for a in held.actions if a.pose_tcp_in_base is not None])
    np.testing.assert_allclose(ends - start, np.tile(0.06 * X, (len(ends), 1)), atol=1e-9)
    assert pursuit.next_motion(pose(*(start + 0.055 * X)), grid) is None


def test_what_is_seen_tells_the_touch() -> None:
    assert touches(PLATE, np.array([0.5, 0.0, 0.104]))
    assert touches(PLATE, np.array([0.5, 0.0, 0.09]))
    assert not touches(PLATE, np.array([0.5, 0.0, 0.110]))
    assert gap(WALL, np.array([0.45, 0.0, 0.1]), X) == pytest.approx(0.05 - CAP_RADIUS_M)
    assert gap(WALL, np.array([0.45, 0.0, 0.1]), -X) == 0
    assert gap(WALL, np.array([0.495, 0.0, 0.1]), X) == 0
    assert skin_height(PLATE, np.array([0.5, 0.0, 0.3])) == pytest.approx(0.1)
    assert skin_height(PLATE, np.array([0.9, 0.0, 0.3])) == pytest.approx(0.3 + fixed.PRESS_M)


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda f: f["slide"]((0, 0, 1), 20, 10), "length 0"),
        (lambda f: f["slide"]((1, 0, 0), 0, 10), "more than 0"),
        (lambda f: f["displace"]((1, 0, 0), 1e5), "at most 100 cm"),
        (lambda f: f["displace"]("x", 3), "expected 3 numbers"),
    ],
)
def test_what_is_no_objective(grid: Grid, call: Callable[[dict], object], told: str) -> None:
    with pytest.raises((ValueError, TypeError), match=told):
        call(objective_functions(grid))


def test_the_objective_takes_over_where_the_maps_have_arrived(
    observation: Observation, person: Person, session: Callable[..., Session]
) -> None:
    policy = VoxPoserPhased()
    policy.configure(session())
    prompt = next(t.prompt for t in load_protocol().tasks if t.id == "T3")
    policy.reset(prompt)
    way, notes = follow(policy, observation)
    told = [n["progress_m"] for n in notes if "progress" in n]
    assert told[0] == 0
    assert told[-1] >= 0.2
    assert [n["pursuing"] for n in notes if "progress" in n] == [True] * (len(told) - 1) + [False]
    plans = [k for k, n in enumerate(notes) if "plan" in n]
    assert max(plans) < min(k for k, n in enumerate(notes) if "progress" in n)
    near = way[person.clearance(way) < 0.0]
    along = (near - person.elbow) @ (person.wrist - person.elbow) / np.linalg.norm(person.wrist - person.elbow)
    assert np.ptp(along) > 0.08


def test_progress_is_nothing_else(observation: Observation, session: Callable[..., Session]) -> None:
    code = 'execute(parse_query_obj("gripper"), affordance_map=get_affordance_map("x"), progress=get_progress("p"))'
    for said, told in (("ret_val = 3", "leaves no objective"), ("ret_val = slide((1, 0, 0), 5)", "span_cm")):
        programs = BENIGN | {("composer", "there"): code, ("get_progress", "p"): said}
        policy = VoxPoserPhased(language=scripted(programs, VOXPOSER_PHASED))
        policy.configure(session())
        policy.reset("go")
        with pytest.raises(ProgramError, match=told):
            policy.act(observation)
