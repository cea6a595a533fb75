"""The real packages at the other end, each in an environment that uv makes for it: openpi-client and vla-eval."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from carecontact.protocol.load import load_protocol
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording.schema import Recording
from carecontact.running.trial import run_trial
from tests.serving.fakes import Fake, Openpi, OpenpiPositions

ROOT = Path(__file__).parents[2]
OPENPI = ("openpi-client==0.1.2", "numpy<2")
VLA_EVAL = ("vla-eval==0.8.0",)

OPENPI_SERVER = """
import asyncio
import numpy as np
import websockets.asyncio.server as server
from openpi_client import msgpack_numpy

async def converse(websocket):
    packer = msgpack_numpy.Packer()
    await websocket.send(packer.pack({}))
    async for frame in websocket:
        seen = msgpack_numpy.unpackb(frame)
        assert sorted(seen) == [
            "observation/exterior_image_1_left", "observation/gripper_position", "observation/joint_position",
            "observation/wrist_image_left", "prompt",
        ], sorted(seen)
        actions = np.zeros((15, 8), np.float32)
        actions[:, 0] = np.linspace(0, 0.02, 15)
        await websocket.send(packer.pack({"actions": actions, "policy_timing": {"infer_ms": np.float64(1)}}))

async def main():
    async with server.serve(converse, "127.0.0.1", 0, compression=None, max_size=None) as running:
        print(running.sockets[0].getsockname()[1], flush=True)
        await running.serve_forever()

asyncio.run(main())
"""

OPENPI_CLIENT = """
import sys
import numpy as np
from openpi_client.websocket_client_policy import WebsocketClientPolicy

client = WebsocketClientPolicy("127.0.0.1", int(sys.argv[1]))
assert client.get_server_metadata() == {}
request = {
    "observation/exterior_image_1_left": np.zeros((224, 224, 3), np.uint8),
    "observation/wrist_image_left": np.zeros((224, 224, 3), np.uint8),
    "observation/joint_position": np.zeros(7), "observation/gripper_position": np.ones(1), "prompt": "touch",
}
for _ in range(2):
    reply = client.infer(dict(request))
    assert reply["actions"].shape == (15, 8) and reply["server_timing"]["infer_ms"] >= 0
del request["prompt"]
try:
    client.infer(request)
except RuntimeError as error:
    assert "KeyError: 'prompt'" in str(error), error
    print("both ways")
"""

VLA_EVAL_SERVER = """
import anyio
import numpy as np
from vla_eval.model_servers.predict import PredictModelServer
from vla_eval.model_servers.serve import serve_async
from vla_eval.specs import DimSpec, GRIPPER_01, IMAGE_RGB, LANGUAGE, STATE_JOINT

class Holds(PredictModelServer):
    def get_observation_params(self):
        return {"send_wrist_image": True, "send_state": True}

    def get_action_spec(self):
        return {"joints": DimSpec("joints", 7, "joint_pos_abs", (-3.15, 3.15)), "gripper": GRIPPER_01}

    def get_observation_spec(self):
        return {"image": IMAGE_RGB, "state": STATE_JOINT, "language": LANGUAGE}

    def predict(self, obs, ctx):
        assert [image.shape for image in obs["images"].values()] == [(360, 640, 3)] * 2, obs["images"].keys()
        assert isinstance(obs["task_description"], str)
        states = np.asarray(obs["states"])
        assert states.shape == (8,) and states[7] == 1
        return {"actions": np.concatenate([states[:7] + 1e-4, [1.0]]).astype(np.float32)}

async def main():
    async with anyio.create_task_group() as group:
        print(await group.start(serve_async, Holds(), "127.0.0.1", 0), flush=True)

anyio.run(main)
"""


VLA_EVAL_DELTAS = """
import sys
import anyio
import numpy as np
from vla_eval.model_servers.predict import PredictModelServer
from vla_eval.model_servers.serve import serve_async
from vla_eval.rotation import axisangle_to_matrix, matrix_to_quat, quat_to_axisangle
from vla_eval.specs import GRIPPER_CLOSE_POS, IMAGE_RGB, LANGUAGE, POSITION_DELTA, ROTATION_AA, STATE_EEF_POS_AA_GRIP

GOAL = np.array([float(word) for word in sys.argv[1:4]])

class Goes(PredictModelServer):
    turn = None

    def get_observation_params(self):
        return {"send_wrist_image": True, "send_state": True, "env_seed": 0, "quat_no_antipodal": True}

    def get_action_spec(self):
        return {"position": POSITION_DELTA, "rotation": ROTATION_AA, "gripper": GRIPPER_CLOSE_POS}

    def get_observation_spec(self):
        return {"image": IMAGE_RGB, "state": STATE_EEF_POS_AA_GRIP, "language": LANGUAGE}

    def predict(self, obs, ctx):
        images = {name: np.asarray(image).shape for name, image in obs["images"].items()}
        assert images == {"agentview": (256, 256, 3), "wrist": (256, 256, 3)}, images
        states = np.asarray(obs["states"])
        assert states.shape == (8,)
        now = axisangle_to_matrix(states[3:6])
        self.turn = now if self.turn is None else self.turn
        turn = quat_to_axisangle(matrix_to_quat(self.turn @ now.T))
        row = np.concatenate([np.clip(10 * (GOAL - states[:3]), -1, 1), turn, [1.0]]).astype(np.float32)
        for spec, part in zip(self.get_action_spec().values(), (row[:3], row[3:6], row[6:])):
            assert not spec.validate(part), spec.validate(part)
        return {"actions": row}

