"""Runs trials on a Ray cluster: the engine on the driver, and the task of a node.

A task is one trial, which the node's own worker runs. Its files come back as bytes through Ray's object store, so that
the nodes need no common storage. Ray decides where each trial runs. If a node dies, its trials run elsewhere: Ray
reports each of them, and the supervisor begins it again.
"""

from __future__ import annotations

import errno
import os
import pickle
import platform
import socket
import tempfile
import time
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

from carecontact import __version__
from carecontact.errors import CarecontactError, ConfigError, DependencyError, RecordingError
from carecontact.interface.policy import PolicyRef
from carecontact.protocol.protocol import TrialSpec
from carecontact.recording import open_recording, write_recording
from carecontact.recording.file import is_full
from carecontact.recording.schema import KILLED
from carecontact.running.engine import Ended, RunSettings
from carecontact.running.lost import harness_error_recording
from carecontact.running.machine import check_ready
from carecontact.running.workers import WORKER_COMMAND, Launcher, Workers
from carecontact.runs.identity import identity_of
from carecontact.runs.manifest import MANIFEST
from carecontact.serving.sandbox import private_folder

POLL_S = 0.05
ATTEMPTS = 3
"""Most attempts of one command at a trial whose node or process Ray lost."""
ANSWER_S = 10.0
"""Longest wait for a connection to the cluster's address [s]; Ray itself would try for minutes."""
NEEDS = "--engine ray needs the package ray: pip install 'carecontact[cluster]', here and on every node"


@dataclass(frozen=True, kw_only=True)
class NodeTask:
    spec: TrialSpec
    run: RunSettings
    """Settings of the run on the driver. The folder that the task runs in holds the modules of an imported policy."""
    earlier: bytes | None
    """File of an attempt at the trial that an earlier command lost."""


@dataclass(frozen=True, kw_only=True)
class NodeDone:
    node: str
    kind: Literal["recorded", "lost", "unreached", "refused"] = "recorded"
    """As of ``Ended``; ``refused``: no trial of this run may run on this node."""
    why: str = ""
    recording: bytes = b""
    log: bytes | None = None
    warnings: tuple[str, ...] | None = None


def carry_out(release: str, packed: bytes) -> NodeDone:
    """Run the trial of a pickled ``NodeTask``, again if a signal killed it. ``release``: that packed the task."""
    node = platform.node()
    if release != __version__:
        why = f"it has carecontact {__version__}, and the command has {release}"
        return NodeDone(node=node, kind="refused", why=why)
    task: NodeTask = pickle.loads(packed)
    if task.run.policy.ref.kind == "importable":
        here = replace(task.run.policy, search_path=(os.getcwd(),))
        task = replace(task, run=replace(task.run, policy=here))
    try:
        if found := differences(task):
            return NodeDone(node=node, kind="refused", why=found)
        return _carried_out(task, node)
    except OSError as error:
        if not is_full(error):
            raise
        return NodeDone(node=node, kind="lost", why=os.strerror(errno.ENOSPC))


def differences(task: NodeTask) -> str:
    """List what differs here from the planning command, or why this node cannot run trials; empty if nothing does."""
    policy, planned = task.run.policy, task.run.identity
    try:
        check_ready()
        here = identity_of(task.spec, search_path=policy.search_path, language=policy.language)
    except CarecontactError as error:
        return str(error)
    found = here.differences(versions=planned.versions, sha256=planned.sha256, world=planned.world)
    if here.policy_sha256 != planned.policy_sha256:
        found.append(f"the file of {task.spec.policy} {'differs' if here.policy_sha256 else 'is not there'}")
    for name, wanted in planned.argument_files.items():
        if here.argument_files.get(name) != wanted:
            state = "differs" if name in here.argument_files else "is not there"
            found.append(f"{task.spec.policy_arguments[name]} (policy argument {name}) {state}")
    if here.language != planned.language:
        found.append(f"the language backend was {planned.language}, is {here.language}")
    return "; ".join(found)


