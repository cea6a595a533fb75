from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from carecontact.audit.hidden_values import (
    HIDDEN_OF_MODEL,
    audit_start,
    other_arm_angle,
    scrambled_model,
    without_noise,
)
from carecontact.audit.run import audit_derivation, audit_readings, two_starts
from carecontact.audit.watched import watch
from carecontact.episode.episode import Episode
from carecontact.episode.randomization import World, draw, drawn, settled_world
from carecontact.interface.observation import Observation
from carecontact.interface.robot import Session
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from carecontact.sensing import segmentation
from carecontact.sensing.builder import ObservationBuilder, RawView
from carecontact.sim.rendering import SceneRenderer
from carecontact.sim.simulation import Simulation
from carecontact.sim.state import Proprioception
from carecontact.world.scene import build_scene


@pytest.mark.parametrize("own_deg", [45.0, 60.0])
def test_the_other_arm_lies_far_from_where_the_arm_is_and_not_from_where_its_seed_drew_it_first(own_deg: float) -> None:
    """A person who does not suit the robot is drawn again, so that the angle is not the seed's first draw."""
    protocol = load_protocol("bathing-v3")
    spec = TrialSpec(protocol=protocol, task_id="T1", seed=0, policy="hover")
    other = other_arm_angle(spec, own_deg=own_deg)
    angle = draw(protocol, region="forearm", seed=other.seed).comfort_arm_deg
    assert other.seed != spec.seed
    assert abs(angle - own_deg) > 9.0


# A world whose hidden mechanics are random numbers is still one that can be drawn.


@pytest.mark.parametrize(
    ("protocol", "level"),
    [("bathing-v3", None), ("bathing-wide-v2", "L3")],
)
def test_the_compiled_tissue_takes_every_scrambled_model(protocol: str, level: str | None) -> None:
    model = build_scene(load_protocol(protocol, level=level), target="forearm", skin=False).model
    for seed in range(8):
        other = scrambled_model(model, np.random.default_rng(seed))
        mujoco.MjData(other)
    for name in HIDDEN_OF_MODEL:
        assert (getattr(other, name) != getattr(model, name)).any(), name


# What a policy must not know on the exam's hardest level: true camera poses, the bed's exact height, the phase of
# breath, what the person does next. Each is planted, and the audit names the place.

OVERHEAD = "observation.cameras.overhead"


LONG = load_protocol("bathing-wide-v2", level="L3")
SHORT = LONG.model_copy(update={"phases": LONG.phases.model_copy(update={"time_limit_s": 0.1})})
SPEC = TrialSpec(protocol=SHORT, task_id="T1", seed=1, policy="hover", salt="5a" * 32)


@pytest.fixture(scope="module")
def begin() -> Callable[[TrialSpec], World]:
    """The same settled, breathing person for every trial."""
    simulation, settled, sha256 = settled_world(LONG, task_id="T1", seed=1, salt=SPEC.salt)
    state = simulation.integration_state()

    def prepare(spec: TrialSpec) -> World:
        fresh = Simulation(simulation.scene)
        fresh.restore(state, comfort_arm_deg=settled.comfort_arm_deg)
        return fresh, settled, sha256

    return prepare


def hidden(model: mujoco.MjModel) -> dict[str, float]:
    """Phase of the breath at t = 0, and when the person moves its arm next [s]."""
    numbers = {name: model.numeric(f"life/{name}").data for name in ("breath", "moves")}
    assert numbers["moves"][1] > 0, "the person does move"
    return {"phase": float(numbers["breath"][2]), "next": float(numbers["moves"][0])}


