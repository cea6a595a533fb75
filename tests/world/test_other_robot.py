"""Another robot than the shipped one, a primitive arm of six joints: it presses the person and becomes recordings.

No name and no number of it is that of the shipped arm, so that code which names one of those fails here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from carecontact.episode.episode import Episode
from carecontact.episode.randomization import World
from carecontact.errors import SceneError
from carecontact.interface.action import Action
from carecontact.interface.geometry import matrix_from_quat
from carecontact.interface.policy import PolicyCard
from carecontact.interface.regions import REGIONS
from carecontact.interface.robot import CONTROLS, EMBODIMENTS, Control, JointImpedance, Mjcf, Robot, Tip
from carecontact.lab.validation.subject import DOWN, in_base, move_to, surface_point
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden
from carecontact.protocol.protocol import Protocol, TrialSpec
from carecontact.recording import SEGMENTS, read_recording, write_recording
from carecontact.recording.lerobot import episode_of
from carecontact.scoring import score_recording
from carecontact.serving import codec
from carecontact.sim.impedance import target_in_base
from carecontact.sim.simulation import Samples, Simulation
from carecontact.world.scene import Scene, build_scene, controlled

ARM = """
<mujoco>
  <compiler angle="radian"/>
  <default><joint damping="1" armature="0.1" actuatorfrcrange="-90 90"/></default>
  <worldbody>
    <body name="stand"><geom type="cylinder" size="0.06 0.05" pos="0 0 0.05" mass="3" contype="0" conaffinity="0"/>
      <body name="column" pos="0 0 0.1"><joint name="turn" axis="0 0 1" range="-3 3"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.2" size="0.05" mass="4"/>
        <body name="upper" pos="0 0 0.2"><joint name="lift" axis="0 1 0" range="-2 2"/>
          <geom type="capsule" fromto="0 0 0 0 0 0.4" size="0.04" mass="4"/>
          <body name="lower" pos="0 0 0.4"><joint name="bend" axis="0 1 0" range="-2.8 2.8"/>
            <geom type="capsule" fromto="0 0 0 0 0 0.35" size="0.035" mass="3"/>
            <body name="roller" pos="0 0 0.4"><joint name="roll" axis="0 0 1" range="-3 3"/>
              <geom type="sphere" size="0.03" mass="1"/>
              <body name="nodder"><joint name="nod" axis="0 1 0" range="-2.5 2.5"/>
                <geom type="sphere" size="0.03" mass="1"/>
                <body name="mount" pos="0 0 0.05"><joint name="spin" axis="0 0 1" range="-6 6"/>
                  <geom type="capsule" fromto="0 0 0 0 0 0.06" size="0.012" mass="0.5"/>
                  <geom name="ball" type="sphere" size="0.015" pos="0 0 0.085" mass="0.1"/>
                  <site name="tool_point" pos="0 0 0.1"/>
  </body></body></body></body></body></body></body></worldbody>
  <actuator><motor joint="turn"/></actuator>
