"""Time, encoders, poses and pictures are checked against the recorded state, to the last bit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from carecontact.audit.run import audit_derivation, audit_readings, cards_of
from carecontact.audit.watched import Keyframe, Watched, press
from carecontact.human.skeleton import body_name
from carecontact.interface.observation import Observation
from carecontact.interface.policy import PolicyCard
from carecontact.protocol.protocol import TrialSpec
from carecontact.protocol.sections import Variation
from carecontact.sensing.builder import ObservationBuilder, SensorNoise
from carecontact.sim.rendering import SceneRenderer
from carecontact.sim.state import Proprioception
from tests.audit.conftest import LastForce, Press, places

LATE = 8
MOVING = PolicyCard(name="moving", cameras=(), tool_velocity=True)


def test_forces_in_time_speed_and_the_last_bits_of_a_pose(
    monkeypatch: pytest.MonkeyPatch, last_force: LastForce, blind_press: Press, tmp_path: Path
) -> None:
    build, speed, pose = ObservationBuilder.build, Proprioception.joint_velocity, Proprioception.pose_tcp_in_base
    looks: list[float] = []

    def leaky(self: ObservationBuilder, data: mujoco.MjData, **known: Any) -> Observation:
        looks.append(known["sim_time_s"])
        known["sim_time_s"] += 1e-9 * last_force.newton
        return build(self, data, **known)

    def leaky_speed(self: Proprioception, data: mujoco.MjData) -> np.ndarray:
        # Hidden, but not before the eighth look.
        return speed(self, data) + 1e-12 * (len(looks) >= LATE)

    def leaky_pose(self: Proprioception, data: mujoco.MjData) -> np.ndarray:
        found = pose(self, data)
        found[0, 3] += 1e-14 * last_force.newton
        return found

    monkeypatch.setattr(ObservationBuilder, "build", leaky)
    monkeypatch.setattr(Proprioception, "joint_velocity", leaky_speed)
    monkeypatch.setattr(Proprioception, "pose_tcp_in_base", leaky_pose)
    pressed = blind_press()
    assert pressed.error is None
    # It is made of nothing but its readings, and so the re-derivation has no eye for it.
    assert audit_derivation(tmp_path / "logs", [pressed]).passed
    part = audit_readings(tmp_path / "logs", [pressed])
    fields = {"observation.sim_time_s", "observation.joint_velocity", "observation.pose_tcp_in_base"}
    assert places(part) == fields | {"policy/observation_time_s"}
    late = {f.detail.split()[1] for f in part.findings if f.place == "observation.joint_velocity"}
    assert late == {f"{time_s:.3f}" for time_s in looks[LATE - 1 :]}
    assert part.counts == {"looks": len(looks), "looks timed": len(looks)}


def test_forces_in_the_last_bits_of_the_tool_s_velocity(
    monkeypatch: pytest.MonkeyPatch, last_force: LastForce, keyframe: Keyframe, spec: TrialSpec, tmp_path: Path
) -> None:
    honest = Proprioception.velocity_tcp_in_base

    def pressed(name: str) -> None:
        seen = press(
            spec, card=MOVING, poses=keyframe.poses, prepare=keyframe.near, actions_per_look=8,
            folder=tmp_path / "witness", log=tmp_path / name,
        )  # fmt: skip
        assert seen.error is None

    def leaky(self: Proprioception, data: mujoco.MjData, joint_velocity: np.ndarray) -> np.ndarray:
        return honest(self, data, joint_velocity) * (1 + 1e-14 * last_force.newton)

    pressed("honest/trial")
    assert audit_readings(tmp_path / "honest", []).findings == ()
    monkeypatch.setattr(Proprioception, "velocity_tcp_in_base", leaky)
    pressed("leaky/trial")
    assert places(audit_readings(tmp_path / "leaky", [])) == {"observation.velocity_tcp_in_base"}


def test_what_a_picture_cannot_show(
    monkeypatch: pytest.MonkeyPatch, last_force: LastForce, keyframe: Keyframe, spec: TrialSpec, tmp_path: Path
) -> None:
    """The true elbow in the first pixels, the simulator's labels in the empty cell, forces in both depths."""
    seeing = PolicyCard(name="seeing", modalities=("rgb", "masks"))
    logs, poses = tmp_path / "logs", keyframe.poses

    def pressed(name: str) -> None:
        seen = press(
            spec, card=seeing, poses=poses, prepare=keyframe.near, actions_per_look=8, folder=tmp_path / "witness",
            log=logs / name,
        )  # fmt: skip
        assert seen.error is None
        assert seen.looks_in_contact == 1

    pressed("honest")
    rgb, depth, robot, truth = (getattr(SceneRenderer, n) for n in ("rgb", "depth", "robot_depth", "truth"))
    seen_now: list[mujoco.MjData] = []

    def leaky_rgb(self: SceneRenderer, data: mujoco.MjData, camera: str) -> np.ndarray:
        image = rgb(self, data, camera)
        elbow = np.asarray(data.body(body_name("right_forearm")).xpos, "<f8")
        image[0, :8] = np.frombuffer(elbow.tobytes(), np.uint8).reshape(8, 3)
        return image

    def leaky_depth(self: SceneRenderer, data: mujoco.MjData, camera: str) -> np.ndarray:
        seen_now.append(data)
        image = depth(self, data, camera)
        image[0, 0] = np.nextafter(image[0, 0], np.float32(9)) if last_force.newton else image[0, 0]
        return image

    def leaky_robot(self: SceneRenderer, angles: Any, camera: str) -> np.ndarray:
        return robot(self, angles, camera) + np.float32(1e-3 * last_force.newton)

    def leaky_cell(self: SceneRenderer, angles: Any, camera: str) -> np.ndarray:
        true = truth(self, seen_now[-1], camera)
        return np.where(true.human, np.float32(6), true.depth - np.float32(0.02)).astype(np.float32)

    leaks = {"rgb": leaky_rgb, "depth": leaky_depth, "robot_depth": leaky_robot, "cell_depth": leaky_cell}
    for name, leak in leaks.items():
        monkeypatch.setattr(SceneRenderer, name, leak)
    last_force.newton = 0.0
    pressed("leaky")
    part = audit_readings(logs, [])
    found = {
        (f.place.removeprefix("observation.cameras.overhead."), *f.detail.split()[1::3][:2]) for f in part.findings
    }
    before, after = "0.000", "0.400"
    assert found == {
        *((image, time_s, "leaky:") for image in ("rgb", "cell_depth") for time_s in (before, after)),
        *((image, after, "leaky:") for image in ("depth", "robot_depth")),
    }
    assert part.counts["images drawn again"] == 2 * 2 * 4


