"""Every part of the audit catches the cheat it is for, and names the place; without a cheat all of them pass."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from carecontact.audit.hidden_values import (
    CONTROL,
    audit_canary,
    audit_frozen,
    audit_handshake,
    audit_start,
    other_hidden_values,
    without_noise,
)
from carecontact.audit.run import audit_derivation, two_starts
from carecontact.audit.schema import audit_schema
from carecontact.audit.watched import CONTROL_HZ, Keyframe, Watched, press, watch
from carecontact.episode.episode import Episode
from carecontact.episode.perception import PerceptionLog
from carecontact.interface.observation import Observation
from carecontact.interface.policy import PolicyCard
from carecontact.interface.robot import Session
from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording.notes import JOINTS
from carecontact.sensing.builder import ObservationBuilder
from carecontact.serving import process
from carecontact.sim.rendering import SceneRenderer
from carecontact.sim.simulation import Simulation
from carecontact.sim.state import Proprioception
from tests.audit.conftest import BLIND, Press, places, send_a_privileged_key


def touched(data: mujoco.MjData) -> float:
    """[N] what the tool's contact sensors say, all of them together."""
    return float(np.abs(data.sensordata).sum()) if data.ncon else 0.0


def short(spec: TrialSpec) -> TrialSpec:
    phases = spec.protocol.phases.model_copy(update={"time_limit_s": 0.1})
    return spec.model_copy(update={"protocol": spec.protocol.model_copy(update={"phases": phases})})


def test_a_privileged_key_on_the_wire(monkeypatch: pytest.MonkeyPatch, keyframe: Keyframe, spec: TrialSpec) -> None:
    send_a_privileged_key(monkeypatch)
    seen = watch(
        short(spec).model_copy(update={"policy": "zero-action"}), policy="zero-action", prepare=keyframe.parked
    )
    part = audit_schema([seen])
    assert not part.passed
    assert [(f.policy, f.place) for f in part.findings] == [("zero-action", "observation.contact_force")]
    assert "unknown key contact_force" in part.findings[0].detail


def test_landmarks_of_the_simulator(
    monkeypatch: pytest.MonkeyPatch, keyframe: Keyframe, spec: TrialSpec, tmp_path: Path
) -> None:
    honest = ObservationBuilder.build

    def leaky(self: ObservationBuilder, data: mujoco.MjData, **known: Any) -> Observation:
        seen = honest(self, data, **known)
        view = seen.cameras["overhead"]
        assert view.landmarks is not None
        joints = PerceptionLog(keyframe.scene.model, self._renderer).joints_in_base(data)
        perfect = view.landmarks.copy()
        for name, row in JOINTS.items():
            in_camera = view.pose_camera_in_base[:3, :3].T @ (joints[name] - view.pose_camera_in_base[:3, 3])
            perfect[row, :2] = (view.intrinsics @ in_camera)[:2] / in_camera[2]
        return dataclasses.replace(seen, cameras={"overhead": dataclasses.replace(view, landmarks=perfect)})

    monkeypatch.setattr(ObservationBuilder, "build", leaky)
    seen = watch(
        short(spec).model_copy(update={"policy": "hover"}),
        policy="hover", prepare=keyframe.parked, log=tmp_path / "logs" / "hover",
    )  # fmt: skip
    assert seen.error is None
    part = audit_derivation(tmp_path / "logs", [])
    assert places(part) == {"observation.cameras.overhead.landmarks"}
    assert {f.policy for f in part.findings} == {"hover"}


def test_forces_that_show_only_after_contact(
    monkeypatch: pytest.MonkeyPatch, blind_press: Press, tmp_path: Path
) -> None:
    honest, honest_pose = ObservationBuilder.build, Proprioception.pose_tcp_in_base

    def leaky(self: ObservationBuilder, data: mujoco.MjData, **known: Any) -> Observation:
        seen = honest(self, data, **known)
        return dataclasses.replace(seen, gripper_position=np.array([touched(data)]))

    def leaky_pose(self: Proprioception, data: mujoco.MjData) -> np.ndarray:
        pose = honest_pose(self, data)
        pose[0, 3] += 1e-9 * touched(data)
        return pose

    monkeypatch.setattr(ObservationBuilder, "build", leaky)
    monkeypatch.setattr(Proprioception, "pose_tcp_in_base", leaky_pose)
    pressed = blind_press()
    assert pressed.error is None
    part = audit_derivation(tmp_path / "logs", [pressed])
    assert places(part) == {"observation.gripper_position", "observation.pose_tcp_in_base"}
    assert part.counts["observations in contact"] >= 3


@pytest.fixture
def at_contact(keyframe: Keyframe, spec: TrialSpec) -> Simulation:
    simulation, _, _ = keyframe.near(spec)
    for pose in keyframe.poses:
        simulation.set_goal(pose, 1 / CONTROL_HZ)
        simulation.advance(round(1 / CONTROL_HZ / simulation.model.opt.timestep))
    return simulation


def test_a_force_in_an_encoder_s_reading(monkeypatch: pytest.MonkeyPatch, at_contact: Simulation) -> None:
    honest = Proprioception.joint_velocity
    part = audit_frozen(at_contact, [BLIND], instruction="touch")
    assert part.passed, part

    def leaky(self: Proprioception, data: mujoco.MjData) -> np.ndarray:
        return honest(self, data) + 1e-12 * touched(data)

    monkeypatch.setattr(Proprioception, "joint_velocity", leaky)
    part = audit_frozen(at_contact, [BLIND], instruction="touch")
    assert places(part) == {"observation.joint_velocity"}


