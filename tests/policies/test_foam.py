"""Foam in pictures of the synthetic person: found by colour and depth, in any light, and wiped lane by lane."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise, product

import numpy as np
import pytest

from carecontact.interface.body_view import PerceptionFailure, RegionGeometry, region_from_observation
from carecontact.interface.observation import Observation
from carecontact.interface.robot import Session
from carecontact.policies import state_machine
from carecontact.policies.foam import (
    MOST_LEAN_RAD,
    REACH_M,
    STROKES,
    find_foam,
    foam_coloured,
    lanes,
    leant,
    names_foam,
    strokes,
)
from carecontact.policies.motion import CONTROL_HZ
from carecontact.policies.state_machine import StateMachine
from carecontact.policies.voxposer.policy import VoxPoser, VoxPoserPhased
from carecontact.protocol.sections import FOAM_COLOURS, OTHER_COLOURS
from carecontact.world.room import STRENGTH, WARM_GAIN, WARMTH
from tests.protocol.foamy import FOAMY

ALONG_M, HALF_M = -0.03, (0.05, 0.02)
PROMPTS = [FOAMY.task(task.id).prompt for task in FOAMY.tasks if FOAMY.has_foam(task.id)]


@pytest.fixture
def forearm(observation: Observation) -> RegionGeometry:
    return region_from_observation(observation, "forearm")


def foamed(
    observation: Observation,
    region: RegionGeometry,
    colour: tuple[int, int, int],
    half_m: tuple[float, float] = HALF_M,
) -> Observation:
    """The same picture in grey, with an oval of foam on the region and a larger one far from it."""
    view = observation.cameras["overhead"]
    assert view.depth is not None
    assert view.points is not None
    place = np.full((*view.depth.shape, 3), np.nan)
    place[np.isfinite(view.depth)] = view.points
    rgb = np.full((*view.depth.shape, 3), 150, np.uint8)
    off = place - region.surface(ALONG_M)
    across = np.cross([0.0, 0.0, 1.0], region.axis)
    rgb[np.hypot(off @ region.axis / half_m[0], off @ across / half_m[1]) < 1] = colour
    rgb[:40, :40] = colour
    return replace(observation, cameras={"overhead": replace(view, rgb=rgb)})


@pytest.mark.parametrize("colour", FOAM_COLOURS.values())
def test_foam_is_found_at_its_place_and_in_its_size(
    observation: Observation, forearm: RegionGeometry, colour: tuple[int, int, int]
) -> None:
    view = foamed(observation, forearm, colour).cameras["overhead"]
    found = find_foam(view, forearm)
    assert np.linalg.norm(found.centre_m - forearm.surface(ALONG_M)) < 0.006
    assert abs(found.along @ forearm.axis) > 0.99
    assert found.half_m == pytest.approx(HALF_M, abs=0.005)
    assert found.out[2] > 0.99
    with pytest.raises(PerceptionFailure, match="no foam is seen on the abdomen"):
        find_foam(view, region_from_observation(observation, "abdomen"))


def test_each_lamp_leaves_foam_foam_and_other_things_other() -> None:
    for strength, warmth in product((STRENGTH[0], 1.0), np.linspace(*WARMTH, 5)):
        gain = strength * (1 + warmth * WARM_GAIN)
        for colours, is_foam in ((FOAM_COLOURS, True), (OTHER_COLOURS, False)):
            lit = np.clip(np.array([list(colours.values())]) * gain, 0, 255).astype(np.uint8)
            assert foam_coloured(lit).tolist() == [[is_foam] * len(colours)], gain


def test_a_lane_for_each_width_of_the_tool_and_three_visits_to_each_end(
    observation: Observation, forearm: RegionGeometry
) -> None:
    found = find_foam(foamed(observation, forearm, FOAM_COLOURS["lime"]).cameras["overhead"], forearm)
    ends = np.array(lanes(found))
    assert [len(lanes(replace(found, half_m=(0.05, half)))) for half in (0.008, 0.02, 0.03, 0.04)] == [1, 2, 3, 4]
    assert np.linalg.norm(ends[1, 0] - ends[0, 0]) == pytest.approx(found.half_m[1])
    ways = [way for lane in strokes(found) for way in lane]
    assert len(ways) == STROKES * len(ends)
    for before, after in pairwise(ways):
        assert np.linalg.norm(after[0] - before[-1]) < 2.1 * found.half_m[1], "no way back through the air"
    assert np.abs(np.vstack(ways)[:, 2] - forearm.surface(ALONG_M)[2]).max() < 0.012


@pytest.mark.parametrize("prompt", PROMPTS[:2])
def test_the_state_machine_goes_to_the_foam(
    observation: Observation, forearm: RegionGeometry, session: Callable[..., Session], prompt: str
) -> None:
    policy = StateMachine()
    policy.configure(session())
    policy.reset(prompt)
    actions = policy.act(foamed(observation, forearm, FOAM_COLOURS["magenta"]))
    assert len(actions) / CONTROL_HZ < 30
    poses = np.array([action.pose_tcp_in_base for action in actions])
    low = poses[poses[:, 2] < forearm.surface(ALONG_M)[2] - 0.5 * state_machine.TOUCH_DEPTHS_M[0], :3]
    along = (low - forearm.surface(ALONG_M)) @ forearm.axis
    assert along.mean() == pytest.approx(0.0, abs=0.01)
    assert np.ptp(along) == pytest.approx(0.0 if "touch" in prompt else 2 * (HALF_M[0] - REACH_M), abs=0.01)
    policy.reset(prompt)
    (ended,) = policy.act(observation)
    assert ended.done
    assert "no foam is seen" in str(policy.take_notes()["ended_without_touching"])


@pytest.mark.parametrize("method", [VoxPoser, VoxPoserPhased])
@pytest.mark.parametrize("prompt", PROMPTS)
def test_the_authored_programs_know_foam(
    observation: Observation, session: Callable[..., Session], method: type[VoxPoser], prompt: str
) -> None:
    policy = method()
    policy.configure(session())
    policy.reset(prompt)
    region = next(name for name in ("forearm", "upper_arm", "abdomen") if name.replace("_", " ") in prompt)
    seen = foamed(observation, region_from_observation(observation, region), FOAM_COLOURS["lime"])
    actions = policy.act(seen)
    assert not actions[-1].done
    assert policy.take_notes()["target_m"] is not None


AXIS = np.array([0.0, -0.9, 0.1])


def test_the_hand_leans_as_the_skin_does_and_no_farther_than_the_arm_has_room() -> None:
    for lean in (0.0, 0.3, MOST_LEAN_RAD):
        normal = np.array([np.sin(lean), 0.0, np.cos(lean)])
        np.testing.assert_allclose(leant(normal, AXIS), normal, atol=1e-12)
    steepest = [-np.sin(MOST_LEAN_RAD), 0.0, np.cos(MOST_LEAN_RAD)]
    np.testing.assert_allclose(leant(np.array([-1.0, 0.0, 0.2]), AXIS), steepest, atol=1e-12)
    np.testing.assert_allclose(leant(np.array([0.0, 0.5, 1.0]), AXIS), [0.0, 0.0, 1.0], atol=1e-12)


def test_on_a_flank_the_tool_presses_along_the_normal(
    observation: Observation, session: Callable[..., Session]
) -> None:
    forearm = region_from_observation(observation, "forearm")
    view = foamed(observation, forearm, FOAM_COLOURS["lime"]).cameras["overhead"]
    assert view.points is not None
    # The same foam on skin that falls by 0.4 rad across the limb.
    slope = np.tan(0.4) * (view.points - forearm.surface(ALONG_M)) @ forearm.lateral
    points = view.points - slope[:, None] * np.array([0.0, 0.0, 1.0], np.float32)
    out = find_foam(replace(view, points=points), forearm).out
    assert np.arctan2(out @ forearm.lateral, out[2]) == pytest.approx(0.4, abs=0.06)


def test_what_names_foam() -> None:
    assert names_foam("Gently scrub the FOAM off the abdomen.")
    assert not names_foam("gently scrub the foamy abdomen")