</mujoco>
"""
SIX = Robot(
    id="six-joints-ball",
    source=Mjcf(text=ARM),
    joints=("robot_turn", "robot_lift", "robot_bend", "robot_roll", "robot_nod", "robot_spin"),
    joint_low_rad=(-3.0, -2.0, -2.8, -3.0, -2.5, -6.0),
    joint_high_rad=(3.0, 2.0, 2.8, 3.0, 2.5, 6.0),
    base_body="robot_stand",
    flange_body="robot_mount",
    tcp_site="robot_tool_point",
    tip=Tip(geom="robot_ball", half_m=(0.015, 0.015, 0.015)),
    tcp_z_m=0.1,
    parked_joint_rad=(0.5, 0.1, 1.5, 0.0, float(np.pi) - 1.6, float(np.pi) + 0.5),
)
"""Its parked tool points down, with the hand's x along the base's as the shipped robot has it."""
SERVOS = JointImpedance(
    stiffness_nm_rad=(400.0,) * 6,
    damping_nms_rad=(80.0,) * 6,
    torque_limit_nm=(90.0,) * 6,
    velocity_limit_rad_s=(2.0,) * 6,
)
COMFORT_ARM_DEG, REGION = 52.5, "forearm"
OVERTRAVEL_M = 0.015


@pytest.fixture(scope="module")
def protocol() -> Iterator[Protocol]:
    with pytest.MonkeyPatch.context() as patch:
        for registry in (EMBODIMENTS, CONTROLS):
            patch.setattr(registry, "_rows", dict(registry._rows))
            patch.setattr(registry, "_origins", dict(registry._origins))
        EMBODIMENTS.register("ball", SIX)
        CONTROLS.register("six-servos", Control(description="stiff servos", joint=SERVOS))
        changes = {"scene.tool": "ball", "scene.parked_joint_rad": SIX.parked_joint_rad}
        yield overridden(load_protocol("bathing-v3"), changes)


@pytest.fixture(scope="module")
def scene(protocol: Protocol) -> Scene:
    return build_scene(protocol, target=REGION)


@pytest.fixture(scope="module")
def rested(scene: Scene) -> Callable[[TrialSpec], World]:
    """The settled world, the same for every caller."""
    simulation = Simulation(scene)
    settled, sha256 = simulation.settle(COMFORT_ARM_DEG), scene.model_sha256
    state = simulation.integration_state()

    def prepare(_: TrialSpec) -> World:
        fresh = Simulation(scene)
        fresh.restore(state, comfort_arm_deg=COMFORT_ARM_DEG)
        return fresh, settled, sha256

    return prepare


@pytest.fixture(scope="module")
def trial(protocol: Protocol) -> TrialSpec:
    return TrialSpec(protocol=protocol, task_id="T1", seed=0, policy="six")


def force_on(samples: list[Samples]) -> np.ndarray:
    """(S, 3) mean force [N] on each segment."""
    return np.concatenate([row.force for row in samples]).mean(0)


@pytest.mark.parametrize("region", [REGION, "abdomen"])
def test_it_presses_the_skin_with_the_force_of_its_impedance(
    rested: Callable[[TrialSpec], World], trial: TrialSpec, region: str
) -> None:
    simulation, settled, _ = rested(trial)
    assert settled.duration_s >= simulation.protocol.phases.settle_min_s
    assert simulation.encoders.joint_position(simulation.data) == pytest.approx(SIX.parked_joint_rad, abs=1e-3)
    top = surface_point(simulation, region)
    free = move_to(simulation, top + [0, 0, 0.08], seconds=3.0) + move_to(simulation, top + [0, 0, 0.02], seconds=1.0)
    assert not force_on(free).any()
    move_to(simulation, top - [0, 0, OVERTRAVEL_M], seconds=2.0)
    pressed = move_to(simulation, top - [0, 0, OVERTRAVEL_M], seconds=1.0)
    force, segment = force_on(pressed), SEGMENTS.index(REGIONS[region].segment)
    tool = simulation.data.site(SIX.tcp_site)
    above_target = tool.xpos[2] - (top[2] - OVERTRAVEL_M)
    # A spring between the tool and its target is what presses; the joints' friction bears the rest.
    stiffness = simulation.protocol.impedance.translational_n_m
    assert 2.0 < -force[segment, 2] < 6.0
    assert -force[segment, 2] == pytest.approx(stiffness * above_target, rel=0.1)
    assert not np.delete(force, segment, axis=0).any(), "nothing else of the person is touched"
    assert all(row.beside_normal is None or not row.beside_normal.any() for row in pressed), "the ball alone touches"
    assert np.linalg.norm((tool.xpos - top)[:2]) < 0.003
    assert tool.xmat.reshape(3, 3)[2, 2] < -0.999
    assert simulation.indentation()[simulation.protocol.regions.index(region)] > 0.003
    for name in ("qpos", "qvel", "plugin_state"):
        assert np.isfinite(getattr(simulation.data, name)).all()
    assert simulation.solver_warnings() == []
    goal = target_in_base(simulation.model, simulation.data, SIX)
    np.testing.assert_allclose(goal, [*in_base(simulation, top - [0, 0, OVERTRAVEL_M]), *DOWN], atol=1e-6)


def test_a_trial_of_poses_is_observed_recorded_and_scored(
    rested: Callable[[TrialSpec], World], trial: TrialSpec, tmp_path: Path
) -> None:
    card = PolicyCard(name="six", cameras=("overhead", "wrist"), modalities=("rgb", "depth", "masks"), control_hz=10)
    with Episode(trial, card=card, prepare=rested) as episode:
        top = in_base(episode.simulation, surface_point(episode.simulation, REGION))
        observation = codec.decode_observation(codec.encode_observation(episode.reset()))
        assert observation.joint_position == pytest.approx(SIX.parked_joint_rad, abs=1e-3)
        assert observation.joint_velocity.shape == (6,)
        assert matrix_from_quat(observation.pose_tcp_in_base[3:])[2, 2] < -0.999
        assert observation.cameras["wrist"].masks is not None
        assert observation.cameras["wrist"].masks["robot"].any(), "it sees its own tool"
        assert codec.decode_session(codec.encode_session(episode.session)).joint_high_rad == SIX.joint_high_rad
        for height, steps in ((0.05, 30), (-OVERTRAVEL_M, 20)):
            for _ in range(steps):
                episode.step(Action(pose_tcp_in_base=np.r_[top + [0, 0, height], DOWN]), observe=False)
        episode.step(Action(done=True), observe=False)
        write_recording(episode.finish(), tmp_path / "T1-s000.h5")
    recording = read_recording(tmp_path / "T1-s000.h5")
    assert recording.header.embodiment == SIX.id
    assert recording.header.sha256["robot"] == SIX.source.sha256
    assert 2.0 < recording["scorer/normal_force"][-1].max() < 6.0
    score = score_recording(recording)
    assert (score.valid_contact, score.region_correct) == (True, True)


def test_joint_commands_have_six_columns_in_the_log(
    rested: Callable[[TrialSpec], World], trial: TrialSpec, tmp_path: Path
) -> None:
    card = PolicyCard(name="six", cameras=(), control_hz=10, action_space="joint_position", control="six-servos")
    goal = np.array(SIX.parked_joint_rad) + [0.1, 0.0, -0.1, 0.0, 0.1, 0.0]
    with Episode(trial, card=card, prepare=rested) as episode:
        episode.reset()
        for _ in range(20):
            episode.step(Action(joint=goal), observe=False)
        reached = episode.simulation.encoders.joint_position(episode.simulation.data)
        episode.step(Action(done=True), observe=False)
        write_recording(episode.finish(), tmp_path / "T1-s000.h5")
    np.testing.assert_allclose(reached, goal, atol=0.01)
    recording = read_recording(tmp_path / "T1-s000.h5")
    np.testing.assert_array_equal(recording["actions/joint"], [*[goal] * 20, np.full(6, np.nan)])
    assert episode_of(recording).streams["action"].names == tuple(f"joint{k}" for k in range(1, 7))


def test_gains_of_a_robot_with_other_joints_are_refused(scene: Scene) -> None:
    with pytest.raises(SceneError, match="six-joints-ball has 6 joints, and the control has gains of 7"):
        controlled(scene, CONTROLS["droid"])