def test_a_force_in_the_corner_of_a_picture(monkeypatch: pytest.MonkeyPatch, at_contact: Simulation) -> None:
    honest = SceneRenderer.rgb

    def leaky(self: SceneRenderer, data: mujoco.MjData, camera: str) -> np.ndarray:
        image = honest(self, data, camera)
        image[0, 0] = int(touched(data)) % 251
        return image

    monkeypatch.setattr(SceneRenderer, "rgb", leaky)
    part = audit_frozen(at_contact, [PolicyCard(name="seeing", modalities=("rgb",))], instruction="touch")
    assert places(part) == {"observation.cameras.overhead.rgb"}


@pytest.fixture(scope="module")
def leaky_pair(
    keyframe: Keyframe, spec: TrialSpec, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Watched, Watched]:
    """A press in two worlds.

    The seed leaks through session, environment and options, the stiffness through a joint's speed.
    """
    folder = tmp_path_factory.mktemp("witness")
    build, session, environment = ObservationBuilder.build, Episode.session, process._environment
    options = process._options
    seeds: list[int] = []

    def leaky_build(self: ObservationBuilder, data: mujoco.MjData, **known: Any) -> Observation:
        seen = build(self, data, **known)
        hidden = 1e-15 * float(self._renderer._model.numeric_data.sum())
        return dataclasses.replace(seen, joint_velocity=seen.joint_velocity + hidden)

    def leaky_session(self: Episode) -> Session:
        seeds.append(self.spec.seed)
        honest = session.__get__(self)
        return dataclasses.replace(honest, time_limit_s=honest.time_limit_s + 1e-9 * self.spec.seed)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ObservationBuilder, "build", leaky_build)
        patch.setattr(Episode, "session", property(leaky_session))
        pair: list[Watched] = []
        for one, prepare in ((spec, keyframe.near), (other_hidden_values(spec), keyframe.twin)):
            run = f"run {one.trial_id}"
            patch.setattr(process, "_environment", lambda setup, run=run: {**environment(setup), "LANG": run})
            patch.setattr(process, "_options", lambda *args, run=run, **fds: {**options(*args, **fds), "run": run})
            pair.append(
                press(one, card=BLIND, poses=keyframe.poses, prepare=prepare, actions_per_look=1, folder=folder)
            )
    assert [watched.error for watched in pair] == [None, None]
    assert len(set(seeds)) == 2
    return pair[0], pair[1]


def test_the_seed_in_the_handshake(leaky_pair: tuple[Watched, Watched]) -> None:
    part = audit_handshake(*leaky_pair)
    assert not part.passed
    assert places(part) == {"session.time_limit_s", "environment.LANG", "options.run"}
    assert any("T1-s000" in finding.detail for finding in part.findings)


def test_the_person_s_arm_in_session_and_encoders(
    monkeypatch: pytest.MonkeyPatch, keyframe: Keyframe, spec: TrialSpec, tmp_path: Path
) -> None:
    honest = two_starts(spec, keyframe, folder=tmp_path)
    part = audit_start(*honest)
    assert part.passed, part
    begin, session, speed = Episode.__init__, Episode.session, Proprioception.joint_velocity
    settled_deg: list[float] = []

    def leaky_begin(self: Episode, spec: TrialSpec, **rest: Any) -> None:
        begin(self, spec, **rest)
        settled_deg.append(self._world.settled.comfort_arm_deg)

    def leaky_session(self: Episode) -> Session:
        facts = session.__get__(self)
        return dataclasses.replace(facts, time_limit_s=facts.time_limit_s + 1e-6 * self.simulation.comfort_arm_deg())

    monkeypatch.setattr(Episode, "__init__", leaky_begin)
    monkeypatch.setattr(Episode, "session", property(leaky_session))
    monkeypatch.setattr(Proprioception, "joint_velocity", lambda self, data: speed(self, data) + 1e-9 * settled_deg[-1])
    part = audit_start(*two_starts(spec, keyframe, folder=tmp_path))
    assert places(part) == {"session.time_limit_s", "observation.joint_velocity"}
    assert abs(settled_deg[0] - settled_deg[1]) > 2
    # The same person twice would have shown nothing.
    assert audit_start(honest[0], honest[0]).missing == ["starts with the arm at another angle"]


def test_on_the_exam_each_task_has_its_own_foam_and_a_parked_robot_shows_nothing_of_the_person(tmp_path: Path) -> None:
    """The robot's joints have dry friction, and so the last digits of their readings depend on the solver."""
    spec = TrialSpec(protocol=load_protocol("bathing-wide-v2", level="L1"), task_id="T1", seed=0, policy="")
    exam = Keyframe(spec.protocol, task_id="T1", seed=0)
    quiet = spec.model_copy(update={"protocol": without_noise(spec.protocol)})
    assert audit_start(*two_starts(quiet, exam, folder=tmp_path)).passed
    touch, scrub = (exam.parked(spec.model_copy(update={"task_id": task}))[0].scene.foam for task in ("T1", "T3"))
    assert touch is not None
    assert scrub is not None
    assert len(touch.texel) != len(scrub.texel)


def test_the_stiffness_in_a_field_that_needs_no_image(leaky_pair: tuple[Watched, Watched]) -> None:
    part = audit_canary(*leaky_pair)
    assert places(part) == {"observation.joint_velocity"}
    assert part.counts["observations before contact"] == 7
    assert part.counts["scorer samples that differ after contact"] > 50


def test_a_canary_that_could_not_sing_has_not_passed(leaky_pair: tuple[Watched, Watched]) -> None:
    part = audit_canary(leaky_pair[0], leaky_pair[0])
    assert places(part) == {CONTROL}
    assert not part.passed


def test_without_a_log_nothing_was_made_again(tmp_path: Path) -> None:
    part = audit_derivation(tmp_path, [])
    assert part.findings == ()
    assert not part.passed
    assert part.missing == ["observations", "observations in contact", "bytes"]
