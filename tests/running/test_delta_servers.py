"""Trials with servers of LIBERO's and of Bridge's conventions: they bring the tool to where they mean to bring it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from carecontact.episode.perception import Peak
from carecontact.episode.randomization import settled_world
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden
from carecontact.protocol.protocol import Protocol, TrialSpec
from carecontact.recording.schema import Recording
from carecontact.running.trial import run_trial
from carecontact.scoring import score_recording
from tests.serving.delta_servers import LIBERO_SPEC, Bridge, Driving, Libero, OnOpenpi, OnVlaEval

LIBERO_WORLD = np.array([-0.66, 0.0, 0.912])
"""LIBERO's robot0_base in its tabletop scenes, "-0.66 0 0.912" in their models."""
WAY_M, TURN_RAD = np.array([0.06, -0.1, 0.05]), 0.4
"""Of the goal from where the tool begins, in the base; the turn is about the vertical and about x."""


def place_of(recording: Recording, row: int) -> tuple[np.ndarray, Rotation]:
    """Of the tool in the robot's base."""
    base, tool = np.array(recording.header.pose_base_in_world), recording["scorer/pose_tcp_in_world"][row]
    turn = Rotation.from_quat(base[3:], scalar_first=True).inv()
    return turn.apply(tool[:3] - base[:3]), turn * Rotation.from_quat(tool[3:], scalar_first=True)


def goal_of(server: Driving, place: np.ndarray, turn: Rotation) -> None:
    """Set the goal of a server, in its own frame, to a pose of our tool in the base."""
    if isinstance(server, Libero):
        # robosuite's grip site: 97 mm from a hand at 106.5 mm; our tool's point: 117 mm from a hand at 107 mm.
        server.goal = place - turn.apply([0, 0, 0.107 + 0.117 - 0.1065 - 0.097]) + LIBERO_WORLD
        server.turn = turn
    else:
        server.goal, server.turn = place, turn * Rotation.from_rotvec([np.pi, 0, 0]).inv()


CASES = {
    "LIBERO on openpi": (lambda: OnOpenpi(driver=Libero()), "openpi://127.0.0.1:{}?profile=libero", 20.0),
    "Bridge on openpi": (lambda: OnOpenpi(driver=Bridge()), "openpi://127.0.0.1:{}?profile=bridge", 5.0),
    "LIBERO on vla-eval": (lambda: OnVlaEval(driver=Libero()), "vla-eval://127.0.0.1:{}?profile=libero", 20.0),
    "Bridge on vla-eval": (
        lambda: OnVlaEval(
            driver=Bridge(),
            payload={
                "observation_params": {"send_state": True},
                "action_spec": LIBERO_SPEC | {"rotation": {"dims": 3, "format": "euler_xyz"}},
            },
        ),
        "vla-eval://127.0.0.1:{}?profile=bridge",
        5.0,
    ),
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize(
    ("task", "seconds"), [("T1", 6.0), *(pytest.param(f"T{k}", 30.0, marks=pytest.mark.slow) for k in range(1, 8))]
)
def test_a_server_brings_the_tool_to_its_goal(
    name: str, task: str, seconds: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The report's two pictures are not what is tested here.
    monkeypatch.setattr(Peak, "pictures", lambda self, renderer, region: {})
    make, address, hz = CASES[name]
    server = make()
    protocol = overridden(load_protocol("bathing-v3"), {"phases.time_limit_s": seconds})
    place, turn = parked(protocol, task)
    goal, turned = place + WAY_M, Rotation.from_euler("zx", [TURN_RAD, 0.2]) * turn
    goal_of(server.driver, goal, turned)
    with server.running() as port:
        spec = TrialSpec(protocol=protocol, task_id=task, seed=0, policy=address.format(port))
        recording = run_trial(spec)
    assert recording.header.ended == "time_limit", recording.header.failure
    card = recording.header.card
    assert card is not None
    assert (card["action_space"], card["control_hz"]) == ("cartesian_delta", hz)
    assert recording.header.control == "cartesian-impedance"
    assert len(recording["actions/delta"]) == round(hz * seconds)
    place, turn = place_of(recording, -1)
    assert np.abs(place - goal).max() < 0.003
    assert (turn * turned.inv()).magnitude() < 0.03
    assert score_recording(recording).trial_id
    # What is executed is what the server sent, within the bounds of its convention.
    executed = {"libero": 5, "bridge": 4}[card["arguments"]["profile"]] if "openpi" in address else 1
    sent = np.concatenate([rows[:executed, :6].astype(np.float64) for rows in server.answered])
    np.testing.assert_array_equal(recording["actions/delta"], sent[: len(recording["actions/delta"])])


def parked(protocol: Protocol, task: str) -> tuple[np.ndarray, Rotation]:
    """Where the tool is in the base when a trial begins."""
    simulation, _, _ = settled_world(protocol, task_id=task, seed=0)
    pose = simulation.encoders.pose_tcp_in_base(simulation.data)
    return pose[:3, 3], Rotation.from_matrix(pose[:3, :3])
