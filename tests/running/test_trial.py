"""One whole trial through its parts: policy process, world, recording, score."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carecontact.episode.randomization import World
from carecontact.interface.action import Action, ActionSpace
from carecontact.interface.geometry import pixels, pose_matrix
from carecontact.interface.policy import PolicyRef
from carecontact.interface.robot import Session
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording import Failure, Recording, canonical_hash, read_recording
from carecontact.recording.notes import perception_errors
from carecontact.running.engine import RunSettings, StatusPipe, TrialRequest, setup_of
from carecontact.running.lost import digest_of
from carecontact.running.supervisor import run_trials
from carecontact.running.trial import run_trial
from carecontact.running.workers import Launcher, Workers
from carecontact.runs.identity import identity_of
from carecontact.runs.plan import plan_trials
from carecontact.scoring import score_recording
from carecontact.serving import codec
from carecontact.serving.conversation import WAIT_REPORT_S, PolicySetup
from carecontact.serving.fence import available
from carecontact.serving.namespaces import VARIABLE
from carecontact.sim.rendering import SceneRenderer
from tests.scoring.synthetic import touch

POLICIES = '''
import os
import numpy as np
from carecontact.interface.action import Action
from carecontact.interface.policy import PolicyCard

class Wave:
    """Moves ``rise_m`` up and back in one second; asks for one picture."""
    def __init__(self, *, rise_m: float, rate_hz: int = 15, token: str = os.environ.get("WAVE_TOKEN", "")):
        self.rise_m, self.token = rise_m, token
        self.card = PolicyCard(name="wave", modalities=("rgb", "depth"), control_hz=rate_hz)
    def reset(self, instruction):
        self.instruction = instruction
    def act(self, observation):
        poses = np.tile(observation.pose_tcp_in_base, (15, 1))
        print("token", self.token)
        poses[:, 2] += self.rise_m * np.sin(np.linspace(0, np.pi, 15))
        return [*(Action(pose_tcp_in_base=p) for p in poses), Action(done=True)]

class Outside:
    card = PolicyCard(name="outside", control_hz=10)
    def reset(self, instruction): ...
    def act(self, observation):
        if observation.sim_time_s < 0.5:
            return Action()
        return Action(pose_tcp_in_base=np.array([5.0, 0, 0.5, 0, 1, 0, 0]))

class Second(Outside):
    def act(self, observation):
        answer = super().act(observation)
        return [Action(), answer]
'''


@pytest.fixture
def policies(tmp_path: Path) -> Path:
    (tmp_path / "my_policies.py").write_text(POLICIES)
    return tmp_path


def spec(policy: str, task: str = "T1", seed: int = 0) -> TrialSpec:
    return TrialSpec(protocol=load_protocol("bathing-v3"), task_id=task, seed=seed, policy=policy)


@pytest.mark.slow
def test_same_spec_in_fresh_processes_gives_the_same_recording(policies: Path, tmp_path: Path) -> None:
    """Of a policy with an argument and a variable: both are in the recording, but not the variable's value."""
    hashes = []
    wave = replace(
        PolicySetup.of("my_policies:Wave", search_path=[str(policies)], arguments={"rise_m": "0.03"}),
        environment={"WAVE_TOKEN": "sekret-123"},
    )
    given = {"policy_arguments": {"rise_m": "0.03"}, "policy_environment": ("WAVE_TOKEN",)}
    trial = spec("my_policies:Wave").model_copy(update=given)
    for name in ("a.h5", "b.h5"):
        request = TrialRequest(spec=trial, policy=wave, out=tmp_path / name)
        command = [sys.executable, "-m", "carecontact.running.worker"]
        done = subprocess.run(command, input=request.model_dump_json(), capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stderr
        recording = read_recording(tmp_path / name)
        assert recording.header.ended == "done", recording.header.failure
        hashes.append(canonical_hash(recording))
        assert recording.header.card is not None
        assert recording.header.card["arguments"] == {"rise_m": "0.03"}
        assert recording.header.card["environment"] == ["WAVE_TOKEN"]
        assert recording["wall/policy_output"].tobytes() == b"token [secret removed]"
        assert b"sekret-123" not in (tmp_path / name).read_bytes()
    assert hashes[0] == hashes[1]
    # 16 actions at 15 Hz: periods of 33, 33, 34 steps keep the mean rate.
    assert len(recording["scorer/time_s"]) == 533
    assert np.allclose(np.diff(recording["scorer/time_s"]), 0.002)
    assert recording["policy/observation_sha256"].shape == (1, 32)
    assert recording["policy/frames/0000/overhead/rgb"].shape == (480, 640, 3)
    assert recording["report/peak_rgb"].std() > 10
    check_close_up(recording)
    risen = recording["scorer/pose_tcp_in_world"][:, 2]
    assert 0.005 < risen.max() - risen[0] < 0.03, "the impedance follows a target that leads it"


def check_close_up(recording: Recording) -> None:
    """The stored camera saw the tool where the picture has it, and the stored skin lies on the declared cells."""
    pose, focal = recording["report/peak_pose_camera_in_world"], float(recording["report/peak_focal_px"][0])
    intrinsics = np.array([[focal, 0, 320], [0, focal, 180], [0, 0, 1.0]])
    tip = recording["scorer/pose_tcp_in_world"][-1, :3].astype(float)
    camera = pose_matrix(pose[:3], pose[3:])
    assert pixels(tip + [0, 0, 0.02], intrinsics, camera) == pytest.approx([320, 180], abs=1)
    assert pixels(tip, intrinsics, camera)[1] > 200, "down in the picture is down in the world"
    region = recording["scorer/region_pose_in_world"][-1, 0].astype(float)
    cells = recording["scorer/cell_in_region"] @ pose_matrix(region[:3], region[3:])[:3, :3].T + region[:3]
    skin = recording["report/skin_in_world"]
    assert np.median(np.linalg.norm(cells[:, None] - skin[None], axis=2).min(1)) < 0.008
    assert recording["report/skin_faces"].max() == len(skin) - 1


def test_an_action_is_decoded_once_and_checked_once(
    policies: Path, again: Callable[..., World], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The third answer begins at 0.4 s, and the one after it is refused at its second action."""
    decoded, checked = list[int](), list[Action]()
    decode, check = codec.decode_actions, ActionSpace.check

    def decoding(plain: Any) -> list[Action]:
        decoded.append(len(plain))
        return decode(plain)

    def checking(space: ActionSpace, action: Action, session: Session) -> Action:
        checked.append(action)
        return check(space, action, session)

    monkeypatch.setattr(codec, "decode_actions", decoding)
    monkeypatch.setattr(ActionSpace, "check", checking)
    second = PolicySetup.of("my_policies:Second", search_path=[str(policies)])
    looks: list[bytes] = []
    recording = run_trial(
        spec("my_policies:Second"),
        policy=second,
        prepare=again,
        on_look=lambda look: looks.append(digest_of(look.actions)),
    )
    assert recording.header.failure is not None
    assert "failed at act: actions[1].pose_tcp_in_base: expected a position" in recording.header.failure.message
    assert decoded == [2, 2, 2, 2]
    assert len(looks) == 4
    assert len(recording["actions/time_s"]) == 7
    assert len(checked) == 8, "the last one was refused"
    assert score_recording(recording).failure_mode == "process_failure"


def test_action_outside_the_workspace_is_the_policys_process_failure(
    policies: Path, again: Callable[..., World]
) -> None:
    running: list[bool] = []
    outside = PolicySetup.of("my_policies:Outside", search_path=[str(policies)])
    recording = run_trial(spec("my_policies:Outside"), policy=outside, prepare=again, on_policy=running.append)
    assert running == [True, False]
    assert recording.header.ended == "process_failure"
    assert recording.header.failure is not None
    assert recording.header.failure.kind == "action"
    assert recording.header.failure.message.startswith(
        "policy 'my_policies:Outside' failed at act: actions[0].pose_tcp_in_base: expected a position inside the"
    )
    assert recording["scorer/time_s"][-1] == pytest.approx(0.498, abs=0.003), "what ran before is kept"
    score = score_recording(recording)
    assert (score.failure_mode, score.attribution, score.c3_success) == ("process_failure", "process", False)


@pytest.mark.parametrize("periods", [1, 4])
def test_diverging_physics_end_in_a_failed_trial(periods: int, again: Callable[..., World]) -> None:
    """Also in the very first period: a policy whose commands break the physics must not lose the trial."""

    def diverging(asked: TrialSpec) -> World:
        simulation, settled, sha256 = again()
        asked_of = iter([[]] * (periods - 1) + [["BADQACC"]] * 100)
        simulation.solver_warnings = lambda: next(asked_of)
        return simulation, settled, sha256

    recording = run_trial(spec("zero-action"), prepare=diverging)
    assert recording.header.ended == "safety_truncation"
    assert recording.header.failure == Failure(kind="solver", message="MuJoCo warning BADQACC")
    assert len(recording["scorer/period_time_s"]) == periods - 1
    score = score_recording(recording)
    assert score.c3_success is False
    assert score.failure_mode is not None


def test_blank_pictures_end_as_a_perception_failure_and_touch_nothing(
    again: Callable[..., World], monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = SceneRenderer.rgb
    monkeypatch.setattr(SceneRenderer, "rgb", lambda self, data, camera: np.full_like(seen(self, data, camera), 128))
    recording = run_trial(spec("state-machine"), prepare=again)
    score = score_recording(recording)
    assert recording.header.ended == "done"
    assert score.anatomy == "none"
    assert score.failure_mode == "no_target_contact"
    assert score.attribution == "perception"
    assert not recording["scorer/force_human_from_robot_in_world"].any()
    errors = perception_errors(recording)
    assert errors is not None
    assert errors.camera == ["overhead"]
    assert errors.joint_visible[0].sum() >= 10
    assert np.isnan(errors.landmark_error_px).all()
    assert np.isnan(errors.target_error_m).all()
    assert errors.human_iou.tolist() == [0.0]


# What isolates a policy changes nothing of its trial.


@pytest.mark.parametrize(
    "policy", ["random", *(pytest.param(name, marks=pytest.mark.slow) for name in ("hover", "state-machine"))]
)
def test_the_hash_is_the_same_with_and_without_isolation(
    policy: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    protocol = overridden(load_protocol("bathing-v3"), {"physics.dt_s": 0.004, "phases.time_limit_s": 0.5})
    (spec,) = plan_trials(protocol=protocol, policy=policy, tasks=["T1"], seeds=[0])
    found, levels = {}, {}
    for kind in ("namespaces", "no namespaces", "none"):
        isolated, out = kind != "none", tmp_path / kind
        monkeypatch.setenv(VARIABLE, "off" if kind == "no namespaces" else "")
        run_trials([spec], out=out, jobs=1, policy=replace(setup_of(spec), isolated=isolated))
        found[kind] = read_recording(out / f"{spec.trial_id}.h5")
        assert found[kind].header.failure is None
        levels[kind] = (found[kind]["wall/isolation"].tobytes().decode(), available())
    assert levels.pop("none")[0] == "none: switched off"
    assert all(recorded == given for recorded, given in levels.values())
    assert len({recording.stored_sha256 for recording in found.values()}) == 1


# A trial whose policy is silent reports it while it runs.

SPEC = touch(seed=0).header.spec


def test_the_supervisor_reads_the_line_while_it_is_fresh(tmp_path: Path) -> None:
    (tmp_path / "work").mkdir()
    setup, work = PolicySetup(ref=PolicyRef.parse(SPEC.policy)), tmp_path / "work"
    identity = identity_of(SPEC, search_path=[])
    settings = RunSettings(out=tmp_path, work=work, policy=setup, identity=identity, trial_limit_s=60)
    workers = Workers(settings, Launcher([sys.executable, "-c", "import time; time.sleep(60)"]))
    workers.start(SPEC)
    read, write = os.pipe()
    status = StatusPipe(read)
    workers.running[0] = replace(workers.running[0], status=status)
    try:
        assert workers.waiting() == {}
        os.write(write, b'{"waiting": "waiting for the policy: 40 of 120 s"}\n')
        assert workers.finished() == []
        assert workers.waiting() == {SPEC.trial_id: "waiting for the policy: 40 of 120 s"}
        status.waited_s -= 3 * WAIT_REPORT_S
        assert workers.waiting() == {}, "it has answered since"
    finally:
        workers.kill_all()
