"""Makes the engine of a given name for the trials of a run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from carecontact.errors import ConfigError
from carecontact.hosting.setup import PolicySetup
from carecontact.runs.identity import Identity
from carecontact.trials.engine import Engine, EngineName
from carecontact.trials.launch import WORKER_COMMAND, Launcher
from carecontact.trials.lost import Losses
from carecontact.trials.workers import Workers


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """The settings that all trials of one run share."""

    out: Path
    work: Path
    """Folder for files that are not finished."""
    policy: PolicySetup
    identity: Identity
    weights: Path | None
    pace_s: float | None
    trial_limit_s: float
    launcher: Launcher
    """Starts the trials' processes on this machine; on others, its command does."""
    killed: frozenset[str]
    """Trials that an earlier command lost to a signal."""


def check_engine(name: EngineName, *policies: PolicySetup, gpus: float) -> str:
    """Return a warning about what the engine opens to the policies of this command, or nothing.

    Raises ConfigError for what the engine cannot give or reach, DependencyError for one that is not installed.
    """
    if name == "local":
        if gpus:
            raise ConfigError("--gpus: only --engine ray reserves GPUs; on one machine every trial may use all of them")
        return ""
    if gpus < 0:
        raise ConfigError(f"--gpus {gpus:g}: must be 0 or more")
    if any(policy.record is not None for policy in policies):
        raise ConfigError("--record: not with --engine ray, whose nodes write no common file; record on one machine")
    from carecontact.trials.ray_engine import asks_for_a_token, connect

    connect(*(policy.ref for policy in policies))
    if all(policy.ref.kind == "remote" for policy in policies) or asks_for_a_token():
        return ""
    return (
        "this Ray cluster takes orders from whoever reaches its ports, and a policy does; set RAY_AUTH_MODE=token "
        "(docs/cluster.md)"
    )


def engine_of(name: EngineName, run: Conditions, *, gpus: float) -> Engine:
    """``gpus``: share of a GPU that a cluster reserves for each trial. Raises as ``check_engine``."""
    check_engine(name, run.policy, gpus=gpus)
    if name == "local":
        return Workers(
            out=run.out, work=run.work, policy=run.policy, weights=run.weights, pace_s=run.pace_s,
            launcher=run.launcher, trial_limit_s=run.trial_limit_s,
            losses=Losses(run.policy, out=run.out, before=run.killed),
        )  # fmt: skip
    from carecontact.trials.ray_engine import RayTrials

    shared = {
        "policy": run.policy, "shipped": run.policy.ref.kind == "importable", "identity": run.identity,
        "weights": run.weights, "pace_s": run.pace_s, "trial_limit_s": run.trial_limit_s,
        "command": None if run.launcher.command == WORKER_COMMAND else run.launcher.command,
    }  # fmt: skip
    return RayTrials(out=run.out, work=run.work, task=shared, killed=run.killed, gpus=gpus)
