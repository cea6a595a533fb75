"""The example of docs/your-policy.md and the client package, where only numpy, msgpack and websockets are installed."""

from __future__ import annotations

import functools
import importlib
import re
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carecontact.errors import PolicyError
from carecontact.serving.conversation import PolicySetup
from carecontact.serving.opening import RemotePolicy
from tests.policies.synthetic import SESSION, synthetic_observation, synthetic_view
from tests.serving.clean_environment import running, site_with

ROOT = Path(__file__).parents[2]
CLIENT = ROOT / "client"
SERVED = """
import numpy as np
from carecontact_client import serve

class Policy:
    card = {"name": "served", "modalities": ["rgb"], "cameras": ["overhead"], "control_hz": np.float32(5)}

    def reset(self, instruction, session):
        self.calls, self.high = 0, session["action_bounds"]["workspace_high_m"][2]

    def act(self, observation):
        self.calls += 1
        tool = observation["pose_tcp_in_base"]
        tool[2] = self.high
        if self.calls == 5:
            raise ValueError("the fifth")
        answers = tool, np.tile(tool, (3, 1)), {"done": np.bool_(True)}, [tool, {"done": True}]
        return answers[self.calls - 1]

    def take_notes(self):
        return {"calls": self.calls}

serve(Policy, port=0)
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return site_with(tmp_path_factory.mktemp("clean"))


def conversation(port: int) -> RemotePolicy:
    return RemotePolicy(PolicySetup.of(f"ws://127.0.0.1:{port}"), first_deadline_s=20, deadline_s=20)


def listening(port: int, process: subprocess.Popen[str]) -> None:
    for _ in range(200):
        assert process.poll() is None, process.communicate()[0]
        try:
            socket.create_connection(("127.0.0.1", port)).close()
            return
        except ConnectionRefusedError:
            time.sleep(0.05)
    raise AssertionError(f"nothing listens on port {port}")


@pytest.fixture
def example(site: Path, tmp_path: Path) -> Iterator[int]:
    """The example on a free port."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    script = tmp_path / "standalone_policy.py"
    script.write_text((ROOT / "examples" / "standalone_policy.py").read_text().replace("8765", str(port)))
    with running(script, site=site, modules=tmp_path) as process:
        listening(port, process)
        yield port


def test_the_example_moves_above_the_wrist_and_ends(example: int) -> None:
    view = synthetic_view()
    observation = synthetic_observation(cameras={"overhead": view})
    for _ in range(2):  # each trial is a connection of its own
        with conversation(example) as policy:
            assert policy.start().name == "standalone"
            policy.reset("gently touch the right forearm", SESSION)
            *moves, end = policy.act(observation).actions
        low, high = SESSION.action_bounds.workspace_low_m, SESSION.action_bounds.workspace_high_m
        assert view.landmarks_in_base is not None
        goal = np.clip(view.landmarks_in_base[16] + [0, 0, 0.2], low, high)
        np.testing.assert_allclose(moves[-1].pose_tcp_in_base[:3], goal)
        assert len(moves) == 40
        assert end.done


def test_the_example_reports_its_own_traceback(example: int) -> None:
    with conversation(example) as policy:
        policy.start()
        policy.reset("gently touch the right forearm", SESSION)
        with pytest.raises(PolicyError, match=r"Traceback(?s:.*)KeyError: 'overhead'") as caught:
            policy.act(synthetic_observation())
    assert caught.value.kind == "exception"


def test_the_client_package_serves_a_policy_object(site: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(SERVED)
    with running(tmp_path / "mine.py", site=site, modules=CLIENT) as process:
        assert process.stdout is not None
        found = re.search(r"port (\d+)", process.stdout.readline())
        assert found is not None
        observation = synthetic_observation(cameras={"overhead": synthetic_view()})
        with conversation(int(found[1])) as policy:
            card = policy.start()
            assert (card.name, card.control_hz) == ("served", 5.0)
            policy.reset("touch", SESSION)
            replies = [policy.act(observation) for _ in range(4)]
            assert [len(reply.actions) for reply in replies] == [1, 3, 1, 2]
            high = SESSION.action_bounds.workspace_high_m[2]
            assert [action.pose_tcp_in_base[2] for action in replies[1].actions] == [high] * 3
            assert (replies[2].actions[0].done, replies[3].actions[1].done) == (True, True)
            assert replies[3].notes == {"calls": 4}
            with pytest.raises(PolicyError, match=r"Traceback(?s:.*)ValueError: the fifth") as caught:
                policy.act(observation)
        assert caught.value.notes == {"calls": 5}


def test_the_client_package_is_short() -> None:
    assert len((CLIENT / "carecontact_client.py").read_text().splitlines()) < 200


@pytest.mark.slow
@pytest.mark.parametrize("numpy", ["numpy<2", "numpy>=2"])
def test_the_client_package_installs_with_either_numpy(tmp_path: Path, numpy: str) -> None:
    """Installs from the package index, with uv."""
    uv, python = ROOT / ".venv-uv" / "bin" / "uv", tmp_path / "env" / "bin" / "python"
    source = shutil.copytree(CLIENT, tmp_path / "client")
    # Not in this repository, whose own settings for uv would choose numpy.
    run = functools.partial(subprocess.run, check=True, cwd=tmp_path)
    run([uv, "venv", "--quiet", tmp_path / "env"])
    run([uv, "pip", "install", "--quiet", "--python", python, numpy, source])
    script = (
        "import numpy as np, carecontact_client as c\n"
        "m = c.decode(c.encode({'a': np.arange(6, dtype='>f4').reshape(2, 3).T, 'n': np.int64(3)}))\n"
        "assert m['n'] == 3 and m['a'].dtype == np.dtype('<f4') and m['a'].tolist() == [[0, 3], [1, 4], [2, 5]]\n"
        "print(np.__version__)"
    )
    done = run([python, "-I", "-c", script], capture_output=True, text=True)
    assert done.stdout.startswith("1." if "<" in numpy else "2.")


def test_the_client_holds_the_last_view_of_each_camera_and_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(CLIENT))
    client = importlib.import_module("carecontact_client")
    shown: list[dict[str, Any]] = []

    class Holds:
        def reset(self, instruction: str, session: object) -> None: ...

        def act(self, observation: dict[str, Any]) -> dict[str, Any]:
            shown.append(observation["cameras"])
            return {"look": ["wrist"]}

    views: dict[str, Any] = {}
    looks = [(0.0, {"wrist": {"rgb": 1}, "overhead": {"rgb": 2}}), (0.1, {}), (0.2, {"wrist": {"rgb": 3}})]
    for time_s, cameras in looks:
        message = {"type": "act", "observation": {"sim_time_s": time_s, "cameras": cameras}}
        answer = client._answer(Holds(), message, views)
        assert answer["actions"] == [{"look": ["wrist"]}]
    overhead, wrist = {"rgb": 2, "sim_time_s": 0.0}, {"rgb": 1, "sim_time_s": 0.0}
    assert shown == [
        {"wrist": wrist, "overhead": overhead},
        {"wrist": wrist, "overhead": overhead},
        {"wrist": {"rgb": 3, "sim_time_s": 0.2}, "overhead": overhead},
    ]
    client._answer(Holds(), {"type": "reset", "instruction": "", "session": {}}, views)
    assert views == {}