def _carried_out(task: NodeTask, node: str) -> NodeDone:
    folder, trial_id = private_folder(), task.spec.trial_id
    try:
        out, work = folder.path / "out", folder.path / "work"
        out.mkdir()
        work.mkdir()
        recorded, log = out / f"{trial_id}.h5", out / f"{trial_id}.log"
        if task.earlier is not None:
            recorded.write_bytes(task.earlier)
        policy = replace(task.run.policy, closed=(*task.run.policy.closed, str(folder.path)))
        killed = frozenset[str]() if task.earlier is None else frozenset({trial_id})
        settings = replace(task.run, out=out, work=work, policy=policy, killed=killed)
        workers, ended = Workers(settings, _launcher(task.run.command or WORKER_COMMAND)), None
        try:
            # As many attempts as ``Losses`` allows.
            while ended is None or ended.kind == "lost":
                workers.start(task.spec)
                while not (found := workers.finished()):
                    time.sleep(POLL_S)
                ended = found[0]
        finally:
            workers.kill_all()
        if ended.kind == "unreached":
            return NodeDone(node=node, kind="unreached", why=ended.why)
        if ended.recording is None:
            return NodeDone(node=node, kind="lost", why=ended.why)
        written = log.read_bytes() if log.exists() else None
        return NodeDone(node=node, recording=recorded.read_bytes(), log=written, warnings=ended.warnings)
    finally:
        folder.remove()


@cache
def _launcher(command: tuple[str, ...]) -> Launcher:
    """The launcher of all trials of this process of the cluster; its fork server ends with the process."""
    return Launcher(command)


def connect(*policies: PolicyRef) -> None:
    """Connect once to a cluster. The current folder goes to the nodes, without runs, if a policy comes from it."""
    try:
        ray: Any = import_module("ray")
    except ModuleNotFoundError:
        raise DependencyError(NEEDS) from None
    if ray.is_initialized():
        return
    here = Path.cwd()
    imported = any(policy.kind == "importable" for policy in policies)
    shipped = {"working_dir": str(here), "excludes": _excluded(here)} if imported else {}
    # Ray's own default is not to look for a driver's variables.
    where = os.environ.get("RAY_ADDRESS") or "auto"
    try:
        _reach(where)
        ray.init(address=where, runtime_env=shipped, log_to_driver=False, logging_level="error")
    except ConnectionError as error:
        place = "on this machine" if where == "auto" else f"at {where}"
        raise ConfigError(
            f"--engine ray: no Ray cluster answers {place} ({' '.join(str(error).split())[:200]}); start one with `ray "
            "start --head`, set RAY_ADDRESS=HOST:6379, or set the token that it wants (docs/machines.md)"
        ) from None
    except Exception as error:
        if shipped and "size" in str(error):
            raise ConfigError(
                f"--engine ray: the current folder cannot go to the nodes with the policy: {error}; give the command "
                "in a folder that holds the policy alone, or serve the policy (docs/machines.md)"
            ) from None
        if isinstance(error, ValueError):
            raise ConfigError(
                f"--engine ray: RAY_ADDRESS {where!r} cannot be used: {' '.join(str(error).split())[:200]}; expected "
                "HOST:PORT of the cluster's head, such as 192.0.2.7:6379"
            ) from None
        raise


def _reach(address: str) -> None:
    """Raises ConnectionError where nothing listens at ``HOST:PORT``; another kind of address is left to Ray."""
    host, _, port = address.rpartition(":")
    if not host or "/" in host or not port.isdecimal():
        return
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=ANSWER_S).close()
    except OSError as error:
        raise ConnectionError(str(error)) from None


def asks_for_a_token() -> bool:
    """Whether the cluster, as far as this process knows, takes orders from those alone who know its token."""
    return os.environ.get("RAY_AUTH_MODE") == "token"


def _excluded(folder: Path) -> list[str]:
    """Folders that are not sent to the nodes: those of runs, which no policy may read, and hidden ones."""
    runs = [path.parent for pattern in ("*", "*/*", "*/*/*") for path in folder.glob(f"{pattern}/{MANIFEST}")]
    return [".?*", "__pycache__", *(f"/{run.relative_to(folder).as_posix()}/" for run in runs)]


