"""A person who breathes, moves its arm and withdraws it, through a whole episode."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from carecontact.episode.episode import Episode
from carecontact.episode.randomization import World, settled_world, start_motion_script
from carecontact.errors import SceneError
from carecontact.human.skeleton import body_name
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard
from carecontact.protocol.load import load_protocol
from carecontact.protocol.person import Alive, Breathing, Repositioning, Withdrawal
from carecontact.protocol.protocol import Protocol, TrialSpec
from carecontact.recording import OPTIONAL_ARRAYS, Recording
from carecontact.scoring import score_recording
from carecontact.sim.rendering import SceneRenderer
from carecontact.sim.simulation import Simulation
from carecontact.tissue.life import JOINTS
from carecontact.world.scene import build_scene

SEED = 1
"""Under the name DRAWN_AS, its person moves the arm 0.24 s after the start."""
DRAWN_AS = "bathing-draft"
OWN = {
    path
    for path in OPTIONAL_ARRAYS
    if path.startswith(("scorer/breath", "scorer/muscle", "scorer/repos", "scorer/with"))
}
CARD = PolicyCard(name="blind", modalities=(), cameras=(), control_hz=10)


def living(alive: Alive) -> Protocol:
    protocol = load_protocol("bathing-v3")
    drawn = protocol.randomization.model_copy(update={"drawn_as": DRAWN_AS})
    person = protocol.person.model_copy(update={"alive": alive})
    return protocol.model_copy(update={"person": person, "randomization": drawn})


PROTOCOL = living(Alive(breathing=Breathing(), repositioning=Repositioning(), withdrawal=Withdrawal()))
SPEC = TrialSpec(protocol=PROTOCOL, task_id="T6", seed=SEED, policy="blind")


@pytest.fixture(scope="module")
def world() -> World:
    return settled_world(PROTOCOL, task_id="T6", seed=SEED)


@pytest.fixture
def begin(world: World) -> Callable[..., World]:
    """The same person, just awake, in data of its own."""
    simulation, settled, sha256 = world
    state = simulation.integration_state()

    def fresh(spec: TrialSpec = SPEC) -> World:
        made = Simulation(simulation.scene)
        made.restore(state, comfort_arm_deg=settled.comfort_arm_deg)
        return made, settled, sha256

    return fresh


def frequency(simulation: Simulation) -> tuple[float, float, float]:
    """Of the breath: frequency [Hz], phase at the start, share of breathing in."""
    hz, share, phase = simulation.model.numeric("life/breath").data[:3]
    return float(hz), float(phase), float(share)


def test_the_depth_image_shows_the_declared_breath(begin: Callable[..., World]) -> None:
    simulation, _, _ = begin()
    simulation.start()
    hz, phase, share = frequency(simulation)
    assert 0.2 <= hz <= 0.33
    wanted = simulation.model.numeric("life/breath").data[3:5]
    depth = {}
    with SceneRenderer(simulation.model, protocol=PROTOCOL) as renderer:
        for name, cycle in (("out", 1.0), ("in", 1.0 + share)):
            simulation.advance(round(((cycle - phase) / hz - simulation.time_s) / simulation.model.opt.timestep))
            simulation.refresh()
            depth[name] = renderer.depth(simulation.data, "overhead")
            human = renderer.truth(simulation.data, "overhead").human
            camera = renderer.pose_camera_in_base(simulation.data, "overhead")
            matrix = renderer.intrinsics("overhead")
        for part, point in (("abdomen", simulation.data.site("region_abdomen").xpos), ("chest", None)):
            at = simulation.data.body(body_name("thorax")).xpos + [0.17, 0.0, 0.1] if point is None else point
            in_base = simulation.encoders.in_base(simulation.data, at, np.eye(3))[:3, 3]
            x, y, z = camera[:3, :3].T @ (in_base - camera[:3, 3])
            u, v = round(x / z * matrix[0, 0] + matrix[0, 2]), round(y / z * matrix[1, 1] + matrix[1, 2])
            window = slice(v - 2, v + 3), slice(u - 2, u + 3)
            assert human[window].all()
            rise = np.median((depth["out"] - depth["in"])[window])
            assert rise == pytest.approx(wanted[("abdomen", "chest").index(part)], abs=0.001)
    assert wanted[0] > 0.008, "else a person who does not breathe would pass"


def test_two_runs_and_a_restored_one_are_equal_bit_for_bit(begin: Callable[..., World]) -> None:
    """Restored at 0.7 s: in mid-breath, and in the middle of a movement of the arm."""
    first, second, third = (begin()[0] for _ in range(3))
    for simulation in (first, second, third):
        simulation.start()
    first.advance(350)
    middle = first.integration_state()
    first.advance(500)
    second.advance(850)
    end = first.integration_state()
    np.testing.assert_array_equal(second.integration_state(), end)
    mujoco.mj_setState(third.model, third.data, middle, int(mujoco.mjtState.mjSTATE_INTEGRATION))
    third.advance(500)
    np.testing.assert_array_equal(third.integration_state(), end)
    assert first.life is not None
    assert abs(first.life.torque_nm(first.data)).max() > 0.1


def test_the_arm_moves_as_far_as_was_drawn_and_stays_on_its_board(begin: Callable[..., World]) -> None:
    simulation, _, _ = begin()
    simulation.start()
    assert simulation.life is not None
    onset_s, turn = simulation.life.moves()[0]
    wrist = simulation.data.body(body_name("right_hand"))
    simulation.advance(round(onset_s / 0.002))
    before, radius = wrist.xpos.copy(), simulation.wrist_radius_m()
    simulation.advance(round(1.2 / 0.002))
    moved = wrist.xpos - before
    assert np.hypot(*moved[:2]) == pytest.approx(abs(turn) * radius, abs=0.006)
    assert 0.04 < np.hypot(*moved[:2]) < 0.085
    assert abs(moved[2]) < 0.01
    assert simulation.solver_warnings() == []


def recorded(begin: Callable[..., World], *, height_m: float) -> Recording:
    """Half a second with the tool going to another height."""
    with Episode(SPEC, card=CARD, prepare=begin) as episode:
        pose = episode.reset().pose_tcp_in_base.copy()
        pose[2] += height_m
        for k in range(6):
            episode.step(Action(pose_tcp_in_base=pose, done=k == 5), observe=False)
        return episode.finish()


def test_the_recording_has_what_moved_the_person_and_onsets_do_not_depend_on_the_policy(
    begin: Callable[..., World],
) -> None:
    one, other = (recorded(begin, height_m=height) for height in (-0.05, 0.05))
    assert score_recording(one).trial_id == SPEC.trial_id
    assert one.arrays.keys() >= OWN
    assert len(OWN) == 6
    periods = len(one["scorer/period_time_s"])
    assert one["scorer/breath_m"].shape == (periods, 2)
    assert one["scorer/muscle_torque_nm"].shape == (periods, len(JOINTS))
    assert np.ptp(one["scorer/breath_m"][:, 0]) > 0.001
    assert one["scorer/muscle_work_j"][-1, 1] > 0.0
    assert len(one["scorer/repositioning_s"]) >= 2
    assert (one["scorer/withdrawal_s"] == -1).all()
    assert not np.array_equal(one["scorer/pose_tcp_in_world"], other["scorer/pose_tcp_in_world"])
    for path in ("scorer/repositioning_s", "scorer/repositioning_rad", "scorer/breath_m"):
        np.testing.assert_array_equal(one[path], other[path])


def test_a_person_who_does_nothing_leaves_no_such_arrays(
    t1: TrialSpec, parked_world: Callable[[TrialSpec], World]
) -> None:
    with Episode(t1, card=CARD, prepare=parked_world) as episode:
        episode.reset()
        episode.step(Action(done=True))
        assert episode.finish().arrays.keys().isdisjoint(OWN)


def test_the_policy_is_shown_the_same_fields(
    begin: Callable[..., World], t1: TrialSpec, parked_world: Callable[[TrialSpec], World]
) -> None:
    shown = []
    for spec, prepare in ((SPEC, begin), (t1, parked_world)):
        with Episode(spec, card=CARD, prepare=prepare) as episode:
            shown.append(episode.reset())
            assert episode.session.time_limit_s == 30.0
    living_one, still_one = shown
    assert vars(living_one).keys() == vars(still_one).keys()
    assert living_one.cameras.keys() == still_one.cameras.keys()


def test_the_state_of_a_person_who_is_awake_is_refused_by_a_world_in_which_nobody_is() -> None:
    scene = build_scene(PROTOCOL, target=None, skin=False)
    awake, fresh = Simulation(replace(scene, model=copy.deepcopy(scene.model))), Simulation(scene)
    awake.settle(52.5)
    start_motion_script(awake, SEED)
    state = awake.integration_state()
    awake.restore(state, comfort_arm_deg=52.5)
    with pytest.raises(SceneError, match="the person of this world never woke"):
        fresh.restore(state, comfort_arm_deg=52.5)