async def main():
    async with anyio.create_task_group() as group:
        print(await group.start(serve_async, Goes(), "127.0.0.1", 0), flush=True)

anyio.run(main)
"""
LIBERO_BASE_M = np.array([-0.66, 0.0, 0.912])


def command(packages: tuple[str, ...], *arguments: str) -> list[str]:
    uv = ROOT / ".venv-uv" / "bin" / "uv"
    found = str(uv) if uv.exists() else shutil.which("uv")
    assert found is not None, "make env installs uv"
    wanted = [part for package in packages for part in ("--with", package)]
    return [found, "run", "--no-project", "--python", sys.executable, *wanted, "python", *arguments]


@contextmanager
def serving(*arguments: str, packages: tuple[str, ...] = ()) -> Iterator[int]:
    """The port that a server prints as the last word of its first line."""
    start = command(packages, *arguments) if packages else [sys.executable, *arguments]
    with subprocess.Popen(start, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            yield int(server.stdout.readline().split()[-1])
        finally:
            # uv passes the signal on.
            server.terminate()
            server.wait(20)


def trial_of_t1(address: str) -> Recording:
    recording = run_trial(TrialSpec(protocol=load_protocol("bathing-v3"), task_id="T1", seed=0, policy=address))
    assert recording.header.ended == "time_limit", recording.header.failure
    assert len(recording["actions/joint"]) == 450
    assert np.isfinite(recording["actions/joint"]).all()
    return recording


@pytest.mark.slow
def test_openpis_own_client_drives_the_example_server() -> None:
    with serving(str(ROOT / "examples" / "openpi_server.py"), "0") as port:
        done = subprocess.run(
            command(OPENPI, "-c", OPENPI_CLIENT, str(port)), capture_output=True, text=True, timeout=300
        )
    assert done.stdout.endswith("both ways\n"), done.stderr


@pytest.mark.slow
def test_t1_completes_with_a_server_on_openpis_own_packing() -> None:
    with serving("-c", OPENPI_SERVER, packages=OPENPI) as port:
        recording = trial_of_t1(f"openpi://127.0.0.1:{port}?profile=pi05-droid")
    expected = np.linspace(0, 0.02, 15).astype(np.float32)[:8]
    np.testing.assert_array_equal(recording["actions/joint"][:8, 0], expected)


@pytest.mark.slow
def test_t1_completes_with_a_server_of_vla_eval() -> None:
    with serving("-c", VLA_EVAL_SERVER, packages=VLA_EVAL) as port:
        recording = trial_of_t1(f"vla-eval://127.0.0.1:{port}")
    assert recording.header.card is not None
    assert recording.header.card["action_space"] == "joint_position"
    assert len(recording["policy/observation_time_s"]) == 450


@pytest.mark.slow
def test_t1_completes_with_a_server_of_vla_eval_that_answers_deltas_of_libero() -> None:
    """With the specs and the rotations of vla-eval itself; the goal is a place in LIBERO's world."""
    goal = np.array([0.35, 0.25, 0.5]) + LIBERO_BASE_M
    with serving("-c", VLA_EVAL_DELTAS, *map(str, goal), packages=VLA_EVAL) as port:
        spec = TrialSpec(
            protocol=load_protocol("bathing-v3"),
            task_id="T1",
            seed=0,
            policy=f"vla-eval://127.0.0.1:{port}?profile=libero",
        )
        recording = run_trial(spec)
    assert recording.header.ended == "time_limit", recording.header.failure
    assert len(recording["actions/delta"]) == 600
    target = recording["actions/pose_tcp_in_base"][-1]
    # The grip site lies 20.5 mm behind the tool centre point, and the tool points down.
    np.testing.assert_allclose(target[:3], goal - LIBERO_BASE_M - [0, 0, 0.0205], atol=2e-3)


# Both profiles of pi0.5 on every task of both protocols, with a server that answers harmless chunks.


@pytest.mark.slow
@pytest.mark.parametrize("protocol", ["bathing-v3", "bathing-droid-v1"])
@pytest.mark.parametrize(
    ("profile", "server"), [("pi05-droid", Openpi(steps=15)), ("pi05-droid-jointpos", OpenpiPositions(steps=15))]
)
@pytest.mark.parametrize("task", [f"T{number}" for number in range(1, 8)])
def test_a_trial_completes(protocol: str, profile: str, server: Fake, task: str) -> None:
    with server.running() as port:
        address = f"openpi://127.0.0.1:{port}?profile={profile}"
        recording = run_trial(TrialSpec(protocol=load_protocol(protocol), task_id=task, seed=0, policy=address))
    assert recording.header.ended == "time_limit", recording.header.failure
    assert len(recording["actions/joint"]) == 450
