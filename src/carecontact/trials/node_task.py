"""One trial on a node of a cluster: the node's own worker runs it, and its files go back as bytes."""

from __future__ import annotations

import errno
import os
import pickle
import platform
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from carecontact import __version__
from carecontact.contract.trial import TrialSpec
from carecontact.errors import CarecontactError
from carecontact.hosting.isolation.private_folder import private_folder
from carecontact.hosting.setup import PolicySetup
from carecontact.recording.storage import is_full
from carecontact.runs.identity import Identity, identity_of
from carecontact.trials.engine import Ended
from carecontact.trials.launch import WORKER_COMMAND, Launcher
from carecontact.trials.lost import Losses
from carecontact.trials.machine import check_ready
from carecontact.trials.workers import Workers

POLL_S = 0.05


@dataclass(frozen=True, kw_only=True)
class NodeTask:
    spec: TrialSpec
    policy: PolicySetup
    shipped: bool
    """Whether the policy's modules lie in the folder that the task runs in."""
    identity: Identity
    """Identity of the run, as the command that planned the trial determined it."""
    weights: Path | None
    pace_s: float | None
    trial_limit_s: float
    command: Sequence[str] | None
    """Command that starts the trial's process; None: this node's own."""
    earlier: bytes | None
    """File of an attempt at the trial that an earlier command lost."""


@dataclass(frozen=True, kw_only=True)
class NodeDone:
    node: str
    recording: bytes | None = None
    log: bytes | None = None
    warnings: tuple[str, ...] | None = None
    unreached: str | None = None
    lost: str | None = None
    """Why the trial has to run once more, elsewhere if possible."""
    refused: str | None = None
    """Why no trial of this run may run on this node."""


def carry_out(release: str, packed: bytes) -> NodeDone:
    """Run the trial to its end, with a second attempt where a signal killed a process of the first.

    Args:
        release: of the carecontact that packed the task.
        packed: a ``NodeTask``, pickled.
    """
    node = platform.node()
    if release != __version__:
        return NodeDone(node=node, refused=f"it has carecontact {__version__}, and the command has {release}")
    task: NodeTask = pickle.loads(packed)
    if task.shipped:
        task = replace(task, policy=replace(task.policy, search_path=(os.getcwd(),)))
    try:
        if found := differences(task):
            return NodeDone(node=node, refused=found)
        return _carried_out(task, node)
    except OSError as error:
        if not is_full(error):
            raise
        return NodeDone(node=node, lost=f"node {node}: {os.strerror(errno.ENOSPC)}")


def differences(task: NodeTask) -> str:
    """List what differs between this node and the planning command and influences the results, or why this node cannot
    run trials; empty if nothing does."""
    try:
        check_ready()
        here = identity_of(task.spec, search_path=task.policy.search_path, language=task.policy.language)
    except CarecontactError as error:
        return str(error)
    told = here.differences(versions=task.identity.versions, sha256=task.identity.sha256, world=task.identity.world)
    if here.policy_sha256 != task.identity.policy_sha256:
        told.append(f"the file of {task.spec.policy} {'differs' if here.policy_sha256 else 'is not there'}")
    for name, wanted in task.identity.argument_files.items():
        if here.argument_files.get(name) != wanted:
            state = "differs" if name in here.argument_files else "is not there"
            told.append(f"{task.spec.policy_arguments[name]} (policy argument {name}) {state}")
    if here.language != task.identity.language:
        told.append(f"the language backend was {task.identity.language}, is {here.language}")
    return "; ".join(told)


def _carried_out(task: NodeTask, node: str) -> NodeDone:
    folder = private_folder()
    try:
        out, work = folder.path / "out", folder.path / "work"
        out.mkdir()
        work.mkdir()
        trial_id, before = task.spec.trial_id, set[str]()
        if task.earlier is not None:
            (out / f"{trial_id}.h5").write_bytes(task.earlier)
            before.add(trial_id)
        setup = replace(task.policy, closed=(*task.policy.closed, str(folder.path)))
        workers = Workers(
            out=out, work=work, policy=setup, weights=task.weights, pace_s=task.pace_s,
            launcher=_launcher(tuple(task.command or WORKER_COMMAND)), trial_limit_s=task.trial_limit_s,
            losses=Losses(setup, out=out, before=before),
        )  # fmt: skip
        try:
            ended = _ended(workers, task.spec)
        finally:
            workers.kill_all()
        log = out / f"{trial_id}.log"
        return NodeDone(
            node=node,
            recording=(out / f"{trial_id}.h5").read_bytes() if ended.recording is not None else None,
            log=log.read_bytes() if log.exists() else None,
            warnings=ended.warnings,
            unreached=ended.unreached,
            lost=next((f"node {node}: {why}" for why in (ended.unstored, ended.lacked) if why is not None), None),
        )
    finally:
        folder.remove()


@cache
def _launcher(command: tuple[str, ...]) -> Launcher:
    """Return the launcher of all trials that this process of the cluster runs; its fork server ends with this
    process."""
    return Launcher(command)


def _ended(workers: Workers, spec: TrialSpec) -> Ended:
    """Return how the last attempt ended, out of as many as ``Losses`` allows."""
    workers.start(spec)
    while True:
        for ended in workers.finished():
            if ended.lost is None:
                return ended
            workers.start(spec)
        time.sleep(POLL_S)
