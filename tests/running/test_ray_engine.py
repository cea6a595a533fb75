"""The engine ``ray`` on a stand-in for the package: what it makes of what Ray says. tests/slow has a real cluster."""

from __future__ import annotations

import json
import pickle
import socket
import sys
import tempfile
import types
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from carecontact import __version__
from carecontact.errors import ConfigError, DependencyError
from carecontact.interface.policy import PolicyRef
from carecontact.protocol.load import load_protocol
from carecontact.recording import Header, read_recording, write_recording
from carecontact.running import ray_engine
from carecontact.running.engine import RunSettings
from carecontact.running.machine import check_ready
from carecontact.running.ray_engine import ATTEMPTS, NodeDone, NodeTask, RayTrials, carry_out, connect
from carecontact.running.supervisor import TrialEvent, check_engine, open_run
from carecontact.running.workers import Workers
from carecontact.runs.identity import identity_of
from carecontact.runs.manifest import MANIFEST
from carecontact.runs.plan import plan_trials
from carecontact.serving.conversation import PolicySetup
from tests.running.fake_worker import recording

SPECS = plan_trials(protocol=load_protocol("bathing-v3"), policy="hover", tasks=["T1"], seeds=range(3))


class RayError(Exception):
    pass


class RayTaskError(RayError):
    pass


class Remote:
    """Runs nothing: the answer of the nodes is what a test says."""

    def __init__(self, ray: FakeRay) -> None:
        self.ray = ray

    def __call__(self, function: object) -> Remote:
        return self

    def remote(self, release: str, packed: bytes) -> str:
        task = pickle.loads(packed)
        self.ray.tasks.append(task)
        return f"{task.spec.trial_id} {len(self.ray.tasks)}"


class FakeRay(types.ModuleType):
    def __init__(self) -> None:
        super().__init__("ray")
        self.exceptions = types.SimpleNamespace(RayError=RayError, RayTaskError=RayTaskError)
        self.tasks: list[Any] = []
        self.answers: dict[str, list[Any]] = {}
        self.cpus, self.gpus, self.cancelled, self.began = 2.0, 0.0, list[str](), dict[str, Any]()
        self.refusal: Exception | None = None

    def is_initialized(self) -> bool:
        return bool(self.began)

    def init(self, **options: Any) -> None:
        if self.refusal is not None:
            raise self.refusal
        self.began = options

    def remote(self, **options: Any) -> Remote:
        assert options == {"num_cpus": 1, "num_gpus": options["num_gpus"], "max_retries": 0}
        return Remote(self)

    def cluster_resources(self) -> dict[str, float]:
        return {"CPU": self.cpus, "GPU": self.gpus}

    def wait(self, refs: list[str], **options: Any) -> tuple[list[str], list[str]]:
        return refs, []

    def get(self, ref: str) -> Any:
        answer = self.answers[ref.partition(" ")[0]].pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def cancel(self, ref: str, *, force: bool) -> None:
        self.cancelled.append(ref)


@pytest.fixture
def ray(monkeypatch: pytest.MonkeyPatch) -> FakeRay:
    made = FakeRay()
    monkeypatch.setitem(sys.modules, "ray", made)
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    monkeypatch.setattr(ray_engine, "_reach", lambda address: None)
    return made


def sent(seed: int, folder: Path, *, ended: str = "done", **more: Any) -> NodeDone:
    path = write_recording(recording(SPECS[seed], ended), folder / "sent.h5")
    return NodeDone(node="far", recording=path.read_bytes(), **more)


def run(ray: FakeRay, out: Path, *, specs: Any = SPECS) -> tuple[dict[str, str], list[TrialEvent]]:
    events: list[TrialEvent] = []
    with open_run(specs, out=out, engine="ray", on_event=events.append) as found:
        while found.advance(None):
            pass
    return found.ended, events  # pyright: ignore[reportReturnType]