class RayTrials:
    """The engine ``ray``. Call ``connect`` before you make one."""

    def __init__(self, run: RunSettings, *, gpus: float = 0.0) -> None:
        """``gpus``: share of a GPU that Ray reserves for each trial."""
        self._run, self._gpus = run, gpus
        self.running: dict[Any, TrialSpec] = {}
        self._lost: dict[str, list[str]] = {}
        self._ray: Any = import_module("ray")
        # A task that Ray would repeat by itself repeats unseen: the supervisor does it, and says so.
        self._remote: Any = self._ray.remote(num_cpus=1, num_gpus=gpus, max_retries=0)(carry_out)

    def slots(self) -> int:
        """Return one trial for each core of the nodes that are there now."""
        return max(1, int(self._ray.cluster_resources().get("CPU", 0)))

    def start(self, spec: TrialSpec) -> None:
        lost = self._run.out / f"{spec.trial_id}.h5"
        earlier = lost.read_bytes() if spec.trial_id in self._run.killed and lost.is_file() else None
        task = NodeTask(spec=spec, run=self._run, earlier=earlier)
        self.running[self._remote.remote(__version__, pickle.dumps(task))] = spec

    def finished(self) -> list[Ended]:
        if not self.running:
            return []
        ready, _ = self._ray.wait(list(self.running), num_returns=len(self.running), timeout=0)
        return [self._ended(self.running.pop(ref), ref) for ref in ready]

    def waiting(self) -> dict[str, str]:
        there = self._ray.cluster_resources()
        if there.get("CPU", 0) < 1:
            lacks = "core"
        elif there.get("GPU", 0) < self._gpus:
            lacks = f"node with the GPUs that --gpus {self._gpus:g} reserves"
        else:
            return {}
        return {spec.trial_id: f"waits: the cluster has no {lacks}" for spec in self.running.values()}

    def kill_all(self) -> None:
        for ref in self.running:
            self._ray.cancel(ref, force=True)
        self.running.clear()

    def _ended(self, spec: TrialSpec, ref: Any) -> Ended:
        try:
            done: NodeDone = self._ray.get(ref)
        except self._ray.exceptions.RayTaskError as error:
            last = str(error).strip().splitlines()[-1]
            raise ConfigError(
                f"--engine ray: a node cannot run trials: {last}; it needs the same carecontact and ray as this "
                "machine (docs/machines.md)"
            ) from None
        except self._ray.exceptions.RayError as error:
            return self._once_more(spec, f"Ray lost it: {str(error).strip().splitlines()[0]}")
        if done.kind == "refused":
            raise ConfigError(f"--engine ray: node {done.node} cannot run trials of this run: {done.why}")
        if done.kind == "unreached":
            return Ended(spec=spec, kind="unreached", why=f"{done.why} (from node {done.node})")
        if done.kind == "lost":
            return self._once_more(spec, f"node {done.node}: {done.why}")
        return self._stored(spec, done)

    def _stored(self, spec: TrialSpec, done: NodeDone) -> Ended:
        partial = Path(tempfile.mkdtemp(dir=self._run.work)) / "trial.h5"
        partial.write_bytes(done.recording)
        try:
            recording = open_recording(partial)
        except RecordingError as error:
            return self._once_more(spec, f"what node {done.node} sent cannot be read: {error}")
        os.replace(partial, self._run.out / f"{spec.trial_id}.h5")
        log = self._run.out / f"{spec.trial_id}.log"
        if done.log is None:
            log.unlink(missing_ok=True)
        else:
            log.write_bytes(done.log)
        return Ended(spec=spec, kind="recorded", recording=recording, warnings=done.warnings)

    def _once_more(self, spec: TrialSpec, why: str) -> Ended:
        """Another attempt, or after ATTEMPTS of them a recording that says so; the same command then tries again."""
        reasons = self._lost.setdefault(spec.trial_id, [])
        reasons.append(why)
        if len(reasons) < ATTEMPTS:
            return Ended(spec=spec, kind="lost", why=why)
        message = f"the trial was lost {ATTEMPTS} times\n" + "\n".join(reasons)
        recording = harness_error_recording(spec, kind=KILLED, message=message)
        write_recording(recording, self._run.out / f"{spec.trial_id}.h5")
        return Ended(spec=spec, kind="recorded", recording=recording)
