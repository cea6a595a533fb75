"""Foam in trials: seen at first, wiped away, shown again, and the same from the recording alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from carecontact.audit import redraw
from carecontact.audit.raw_log import LoggedLook
from carecontact.audit.watched import StateReader
from carecontact.episode.episode import Episode
from carecontact.episode.randomization import World, calibration, sensor_noise, settled_world
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard
from carecontact.policies.motion import UP, Leg, radial_quat, sample, travel
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import Protocol, TrialSpec
from carecontact.recording import Recording
from carecontact.replay.film import Film
from carecontact.scoring.foam import RecordedWiping
from carecontact.sim.opengl import import_opengl
from carecontact.sim.rendering import SceneRenderer
from carecontact.sim.simulation import Simulation
from tests.protocol.foamy import FOAMY, LEVELS, with_foam

CARD = PolicyCard(name="wipe", modalities=("rgb", "depth"), cameras=("overhead",), control_hz=20.0)
STILL = with_foam(load_protocol("bathing-wide-v2", level="L0"))
"""One person in one place: what wiping does to foam does not depend on that."""
GOLDEN = Path(__file__).parents[1] / "data" / "foam_fades.png"
"""(64, 128) the foam in the overhead picture before and after wiping."""
NEAR_PX = 30.0
"""Farthest pixel of a patch of 100 mm from its middle in the overhead picture, with a margin."""
HUE, SATURATION, VALUE = 10, 200, 50
"""The threshold of this test, of 256 each: within so much of the colour's hue, and at least so saturated and bright."""


def pixels_of(colour: tuple[int, int, int], picture: np.ndarray) -> np.ndarray:
    """(H, W) pixels of a picture that have the colour of foam."""
    hue, saturation, value = (
        np.asarray(Image.fromarray(picture).convert("HSV"))[..., channel].astype(int) for channel in range(3)
    )
    own = int(np.asarray(Image.new("RGB", (1, 1), colour).convert("HSV"))[0, 0, 0])
    off = np.abs((hue - own + 128) % 256 - 128)
    return (off < HUE) & (saturation > SATURATION) & (value > VALUE)


def place_px(simulation: Simulation, renderer: SceneRenderer, region: str) -> np.ndarray:
    """(2,) where the foam's middle is in the overhead picture, by the skeleton and the camera alone."""
    foam, data = simulation.scene.foam, simulation.data
    assert foam is not None
    site, camera = data.site(f"region_{region}"), data.cam("overhead")
    at = site.xpos + site.xmat.reshape(3, 3) @ foam.middle
    ahead = (camera.xmat.reshape(3, 3) @ np.diag([1.0, -1.0, -1.0])).T @ (at - camera.xpos)
    return (renderer.intrinsics("overhead") @ ahead)[:2] / ahead[2]


def first_picture(protocol: Protocol, task_id: str, seed: int) -> tuple[np.ndarray, Simulation, np.ndarray]:
    """The overhead picture at t = 0, the world, and where the foam should be."""
    simulation, _, _ = settled_world(protocol, task_id=task_id, seed=seed)
    simulation.refresh()
    with SceneRenderer(simulation.model, protocol=simulation.protocol) as renderer:
        middle = place_px(simulation, renderer, protocol.task(task_id).region)
        return renderer.rgb(simulation.data, "overhead"), simulation, middle


@pytest.mark.parametrize(("task_id", "seed"), [("T1", 1), ("T5", 0), ("T7", 0)])
def test_a_threshold_finds_the_foam_on_the_named_limb_and_nowhere_before(task_id: str, seed: int) -> None:
    """A slow test looks at every task of 27 seeds."""
    picture, simulation, middle = first_picture(FOAMY, task_id, seed)
    foam = simulation.scene.foam
    assert foam is not None
    found = np.argwhere(pixels_of(foam.colour, picture))[:, ::-1]
    assert len(found) > 40
    assert np.linalg.norm(found - middle, axis=1).max() < NEAR_PX
    foam.paint(simulation.model, np.zeros(len(foam.cell_share)))
    with SceneRenderer(simulation.model, protocol=simulation.protocol) as renderer:
        assert not pixels_of(foam.colour, renderer.rgb(simulation.data, "overhead")).any()