def test_a_trial_whose_node_died_runs_elsewhere_and_the_recordings_are_gathered(ray: FakeRay, tmp_path: Path) -> None:
    out = tmp_path / "r"
    ray.answers = {
        "T1-s000": [RayError("the node was dead\nmore"), sent(0, tmp_path)],
        "T1-s001": [sent(1, tmp_path, ended="process_failure", log=b"why", warnings=("look",))],
        "T1-s002": [NodeDone(node="far", recording=b"damaged"), sent(2, tmp_path)],
    }
    ended, events = run(ray, out)
    assert ended == {"T1-s000": "done", "T1-s001": "process_failure", "T1-s002": "done"}
    assert {path.name for path in out.iterdir()} == {"T1-s000.h5", "T1-s001.h5", "T1-s001.log", "T1-s002.h5", MANIFEST}
    again = {event.trial_id: event.message for event in events if event.kind == "redo"}
    assert again["T1-s000"] == "Ray lost it: the node was dead"
    assert "what node far sent cannot be read" in (again["T1-s002"] or "")
    assert [event.message for event in events if event.kind == "warned"] == ["look"]
    closed = {place for task in ray.tasks for place in task.run.policy.closed}
    assert str(out) in closed


def test_a_trial_that_is_lost_again_and_again_is_recorded_and_the_same_command_repeats_it(
    ray: FakeRay, tmp_path: Path
) -> None:
    ray.answers = {"T1-s000": [RayError(f"death {k}") for k in range(ATTEMPTS)]}
    ended, _ = run(ray, tmp_path / "r", specs=SPECS[:1])
    assert ended == {"T1-s000": "harness_error"}
    failure = read_recording(tmp_path / "r/T1-s000.h5").header.failure
    assert failure is not None
    assert all(f"death {k}" in failure.message for k in range(ATTEMPTS))
    ray.answers = {"T1-s000": [sent(0, tmp_path)]}
    ended, _ = run(ray, tmp_path / "r", specs=SPECS[:1])
    assert ended == {"T1-s000": "done"}
    assert ray.tasks[-1].earlier is not None


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (NodeDone(node="far", kind="refused", why="mujoco was 1, is 2"), "node far cannot run trials .* mujoco was 1"),
        (RayTaskError("...\nModuleNotFoundError: No module named 'x'"), "a node cannot run trials: ModuleNot"),
    ],
)
def test_a_node_that_cannot_run_trials_stops_the_run_and_what_runs(
    ray: FakeRay, tmp_path: Path, answer: object, message: str
) -> None:
    ray.answers = {"T1-s000": [answer]}
    with pytest.raises(ConfigError, match=message):
        run(ray, tmp_path / "r")
    assert ray.cancelled == ["T1-s001 2"]
    assert not list((tmp_path / "r").glob("*.h5"))


def test_a_server_that_a_node_cannot_reach_stops_the_run(ray: FakeRay, tmp_path: Path) -> None:
    ray.answers = {
        "T1-s000": [NodeDone(node="far", kind="unreached", why="nothing listens")],
        "T1-s001": [sent(1, tmp_path)],
    }
    with open_run(SPECS, out=tmp_path / "r", engine="ray") as found:
        while found.advance(None):
            pass
    assert found.summary().unreached == "nothing listens (from node far)"
    assert found.ended == {"T1-s001": "done"}


def test_as_many_trials_begin_as_the_cluster_has_cores_now(ray: FakeRay, tmp_path: Path) -> None:
    engine = RayTrials(task().run, gpus=0.25)
    ray.cpus = 3
    assert engine.slots() == 3
    ray.cpus = 0
    assert engine.slots() == 1
    engine.start(SPECS[0])
    assert engine.waiting() == {"T1-s000": "waits: the cluster has no core"}
    ray.cpus = 3
    assert engine.waiting() == {"T1-s000": "waits: the cluster has no node with the GPUs that --gpus 0.25 reserves"}
    ray.gpus = 1.0
    assert engine.waiting() == {}
    assert len(engine.running) == 1
    engine.kill_all()
    assert not engine.running


def test_the_folder_of_an_imported_policy_goes_to_the_nodes_without_runs(
    ray: FakeRay, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "runs/mine").mkdir(parents=True)
    (tmp_path / "runs/mine" / MANIFEST).touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("RAY_ADDRESS", "192.0.2.7:6379")
    connect(PolicyRef.parse("mine:P"))
    assert ray.began["address"] == "192.0.2.7:6379"
    assert ray.began["runtime_env"] == {"working_dir": str(tmp_path), "excludes": [".?*", "__pycache__", "/runs/mine/"]}