@contextmanager
def planted(where: str) -> Iterator[None]:
    raw_view, build, plane = ObservationBuilder.raw_view, ObservationBuilder.build, segmentation.bed_plane
    speed, rgb = Proprioception.joint_velocity, SceneRenderer.rgb

    def true_pose(self: ObservationBuilder, data: mujoco.MjData, camera: str, **known: Any) -> RawView:
        raw = raw_view(self, data, camera, **known)
        return dataclasses.replace(raw, pose_camera_in_base=self._renderer.pose_camera_in_base(data, camera))

    def sent(self: ObservationBuilder, data: mujoco.MjData, **known: Any) -> Observation:
        seen = build(self, data, **known)
        true = self._renderer.pose_camera_in_base(data, "overhead")
        view = dataclasses.replace(seen.cameras["overhead"], pose_camera_in_base=true)
        phase = np.array([1e-3 * hidden(data.model)["phase"]])
        return dataclasses.replace(seen, cameras={"overhead": view}, gripper_position=phase)

    def exact_bed(points: np.ndarray, **known: Any) -> np.ndarray:
        assert plane(points, **known) is not None
        scene = drawn(SPEC).protocol.scene
        return np.array([0.0, 0.0, scene.mattress_top_m - scene.robot_base_m[2]])

    def phase_in_speed(self: Proprioception, data: mujoco.MjData) -> np.ndarray:
        return speed(self, data) + 1e-12 * hidden(data.model)["phase"]

    def phase_in_picture(self: SceneRenderer, data: mujoco.MjData, camera: str) -> np.ndarray:
        image = rgb(self, data, camera)
        image[0, 0] = image[0, 0] // 2 + int(100 * hidden(data.model)["phase"])
        return image

    leaks: dict[str, list[tuple[Any, str, Any]]] = {
        "readings": [
            (ObservationBuilder, "raw_view", true_pose), (Proprioception, "joint_velocity", phase_in_speed),
            (SceneRenderer, "rgb", phase_in_picture),
        ],
        "message": [(segmentation, "bed_plane", exact_bed), (ObservationBuilder, "build", sent)],
    }  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        for leak in leaks[where]:
            patch.setattr(*leak)
        yield


FOUND = {
    "readings": (
        {f"{OVERHEAD}.pose_camera_in_base"},
        {f"{OVERHEAD}.pose_camera_in_base", f"{OVERHEAD}.rgb", "observation.joint_velocity"},
    ),
    "message": (
        {
            f"{OVERHEAD}.pose_camera_in_base", f"{OVERHEAD}.masks.bed", f"{OVERHEAD}.masks.background",
            "observation.gripper_position",
        },
        set[str](),
    ),
}  # fmt: skip
"""Where leaks are planted -> the places that the re-derivation names, and those that the readings name: no others."""


def test_each_leak_is_named_and_nothing_else(begin: Callable[[TrialSpec], World], tmp_path: Path) -> None:
    for where in FOUND:
        with planted(where):
            seen = watch(SPEC, policy="hover", prepare=begin, log=tmp_path / where)
        assert seen.error is None
    parts = audit_derivation(tmp_path, []), audit_readings(tmp_path, [])
    named = {w: tuple({f.place for f in part.findings if f" {w}:" in f.detail} for part in parts) for w in FOUND}
    assert named == FOUND


def test_a_next_movement_in_the_session(begin: Callable[[TrialSpec], World], tmp_path: Path) -> None:
    class Parked:
        scene = begin(SPEC)[0].scene
        parked_pose = begin(SPEC)[0].control.target_in_base
        laid_at_deg = begin(SPEC)[1].comfort_arm_deg
        parked = staticmethod(begin)

    session, quiet = Episode.session, SPEC.model_copy(update={"protocol": without_noise(LONG)})
    with pytest.MonkeyPatch.context() as patch:

        def leaky(self: Episode) -> Session:
            facts = session.__get__(self)
            return dataclasses.replace(facts, time_limit_s=facts.time_limit_s + hidden(self.simulation.model)["next"])

        patch.setattr(Episode, "session", property(leaky))
        starts = two_starts(quiet, Parked, folder=tmp_path)  # pyright: ignore[reportArgumentType]
    assert {f.place for f in audit_start(*starts).findings} == {"session.time_limit_s"}
