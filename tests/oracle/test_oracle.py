from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from carecontact.cli import main
from carecontact.errors import ConfigError, ContractError
from carecontact.interface.action import Action
from carecontact.interface.geometry import matrix_from_quat
from carecontact.interface.policy import PolicyRef
from carecontact.oracle import truth
from carecontact.oracle.policy import (
    AGAIN,
    LIFT_M_S,
    MOST_WRIST_M,
    OFF_M,
    PATIENCE_S,
    PUSHES,
    RETURN_M_S,
    STEADY_S,
    Oracle,
    Press,
    Push,
    Stage,
    drive,
)
from carecontact.oracle.truth import CLEAR_M, HARD_M, Truth, displaced, hold
from carecontact.policies import registry
from carecontact.policies.motion import CONTROL_HZ, Leg, radial_quat
from carecontact.policies.registry import POLICIES, PolicyRow
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import FAST_DT_S, overridden
from carecontact.protocol.person import Alive, Breathing, Repositioning, Withdrawal
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording import read_header, write_recording
from carecontact.recording.schema import SEGMENTS
from carecontact.running.trial import run_trial
from carecontact.scoring import score_recording
from carecontact.serving.conversation import PolicySetup
from carecontact.sim.simulation import Simulation
from carecontact.sim.state import top_of_skin
from tests.policies.synthetic import BOUNDS, synthetic_observation


class Ends:
    """A motion of one period."""

    ended = True

    def __init__(self, succeeded: bool) -> None:
        self.succeeded = succeeded

    def act(self) -> Action:
        return Action(pose_tcp_in_base=np.array([9.0, 0, 0.4, 0, 1, 0, 0]))


@pytest.mark.parametrize(("succeeded", "share", "done"), [(True, 0.1, True), (False, 0.1, False), (False, 0.9, True)])
def test_a_motion_that_lost_the_person_is_planned_again_while_there_is_time(
    simulation: Simulation, monkeypatch: pytest.MonkeyPatch, succeeded: bool, share: float, done: bool
) -> None:
    planned: list[object] = []
    monkeypatch.setattr(Oracle, "_planned", lambda self, start: planned.append(start) or Ends(succeeded))
    oracle = Oracle(simulation, load_protocol("bathing-v3").task("T1"), BOUNDS)
    seen = replace(synthetic_observation(), sim_time_s=share * simulation.protocol.phases.time_limit_s)
    first = oracle.act(seen)
    assert first.done is done
    assert first.pose_tcp_in_base is not None
    assert first.pose_tcp_in_base[0] == BOUNDS.workspace_high_m[0], "targets stay in the workspace"
    if not done:
        oracle.act(seen)
    assert len(planned) == (1 if done else 2)
    assert 0.1 < AGAIN < 0.9


def test_a_region_that_it_does_not_know_ends_the_trial_untouched(simulation: Simulation) -> None:
    task = load_protocol("bathing-v3").task("T1").model_copy(update={"region": "left_shank"})
    oracle = Oracle(simulation, task, BOUNDS)
    assert oracle.act(synthetic_observation()).done
    assert "left_shank" in str(oracle.take_notes()["ended_without_touching"])


ALIVE = Alive(breathing=Breathing(abdomen_m=(0.015, 0.015)), repositioning=Repositioning(), withdrawal=Withdrawal())


def test_it_feels_the_force_with_the_steps_of_the_fast_mode_too() -> None:
    protocol = overridden(load_protocol("bathing-v3"), {"physics.dt_s": FAST_DT_S})
    recording = run_trial(TrialSpec(protocol=protocol, task_id="T1", seed=0, policy="oracle"))
    assert recording.header.ended == "done"
    assert score_recording(recording).safety_gated


@pytest.mark.parametrize("task", ["T2", pytest.param("T7", marks=pytest.mark.slow)])
def test_it_does_the_task_on_a_person_who_breathes_and_moves(task: str, tmp_path: Path) -> None:
    moved = load_protocol("bathing-wide-v2", level="L1")
    protocol = moved.model_copy(update={"person": moved.person.model_copy(update={"alive": ALIVE})})
    recording = run_trial(TrialSpec(protocol=protocol, task_id=task, seed=0, policy="oracle"))
    write_recording(recording, tmp_path / "a.h5")
    header = read_header(tmp_path / "a.h5")
    assert header.privileged is True
    assert header.ended == "done"
    score = score_recording(recording)
    assert (score.safety_gated, score.privileged) == (True, True)
    target = SEGMENTS.index({"T2": "right_forearm", "T7": "abdomen"}[task])
    force = np.linalg.norm(recording["scorer/force_human_from_robot_in_world"][:, target], axis=1)
    assert 1.0 < np.median(force[force > 0.3]) < 20.0


