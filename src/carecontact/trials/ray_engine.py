"""The engine ``ray``: the trials of a run on the nodes of a Ray cluster, which also decides where each of them runs.

A task is one trial. Its recording comes back through Ray's object store, so that the nodes need no common storage. If
a node dies, its trials run elsewhere: Ray reports each of them, and the supervisor begins it anew.
"""

from __future__ import annotations

import os
import pickle
import shutil
import socket
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

from carecontact import __version__
from carecontact.contract.policy_ref import PolicyRef
from carecontact.contract.trial import TrialSpec
from carecontact.errors import ConfigError, DependencyError, RecordingError
from carecontact.recording import open_recording, write_recording
from carecontact.recording.schema import KILLED
from carecontact.runs.manifest import MANIFEST
from carecontact.trials.engine import Ended
from carecontact.trials.failed import harness_error_recording
from carecontact.trials.node_task import NodeDone, NodeTask, carry_out
from carecontact.trials.workers import ROOM_BYTES

ATTEMPTS = 3
"""Most attempts of one command at a trial whose node or process Ray lost."""
ANSWER_S = 10.0
"""Longest wait for a connection to the cluster's address [s]; Ray itself would try for minutes."""
NEEDS = "--engine ray needs the package ray: pip install 'carecontact[cluster]', here and on every node"


def connect(*policies: PolicyRef) -> None:
    """Connect this process to the cluster that RAY_ADDRESS names, or that runs on this machine; once.

    The current folder goes to the nodes if any of the policies is imported from it, without the folders of runs.

    Raises DependencyError without the package, ConfigError where there is no cluster or the folder is too large.
    """
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
            "start --head`, set RAY_ADDRESS=HOST:6379, or set the token that it wants (docs/cluster.md)"
        ) from None
    except Exception as error:
        if shipped and "size" in str(error):
            raise ConfigError(
                f"--engine ray: the current folder cannot go to the nodes with the policy: {error}; give the command "
                "in a folder that holds the policy alone, or serve the policy (docs/cluster.md)"
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
    """Whether the cluster, as far as this process is told, takes orders from those alone who know its token."""
    return os.environ.get("RAY_AUTH_MODE") == "token"


def _excluded(folder: Path) -> list[str]:
    """Folders that are not sent to the nodes: those of runs, which no policy may read, and hidden ones."""
    runs = [path.parent for pattern in ("*", "*/*", "*/*/*") for path in folder.glob(f"{pattern}/{MANIFEST}")]
    return [".?*", "__pycache__", *(f"/{run.relative_to(folder).as_posix()}/" for run in runs)]


@dataclass(kw_only=True)
class RayTrials:
    """The engine ``ray``. Call ``connect`` before you make one."""

    out: Path
    work: Path
    task: Mapping[str, Any]
    """Fields of ``NodeTask`` that all trials share."""
    killed: frozenset[str]
    """Trials that an earlier command lost to a signal."""
    gpus: float = 0.0
    """Share of a GPU that Ray reserves for each trial."""
    _running: dict[Any, TrialSpec] = field(default_factory=dict[Any, TrialSpec])
    _lost: dict[str, list[str]] = field(default_factory=dict[str, list[str]])

    def __post_init__(self) -> None:
        self._ray: Any = import_module("ray")
        # A task that Ray would repeat by itself repeats unseen: the supervisor does it, and says so.
        self._remote: Any = self._ray.remote(num_cpus=1, num_gpus=self.gpus, max_retries=0)(carry_out)

    def slots(self) -> int:
        """Return one trial for each core of the nodes that are there now."""
        return max(1, int(self._ray.cluster_resources().get("CPU", 0)))

    def count(self) -> int:
        return len(self._running)

    def has_room(self) -> bool:
        return shutil.disk_usage(self.work).free >= ROOM_BYTES * (len(self._running) + 1)

    def start(self, spec: TrialSpec) -> None:
        lost_before = self.out / f"{spec.trial_id}.h5" if spec.trial_id in self.killed else None
        earlier = lost_before.read_bytes() if lost_before is not None and lost_before.is_file() else None
        task = NodeTask(spec=spec, earlier=earlier, **self.task)
        self._running[self._remote.remote(__version__, pickle.dumps(task))] = spec

    def finished(self) -> list[Ended]:
        """Raises ConfigError for a node that cannot run trials of this run."""
        if not self._running:
            return []
        ready, _ = self._ray.wait(list(self._running), num_returns=len(self._running), timeout=0)
        return [self._ended(self._running.pop(ref), ref) for ref in ready]

    def waiting(self) -> dict[str, str]:
        there = self._ray.cluster_resources()
        if there.get("CPU", 0) < 1:
            lacks = "core"
        elif there.get("GPU", 0) < self.gpus:
            lacks = f"node with the GPUs that --gpus {self.gpus:g} reserves"
        else:
            return {}
        return {spec.trial_id: f"waits: the cluster has no {lacks}" for spec in self._running.values()}

    def kill_all(self) -> None:
        for ref in self._running:
            self._ray.cancel(ref, force=True)
        self._running.clear()

    def _ended(self, spec: TrialSpec, ref: Any) -> Ended:
        errors = self._ray.exceptions
        try:
            done: NodeDone = self._ray.get(ref)
        except errors.RayTaskError as error:
            last = str(error).strip().splitlines()[-1]
            raise ConfigError(
                f"--engine ray: a node cannot run trials: {last}; it needs the same carecontact and ray as this "
                "machine (docs/cluster.md)"
            ) from None
        except errors.RayError as error:
            return self._once_more(spec, f"Ray lost it: {str(error).strip().splitlines()[0]}")
        if done.refused is not None:
            raise ConfigError(f"--engine ray: node {done.node} cannot run trials of this run: {done.refused}")
        if done.unreached is not None:
            return Ended(spec=spec, recording=None, unreached=f"{done.unreached} (from node {done.node})")
        if done.lost is not None or done.recording is None:
            return self._once_more(spec, done.lost or f"node {done.node} sent no recording")
        return self._stored(spec, done, done.recording)

    def _stored(self, spec: TrialSpec, done: NodeDone, content: bytes) -> Ended:
        partial = Path(tempfile.mkdtemp(dir=self.work)) / "trial.h5"
        partial.write_bytes(content)
        try:
            recording = open_recording(partial)
        except RecordingError as error:
            return self._once_more(spec, f"what node {done.node} sent cannot be read: {error}")
        os.replace(partial, self.out / f"{spec.trial_id}.h5")
        log = self.out / f"{spec.trial_id}.log"
        if done.log is None:
            log.unlink(missing_ok=True)
        else:
            log.write_bytes(done.log)
        return Ended(spec=spec, recording=recording, warnings=done.warnings)

    def _once_more(self, spec: TrialSpec, why: str) -> Ended:
        """Another attempt, or after ATTEMPTS of them a recording that says so; the same command then tries again."""
        told = self._lost.setdefault(spec.trial_id, [])
        told.append(why)
        if len(told) < ATTEMPTS:
            return Ended(spec=spec, recording=None, lost=why)
        message = f"the trial was lost {ATTEMPTS} times\n" + "\n".join(told)
        recording = harness_error_recording(spec, kind=KILLED, message=message)
        write_recording(recording, self.out / f"{spec.trial_id}.h5")
        return Ended(spec=spec, recording=recording)
