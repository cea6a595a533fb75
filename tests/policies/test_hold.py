"""Over foam, the hand is held along the normal; without room for that, it is turned or raised."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carecontact.interface.body_view import person_points, region_from_observation
from carecontact.interface.geometry import matrix_from_quat
from carecontact.interface.observation import Observation
from carecontact.interface.robot import PANDA, Session
from carecontact.policies.foam import CLEAR_M, FoamSeen, find_foam, holds, leant, room
from carecontact.policies.motion import tool_quat
from carecontact.policies.pressing import CONTACT
from carecontact.policies.state_machine import StateMachine
from carecontact.protocol.sections import FOAM_COLOURS
from tests.interface.lying_person import Person
from tests.policies.test_foam import foamed

DOWN = np.array([0.0, 1.0, 0.0, 0.0])
ALONG = np.array([0.0, 1.0, 0.0])
FOAM = FoamSeen(
    centre_m=np.array([0.5, 0.0, 0.1]),
    along=ALONG,
    half_m=(0.05, 0.02),
    out=leant(np.array([0.4, 0.0, 1.0]), ALONG),
    skin_m=np.array([[0.5, y, 0.1] for y in np.linspace(-0.05, 0.05, 21)]),
)


def wall(away_m: float, *, level: tuple[float, float] = (1.0, 0.0)) -> np.ndarray:
    """(N, 3) points from 60 to 100 mm over the foam, on a plane at a distance from it, square to ``level`` (2,)."""
    side = np.array([*level, 0.0])
    across = np.array([-level[1], level[0], 0.0])
    steps = [(s, z) for s in np.linspace(-0.2, 0.2, 41) for z in np.linspace(0.06, 0.10, 5)]
    return np.array([FOAM.centre_m + away_m * side + s * across + [0.0, 0.0, z] for s, z in steps])


@given(st.floats(0.0, 0.3))
def test_the_room_beside_an_upright_hand_is_what_hand_and_links_leave(away_m: float) -> None:
    ((hand_m, _, _), _), ((links_m, _, low_m), behind_m) = PANDA.hand_boxes_m[1:]
    # The hand is beside the wall, and the last links begin over it.
    above = behind_m - low_m - 0.10
    expected = min(away_m - hand_m, np.hypot(max(away_m - links_m, 0.0), above))
    assert room(wall(away_m), FOAM.centre_m[None], DOWN) == pytest.approx(expected, abs=1e-9)


def test_without_a_person_in_the_way_the_tool_presses_along_the_normal_and_is_not_turned() -> None:
    for person in (np.zeros((0, 3)), wall(0.34)):
        quat, out = holds(FOAM, person)[0]
        np.testing.assert_allclose(out, FOAM.out, atol=1e-12)
        np.testing.assert_allclose(-matrix_from_quat(quat)[:, 2], out, atol=1e-12)
        assert matrix_from_quat(quat)[:, 0] @ [0.0, 1.0, 0.0] == pytest.approx(0.0, abs=1e-12), "not turned"


@given(st.floats(0.0, 0.3), st.floats(-np.pi, np.pi))
def test_no_hold_has_more_room_than_the_first_one(away_m: float, angle: float) -> None:
    person = wall(away_m, level=(float(np.cos(angle)), float(np.sin(angle))))
    rooms = [min(CLEAR_M, room(person, FOAM.centre_m[None], quat)) for quat, _ in holds(FOAM, person)]
    # The first one was chosen at both ends of each lane, of which none lies 60 mm from the middle.
    assert rooms[0] > max(rooms) - 0.06


def test_the_state_machine_keeps_the_hand_off_a_high_trunk(
    person: Person, observation: Observation, session: Callable[..., Session]
) -> None:
    region = region_from_observation(observation, "upper_arm")
    view = foamed(observation, region, FOAM_COLOURS["lime"]).cameras["overhead"]
    assert view.points is not None
    points = view.points.copy()
    # The trunk is wider by 120 mm, and the shoulder stays where it is.
    points[points[:, 1] < person.shoulder[1] - 0.08, 1] += 0.12
    view = replace(view, points=points)
    policy = StateMachine()
    policy.configure(session())
    policy.reset("gently scrub the foam off the right upper arm")
    legs = policy.choose(replace(observation, cameras={"overhead": view})).legs
    foam = find_foam(view, region)
    plain = tool_quat(-foam.out, foam.centre_m * [1.0, 1.0, 0.0])
    rooms = [room(person_points(view), foam.centre_m[None], quat) for quat in (plain, legs[CONTACT].quat_wxyz)]
    assert rooms[0] < 0.5 * CLEAR_M
    assert rooms[1] >= CLEAR_M