def test_declared_noise_is_no_leak_and_no_hiding_place(
    monkeypatch: pytest.MonkeyPatch, keyframe: Keyframe, spec: TrialSpec, tmp_path: Path
) -> None:
    noisy = spec.protocol.model_copy(
        update={"variation": Variation(depth_noise="structured-light-v1", encoder_noise_rad=1e-3)}
    )
    card, honest = replace(MOVING, modalities=("depth",), cameras=("wrist",)), SensorNoise.joint_position

    def start(name: str) -> None:
        seen = press(
            spec.model_copy(update={"protocol": noisy}), card=card, poses=keyframe.parked_pose[None],
            prepare=keyframe.parked, actions_per_look=1, folder=tmp_path / "witness", log=tmp_path / "logs" / name,
        )  # fmt: skip
        assert seen.error is None

    def leaky(self: SensorNoise, joint_position: np.ndarray, *, sim_time_s: float) -> np.ndarray:
        return honest(self, joint_position, sim_time_s=sim_time_s) * (1 + 1e-15 * keyframe.settled.comfort_arm_deg)

    start("honest")
    monkeypatch.setattr(SensorNoise, "joint_position", leaky)
    start("leaky")
    part = audit_readings(tmp_path / "logs", [])
    assert {f.detail.split()[4] for f in part.findings} == {"leaky:"}
    assert "observation.joint_position" in places(part)
    assert "observation.cameras.wrist.depth" not in places(part)


def test_without_a_log_nothing_was_read_again(tmp_path: Path) -> None:
    part = audit_readings(tmp_path, [])
    assert not part.passed
    assert part.missing == ["looks", "looks timed"]


def test_one_card_stands_for_many_policies(monkeypatch: pytest.MonkeyPatch) -> None:
    def card_of(trial: Watched) -> PolicyCard:
        return PolicyCard(name=trial.policy, modalities=("depth",) if trial.policy.endswith("1") else ("rgb", "masks"))

    monkeypatch.setattr(Watched, "card", property(card_of))
    trials = [Watched(policy=f"a-policy-with-a-long-name-{k}", task_id="T1", joints=7) for k in range(20)]
    (card,) = cards_of(trials, together=True)
    assert set(card.modalities) == {"rgb", "depth", "masks"}
    assert card.name.startswith("a-policy-with-a-long-name-0, ")
    assert card.name.endswith(" and others")