def test_the_folder_goes_to_the_nodes_whichever_policy_of_a_sweep_needs_it(ray: FakeRay, tmp_path: Path) -> None:
    shipped, mine = (PolicySetup(ref=PolicyRef.parse(text)) for text in ("hover", "mine:P"))
    check_engine("ray", shipped, mine, gpus=0)
    assert ray.began["runtime_env"]["working_dir"] == str(Path.cwd())


def test_an_address_where_nothing_listens_is_named_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    made = FakeRay()
    monkeypatch.setitem(sys.modules, "ray", made)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    monkeypatch.setenv("RAY_ADDRESS", f"127.0.0.1:{port}")
    with pytest.raises(ConfigError, match=rf"no Ray cluster answers at 127\.0\.0\.1:{port} \(.*refused"):
        connect(PolicyRef.parse("hover"))
    assert not made.began, "Ray was not asked"


def test_a_cluster_without_a_token_is_warned_about_where_a_policy_runs_on_it(
    ray: FakeRay, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("RAY_AUTH_MODE", raising=False)
    local, far = (PolicySetup(ref=PolicyRef.parse(text)) for text in ("hover", "ws://192.0.2.7:8765"))
    assert "set RAY_AUTH_MODE=token" in check_engine("ray", local, gpus=0)
    assert check_engine("ray", far, gpus=0) == check_engine("local", local, gpus=0) == ""
    monkeypatch.setenv("RAY_AUTH_MODE", "token")
    assert check_engine("ray", local, gpus=0) == ""


def test_what_keeps_from_a_cluster_is_one_sentence(ray: FakeRay, monkeypatch: pytest.MonkeyPatch) -> None:
    hover = PolicySetup(ref=PolicyRef.parse("hover"))
    ray.refusal = ConnectionError("nothing\n  there")
    with pytest.raises(
        ConfigError, match=r"no Ray cluster answers on this machine \(nothing there\); start one with `ray"
    ):
        check_engine("ray", hover, gpus=0)
    monkeypatch.setenv("RAY_ADDRESS", "192.0.2.7:6379")
    with pytest.raises(ConfigError, match=r"no Ray cluster answers at 192\.0\.2\.7:6379"):
        check_engine("ray", hover, gpus=0)
    ray.refusal = ValueError("Package size (700MiB) exceeds the maximum size of 512.00MiB")
    with pytest.raises(ConfigError, match=r"the current folder cannot go to the nodes .*700MiB.*or serve the policy"):
        check_engine("ray", PolicySetup(ref=PolicyRef.parse("mine:P")), gpus=0)
    monkeypatch.setenv("RAY_ADDRESS", "banana")
    ray.refusal = ValueError("Invalid address format: banana")
    with pytest.raises(ConfigError, match=r"RAY_ADDRESS 'banana' cannot be used: Invalid .*expected HOST:PORT"):
        check_engine("ray", hover, gpus=0)
    with pytest.raises(ConfigError, match="--record: not with --engine ray"):
        check_engine("ray", replace(hover, record="file"), gpus=0)
    with pytest.raises(ConfigError, match="--gpus: only --engine ray"):
        check_engine("local", hover, gpus=0.5)

    def absent(name: str) -> object:
        raise ModuleNotFoundError(name)

    monkeypatch.setattr(ray_engine, "import_module", absent)
    with pytest.raises(DependencyError, match=r"pip install 'carecontact\[cluster\]', here and on every node"):
        check_engine("ray", hover, gpus=0)


# What a node does with one trial, without a cluster.

FAKE = (sys.executable, str(Path(__file__).with_name("fake_worker.py")))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("FAKE_LOG", str(tmp_path / "ran.txt"))
    monkeypatch.setenv("FAKE_PLAN", "{}")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def task(
    policy: str = "hover", *, search_path: tuple[str, ...] = (), earlier: bytes | None = None, **changes: Any
) -> NodeTask:
    spec = plan_trials(protocol=load_protocol("bathing-v3"), policy=policy, tasks=["T1"], seeds=[0])[0]
    settings = RunSettings(
        out=Path("out"),
        work=Path("work"),
        policy=PolicySetup(ref=PolicyRef.parse(policy), search_path=search_path),
        identity=identity_of(spec, search_path=search_path),
        trial_limit_s=60.0,
        command=FAKE,
    )
    return NodeTask(spec=spec, run=replace(settings, **changes), earlier=earlier)


def done(made: NodeTask, *, release: str = __version__) -> NodeDone:
    return carry_out(release, pickle.dumps(made))


def header_of(found: NodeDone, folder: Path) -> Header:
    (folder / "back.h5").write_bytes(found.recording)
    return read_recording(folder / "back.h5").header


def refusal(made: NodeTask, *, release: str = __version__) -> str | None:
    found = done(made, release=release)
    return found.why if found.kind == "refused" else None


def test_a_trial_comes_back_as_bytes_and_leaves_nothing(folder: Path) -> None:
    found = done(task())
    assert header_of(found, folder).spec == task().spec
    assert (found.kind, found.log) == ("recorded", None)
    assert [path.name for path in folder.iterdir() if path.is_dir()] == []
    request = json.loads((folder / "requests.jsonl").read_text())
    closed = tuple(request["policy"]["closed"])
    assert request["out"].startswith(closed), "the folder of the recording is closed to the policy"


def test_what_a_signal_killed_runs_once_more_there_and_a_failure_brings_its_log(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAKE_PLAN", json.dumps({"T1-s000": ["kill", "policy"]}))
    found = done(task())
    assert (folder / "ran.txt").read_text().count("T1-s000") == 2
    assert found.log is not None
    assert b"NoGrip: nothing there" in found.log


def test_an_attempt_that_an_earlier_command_lost_binds_the_repetition(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The policy was killed after the answers a b; elsewhere it answers a c, which does not count."""
    monkeypatch.setenv("FAKE_PLAN", json.dumps({"T1-s000": "policy_killed:ab"}))
    lost = done(task())
    monkeypatch.setenv("FAKE_PLAN", json.dumps({"T1-s000": "good:ac"}))
    found = done(task(earlier=lost.recording))
    failure = header_of(found, folder).failure
    assert failure is not None
    assert failure.kind == "other_answers"


def test_a_node_without_space_gives_the_trial_back(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FAKE_PLAN", json.dumps({"T1-s000": "full"}))
    found = done(task())
    assert found.kind == "lost"
    assert "No space left on device" in found.why


def test_a_node_of_another_release_or_with_other_files_is_refused(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert refusal(task(), release="0.0.0") == f"it has carecontact {__version__}, and the command has 0.0.0"
    identity = task().run.identity
    other = identity.model_copy(update={"versions": {**identity.versions, "mujoco": "9.9.9"}})
    assert refusal(task(identity=other)) == "mujoco was 9.9.9, is 4.0.0"
    assert not (folder / "ran.txt").exists()

    module = folder / "mine.py"
    module.write_text("class P: pass\n")
    monkeypatch.chdir(folder)
    made = task("mine:P", search_path=(str(folder),))
    assert refusal(made) is None
    module.write_text("class P: x = 1\n")
    assert refusal(made) == "the file of mine:P differs"
    module.unlink()
    assert refusal(made) == "the file of mine:P is not there"


def test_a_node_that_cannot_render_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    check_ready.cache_clear()
    monkeypatch.setenv("MUJOCO_GL", "nonsense")
    refused = refusal(task())
    assert refused is not None
    assert refused.startswith("this machine cannot run trials: OpenGL: MUJOCO_GL=nonsense")
    assert not (folder / "ran.txt").exists()


def test_a_policy_that_was_shipped_lies_where_the_task_runs(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "there").mkdir()
    (folder / "there/mine.py").write_text("class P: pass\n")
    made = task("mine:P", search_path=(str(folder / "there"),))
    assert refusal(made) == "the file of mine:P is not there"
    monkeypatch.chdir(folder / "there")
    assert refusal(made) is None
    request = json.loads((folder / "requests.jsonl").read_text())
    assert request["policy"]["search_path"] == [str(folder / "there")]


def test_no_process_is_left_where_a_task_is_interrupted(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FAKE_PLAN", json.dumps({"T1-s000": "hang"}))
    killed: list[int] = []
    kill_all = Workers.kill_all

    def watched(workers: Workers) -> None:
        killed.append(len(workers.running))
        kill_all(workers)

    def interrupted(seconds: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Workers, "kill_all", watched)
    monkeypatch.setattr(ray_engine.time, "sleep", interrupted)
    with pytest.raises(KeyboardInterrupt):
        done(task())
    assert killed == [1]