def test_the_draw_is_the_same_on_all_levels_and_for_both_tasks_on_a_region() -> None:
    patches = [
        settled_world(LEVELS[level], task_id=task_id, seed=1)[0].scene.foam
        for level, task_id in (("L1", "T1"), ("L3", "T1"), ("L1", "T3"))
    ]
    first, alive, scrub = patches
    assert first is not None
    assert alive is not None
    assert scrub is not None
    np.testing.assert_array_equal(first.middle, alive.middle)
    assert first.colour == alive.colour == scrub.colour
    other = settled_world(FOAMY, task_id="T1", seed=0)[0].scene.foam
    assert other is not None
    assert abs(other.middle[0] - first.middle[0]) > 1e-3
    assert settled_world(FOAMY, task_id="T2", seed=1)[0].scene.foam is None


@dataclass(frozen=True, kw_only=True)
class Wiped:
    """A trial that wipes along the foam and looks once a second."""

    spec: TrialSpec
    recording: Recording
    pictures: list[np.ndarray]
    looks: list[LoggedLook]
    left: np.ndarray
    """(C,) as the trial had it at the end"""
    colour: tuple[int, int, int]
    world: Callable[[TrialSpec], World]
    """The same world again, on the same compiled model; without the foam where the trial has none."""


STROKES, DEEP_M, HALF_WAY_M = 5, 0.012, 0.045


def wipe(spec: TrialSpec, prepare: Callable[[TrialSpec], World]) -> Wiped:
    pictures, states = list[np.ndarray](), list[Any]()
    with Episode(spec, card=CARD, prepare=prepare) as episode:
        observation = episode.reset()
        simulation = episode.simulation
        reader, foam = StateReader(simulation), simulation.scene.foam
        assert foam is not None

        def keep(seen: Any) -> None:
            pictures.append(seen.cameras["overhead"].rgb)
            states.append((seen.sim_time_s, episode.raw, reader.read()))

        keep(observation)
        site = simulation.data.site(f"region_{episode.task.region}")
        turn = site.xmat.reshape(3, 3)
        in_base = simulation.encoders.in_base
        middle = in_base(simulation.data, site.xpos + turn @ foam.middle, np.eye(3))[:3, 3]
        end = in_base(simulation.data, site.xpos + turn @ (foam.middle + HALF_WAY_M * foam.axes[:, 0]), np.eye(3))[
            :3, 3
        ]
        quat, start = radial_quat(middle), simulation.control.target_in_base
        ways = [middle - DEEP_M * UP + way * (end - middle) for way in ([-1.0, 1.0] * STROKES)[:STROKES]]
        legs = [Leg(points=point[None], quat_wxyz=quat, speed_m_s=0.12) for point in ways]
        away = Leg(points=(start[:3])[None], quat_wxyz=quat, speed_m_s=0.25)
        poses = list(sample(travel(start, [*legs, away], travel_height_m=float(middle[2]) + 0.12)[:-1], start))
        for number, pose in enumerate(poses):
            last = number == len(poses) - 1
            step = episode.step(Action(pose_tcp_in_base=pose), observe=number % 20 == 19 or last)
            if step.observation is not None:
                keep(step.observation)
        episode.step(Action(done=True), observe=False)
        assert episode._foam._wiping is not None
        left, recording = episode._foam._wiping.left, episode.finish()
    found = RecordedWiping.of(recording)
    assert found is not None
    looks = [
        LoggedLook(sim_time_s=time_s, raw=raw, sent=b"", state=state, foam_left=found.until(time_s).left)
        for time_s, raw, state in states
    ]
    return Wiped(
        spec=spec, recording=recording, pictures=pictures, looks=looks, left=left, colour=foam.colour, world=prepare
    )


@pytest.fixture(scope="module")
def wiped() -> Wiped:
    spec = TrialSpec(protocol=STILL, task_id="T7", seed=5, policy="wipe")
    simulation, settled, sha256 = settled_world(STILL, task_id="T7", seed=5)
    state = simulation.integration_state()

    def prepare(spec: TrialSpec) -> World:
        foam = simulation.scene.foam if spec.protocol.foam else None
        again = Simulation(replace(simulation.scene, foam=foam))
        again.restore(state, comfort_arm_deg=settled.comfort_arm_deg)
        return again, settled, sha256

    return wipe(spec, prepare)


def test_wiped_foam_fades_for_a_later_look(wiped: Wiped) -> None:
    seen = [int(pixels_of(wiped.colour, picture).sum()) for picture in wiped.pictures]
    assert seen[0] > 100
    assert seen[-1] < 0.6 * seen[0], "the robot has gone, and most of the foam with it"
    assert wiped.left.min() == 0.0
    found = RecordedWiping.of(wiped.recording)
    assert found is not None
    assert 0.2 < found.until(np.inf).cleaned < 0.9