def test_a_recording_says_whether_there_was_privilege() -> None:
    recording = run_trial(TrialSpec(protocol=short(), task_id="T1", seed=0, policy="zero-action"))
    assert recording.header.model_dump(mode="json")["privileged"] is False
    assert not score_recording(recording).privileged


def test_only_the_shipped_oracle_is_given_the_simulation(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not another name, even if a row of this process calls itself privileged."""
    monkeypatch.setitem(POLICIES._rows, "mine", PolicyRow(target="my.own:Mine", description="x", role="privileged"))
    spec = TrialSpec(protocol=short(), task_id="T1", seed=0, policy="mine")
    with pytest.raises(ConfigError, match="policy mine: only oracle may be given the simulation"):
        run_trial(spec)
    monkeypatch.setattr(registry, "is_privileged", lambda ref: True)
    with pytest.raises(ConfigError, match="only oracle"):
        drive(None, PolicyRef.parse("my.own:Mine"))  # pyright: ignore[reportArgumentType]


def test_a_policy_file_that_imports_the_oracle_fails_behind_the_wall() -> None:
    name = "carecontact.oracle.policy:Oracle"
    spec = TrialSpec(protocol=short(), task_id="T1", seed=0, policy=name)
    recording = run_trial(spec, policy=PolicySetup.of(name))
    assert recording.header.ended == "process_failure"
    assert recording.header.failure is not None
    assert "carecontact.oracle is closed to policies" in recording.header.failure.message
    assert not recording.header.privileged


@pytest.mark.parametrize("command", [["serve", "oracle", "--port", "0"], ["check", "oracle"]])
def test_it_is_neither_served_nor_checked(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(command) == 2
    assert "policy oracle is privileged" in capsys.readouterr().err


def test_it_takes_no_arguments(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["run", "--policy", "oracle", "--policy-arg", "a=1", "--out", str(tmp_path)]
    assert main(command) == 2
    assert "leave out --policy-arg" in capsys.readouterr().err


def short():
    protocol = load_protocol("bathing-v3")
    return protocol.model_copy(update={"phases": protocol.phases.model_copy(update={"time_limit_s": 0.1})})


def test_a_free_place_is_touched_straight_from_above(simulation: Simulation) -> None:
    place = Truth(simulation, "forearm").geometry().centre_m
    state = simulation.integration_state()
    held = hold(simulation, "forearm", place[None])
    assert (held.reached, held.clear_m) == (True, CLEAR_M)
    assert abs(float(held.quat_wxyz @ radial_quat(place))) > 1 - 1e-9
    assert np.array_equal(simulation.integration_state(), state), "trying postures leaves the trial as it is"


def test_the_hand_turns_where_it_would_land_on_the_person(simulation: Simulation, monkeypatch) -> None:
    """Beside the head, the hand that points straight down hits it, and a turned or leant one has more room."""
    data = simulation.data
    head = simulation.encoders.in_base(data, data.geom("human_hull_head").xpos, np.eye(3))[:3, 3]
    chest = simulation.encoders.in_base(data, data.geom("human_hull_right_chest").xpos, np.eye(3))[:3, 3]
    place = Truth(simulation, "upper_arm").geometry().centre_m
    beside = place + 0.35 * ((head + chest) / 2 - place) * [1, 1, 0]
    straight = truth._Arm(simulation, "upper_arm").tried(radial_quat(beside), beside[None])
    found = hold(simulation, "upper_arm", beside[None])
    assert straight.clear_m < CLEAR_M
    assert found.rank > straight.rank
    assert matrix_from_quat(found.quat_wxyz)[2, 2] < -0.9


def test_a_place_out_of_reach_is_not_reached(simulation: Simulation) -> None:
    assert not hold(simulation, "forearm", np.array([[1.6, 0.0, 0.2]])).reached


@pytest.mark.parametrize("region", ["forearm", "upper_arm", "abdomen"])
def test_the_surface_is_where_the_visible_skin_is(simulation: Simulation, region: str) -> None:
    """The shell is a smoothed sample of the skin: both tops agree within millimetres along the whole stroke."""
    truth = Truth(simulation, region)
    geometry, skin = truth.geometry(), truth.skin()
    faces = simulation.model.skin_face.reshape(-1, 3)
    for along in np.linspace(-0.05, 0.05, 5):
        place = geometry.surface(float(along))
        assert abs(place[2] - top_of_skin(skin, faces, place[:2])) < 0.005


def test_the_region_begins_and_ends_where_the_scorer_measures_it(simulation: Simulation) -> None:
    """Over the ends of its axis, which on an arm that lies aslant are not straight above the joints."""
    truth = Truth(simulation, "upper_arm")
    geometry, frame = truth.geometry(), truth.frame()
    soft = (truth.surface() - frame[:3, 3]) @ frame[:3, 0]
    for along, end in ((-1, soft.min()), (1, soft.max())):
        place = geometry.surface(along * geometry.half_length_m)
        assert (place - frame[:3, 3]) @ frame[:3, 0] == pytest.approx(end - along * HARD_M, abs=0.006)


def test_a_limb_lies_on_its_board_and_the_belly_on_nothing(simulation: Simulation) -> None:
    forearm = Truth(simulation, "forearm").geometry()
    assert forearm.support_height_m is not None
    assert 0.03 < forearm.centre_m[2] - forearm.support_height_m < 0.12
    assert Truth(simulation, "abdomen").geometry().support_height_m is None


def test_places_move_with_their_frame(simulation: Simulation) -> None:
    before = Truth(simulation, "forearm").frame()
    turn = np.eye(4)
    turn[:2, :2], turn[:3, 3] = [[0.0, -1.0], [1.0, 0.0]], [0.1, 0.2, 0.3]
    point = before[:3, :3] @ [0.01, 0.02, 0.03] + before[:3, 3]
    assert displaced(point, before, turn @ before) == pytest.approx(turn[:3, :3] @ point + turn[:3, 3])


def test_nothing_presses_before_the_trial(simulation: Simulation) -> None:
    assert Truth(simulation, "forearm").force_n() == 0.0


def test_a_region_without_a_shell_is_refused(simulation: Simulation) -> None:
    with pytest.raises(ContractError, match="left_shank is none"):
        Truth(simulation, "left_shank")


DOWN = np.array([0.5, 0.0, 0.3, 0.0, 1.0, 0.0, 0.0])
PRESSES = 10


class Skin:
    """A person who lies still and gives back the forces of a list, one in each control period, and then the last."""

    def __init__(self, forces_n: list[float], *, sideways_n: float = 0.0) -> None:
        self.forces_n, self._sideways_n = forces_n, sideways_n
        self.simulation = SimpleNamespace(protocol=load_protocol("bathing-v3"))
        self.pose = np.eye(4)
        self.met: np.ndarray | None = None

    def frame(self) -> np.ndarray:
        return self.pose.copy()

    def contact(self) -> np.ndarray | None:
        return self.met

    def force_n(self) -> float:
        return self.forces_n.pop(0) if len(self.forces_n) > 1 else self.forces_n[0]

    def force(self) -> np.ndarray:
        return np.array([self._sideways_n, 0.0, -1.0])


def run(skin: Any, *, rests: bool) -> tuple[Press, int]:
    """The press at its end, and the number of its control periods."""
    press, count = Press(skin, [Stage(pose=DOWN, presses=True)] * PRESSES, rests=rests), 0
    while not press.ended:
        press.act()
        count += 1
    return press, count


@pytest.mark.parametrize("lost_n", [0.0, 20.0])
def test_a_touch_begins_again_when_the_person_takes_the_skin_away_or_brings_it_up(lost_n: float) -> None:
    steady = round(STEADY_S * CONTROL_HZ)
    held = [3.0] * (steady - 4)
    press, count = run(Skin([*held, lost_n, *held, lost_n, 3.0]), rests=True)
    assert press.succeeded
    assert count == 2 * (len(held) + 1) + steady


def test_a_stroke_does_not_wait_for_a_steady_force() -> None:
    _, count = run(Skin([3.0, 20.0] * PRESSES), rests=False)
    assert count == PRESSES


def test_patience_ends() -> None:
    press, count = run(Skin([9.0]), rests=True)
    assert not press.succeeded
    assert count == PRESSES + PATIENCE_S * CONTROL_HZ


def test_the_target_leads_by_what_friction_takes() -> None:
    """2 N of friction on a spring of 400 N/m: 5 mm."""
    press: Any = Press(Skin([3.0], sideways_n=2.0), [Stage(pose=DOWN, presses=True)] * 40, rests=False)  # pyright: ignore[reportArgumentType]
    places = [press.act().pose_tcp_in_base for _ in range(40)]
    assert places[-1][0] - DOWN[0] == pytest.approx(0.005, abs=1e-4)
    assert places[-1][1] == DOWN[1]


def test_the_tool_lifts_off_while_the_person_moves_and_comes_back_gently() -> None:
    skin = Skin([3.0])
    press: Any = Press(skin, [Stage(pose=DOWN, presses=True)] * 60, rests=False)  # pyright: ignore[reportArgumentType]
    for _ in range(10):
        press.act()
    heights: list[float] = []
    for k in range(30):
        moves = k < 10
        skin.pose[0, 3] += 0.1 / CONTROL_HZ if moves else 0.0
        skin.forces_n[:] = [0.0 if moves or heights[-1] > DOWN[2] else 3.0]
        heights.append(float(press.act().pose_tcp_in_base[2]))
    assert heights[2] == pytest.approx(DOWN[2] + OFF_M)
    assert max(np.diff(heights)) <= LIFT_M_S / CONTROL_HZ + 1e-9
    assert min(np.diff(heights)) >= -RETURN_M_S / CONTROL_HZ - 1e-9
    assert heights[-1] == pytest.approx(DOWN[2], abs=1e-3)


@pytest.mark.parametrize("axis", [0, 1])
def test_the_contact_is_brought_to_its_place_only_along_the_axes_that_were_named(axis: int) -> None:
    skin, meets = Skin([3.0]), np.eye(3)[[1]]
    plan = [Stage(pose=DOWN, presses=True)] * 60
    press: Any = Press(skin, plan, rests=False, meets=meets)  # pyright: ignore[reportArgumentType]
    target = DOWN
    for _ in range(60):
        skin.met = target[:3] - 0.008 * np.eye(3)[axis]
        target = press.act().pose_tcp_in_base
    expected = DOWN[:3] + (0.008 * np.eye(3)[axis] if axis == 1 else 0.0)
    np.testing.assert_allclose(target[:3], expected, atol=1e-3)


QUAT = np.array([0.0, 1.0, 0.0, 0.0])
START = np.array([0.4, 0.0, 0.4, *QUAT])
LOW = np.array([0.5, 0.0, 0.3])


class Limb:
    """A limb that the tool finds at once, and whose wrist the person takes along."""

    def __init__(self, speed_m_s: float) -> None:
        self.simulation = SimpleNamespace(protocol=load_protocol("bathing-v3"))
        self.at, self.step = np.zeros(3), np.array([speed_m_s / 20, 0.0, 0.0])

    def frame(self) -> np.ndarray:
        return np.eye(4)

    def force_n(self) -> float:
        return 3.5

    def wrist(self) -> np.ndarray:
        self.at = self.at + self.step
        return self.at


@pytest.mark.parametrize(("speed_m_s", "lets_go"), [(0.06, True), (0.0, False)])
def test_a_push_lets_go_before_person_and_tool_together_move_the_wrist_too_far(speed_m_s: float, lets_go: bool) -> None:
    legs = [Leg(points=LOW[None], quat_wxyz=QUAT, speed_m_s=0.1)] * (PUSHES + 3)
    legs[PUSHES] = Leg(points=LOW[None] + [0.05, 0.0, 0.0], quat_wxyz=QUAT, speed_m_s=0.1)
    legs[-1] = Leg(points=LOW[None] + [0.0, 0.0, 0.1], quat_wxyz=QUAT, speed_m_s=0.1)
    limb: Any = Limb(speed_m_s)
    push, farthest = Push(limb, legs, START), 0.0
    while not push.ended:
        pose = push.act().pose_tcp_in_base
        assert pose is not None
        farthest = max(farthest, float(pose[0] - LOW[0]))
    assert not push.succeeded
    assert (farthest < MOST_WRIST_M + 0.01) is lets_go