def test_the_picture_of_fading_is_the_golden_one(wiped: Wiped) -> None:
    """Before and after; to draw it again, save ``shown``. Another renderer shades by a few levels otherwise."""
    spots = np.argwhere(pixels_of(wiped.colour, wiped.pictures[0]))
    low = (spots.min(0) + spots.max(0)) // 2 - 32
    shown = np.hstack([p[low[0] : low[0] + 64, low[1] : low[1] + 64] for p in (wiped.pictures[0], wiped.pictures[-1])])
    golden = np.asarray(Image.open(GOLDEN))
    assert shown.shape == golden.shape
    assert (np.abs(shown.astype(int) - golden).max(axis=2) > 12).mean() < 0.02


def test_what_is_left_follows_from_the_recording(wiped: Wiped) -> None:
    found = RecordedWiping.of(wiped.recording)
    assert found is not None
    np.testing.assert_array_equal(found.until(np.inf).left, wiped.left)


def test_a_second_trial_in_the_same_world_begins_with_all_of_the_foam(wiped: Wiped) -> None:
    """The trial before it left the model's texture half wiped."""
    with Episode(wiped.spec, card=CARD, prepare=wiped.world) as episode:
        again = episode.reset().cameras["overhead"].rgb
    assert again is not None
    np.testing.assert_array_equal(again, wiped.pictures[0])


def test_the_audit_draws_the_same_pictures_and_finds_foam_that_does_not_fade(
    wiped: Wiped, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a process of its own it builds another world; here it does so beside the first one, with its OpenGL."""
    monkeypatch.setattr(redraw, "GLContext", import_opengl())
    spec, world = wiped.spec, redraw._World(wiped.spec)
    noise, known = sensor_noise(spec.protocol, spec.seed), calibration(spec.protocol, spec.seed)
    for look in (wiped.looks[0], wiped.looks[-1]):
        assert world.differences(look, noise, known) == []
    stuck = replace(wiped.looks[-1], foam_left=wiped.looks[0].foam_left)
    assert [place for place, _ in world.differences(stuck, noise, known)] == ["observation.cameras.overhead.rgb"]


def test_a_film_shows_the_foam_fade(wiped: Wiped) -> None:
    """With another model of the person, whose skin is finer."""
    film = Film(wiped.recording, view="overhead", fps=1.0, grid=False, shadows=False, panel=False, size=(640, 480))
    seen = [int(pixels_of(wiped.colour, frame).sum()) for frame in film.frames()]
    assert seen[0] > 100
    assert seen[-1] < 0.6 * seen[0]


def test_foam_is_a_colour_and_nothing_else(wiped: Wiped) -> None:
    """The same actions without foam give the same forces, states and depth images, and a scrub in other words."""
    bare = STILL.model_copy(update={"foam": None})
    spec = wiped.spec.model_copy(update={"protocol": bare})
    taken = wiped.recording["actions/pose_tcp_in_base"]
    poses = [pose for pose in taken if np.isfinite(pose).all()][:60]
    with Episode(spec, card=CARD, prepare=wiped.world) as episode:
        assert episode.instruction == "gently scrub the abdomen"
        depth = [episode.reset().cameras["overhead"].depth]
        for number, pose in enumerate(poses):
            seen = episode.step(Action(pose_tcp_in_base=pose), observe=number in (19, 39, 59)).observation
            depth += [] if seen is None else [seen.cameras["overhead"].depth]
        episode.step(Action(done=True), observe=False)
        plain = episode.finish()
    assert not [path for path in plain.arrays if "foam" in path]
    steps = len(plain["scorer/time_s"]) - 25
    for path in ("scorer/force_human_from_robot_in_world", "scorer/pose_tcp_in_world", "scorer/human_joint_position"):
        np.testing.assert_array_equal(plain[path][:steps], wiped.recording[path][:steps])
    assert plain.header.sha256 == wiped.recording.header.sha256
    for mine, look in zip(depth, wiped.looks, strict=False):
        assert mine is not None
        np.testing.assert_array_equal(mine, look.raw.views["overhead"].depth)


def test_progress_knows_what_was_cleaned(wiped: Wiped) -> None:
    """Where nothing is recorded, too."""
    taken = wiped.recording["actions/pose_tcp_in_base"]
    with Episode(wiped.spec, card=CARD, prepare=wiped.world, record=False) as episode:
        episode.privileged = True
        episode.reset()
        for pose in taken:
            if np.isfinite(pose).all():
                episode.step(Action(pose_tcp_in_base=pose), observe=False)
        share = episode.progress().share
    found, gate = RecordedWiping.of(wiped.recording), STILL.gates.foam
    assert found is not None
    assert gate is not None
    assert 0.0 < share <= found.until(np.inf).cleaned / gate.cleaned_share + 1e-9
