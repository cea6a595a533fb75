"""Is a policy there? Asked before a run, because afterwards each trial would fail for the same reason."""

from __future__ import annotations

from pathlib import Path

from carecontact.errors import ConfigError, PolicyError
from carecontact.trials.failed import reason


def check_policy(policy: str, *, search_path: Path, deadline_s: float) -> None:
    """Raises UnknownNameError, or ConfigError saying in one line why ``module:Class`` does not start.

    A ``module:Class`` is started just as a trial starts it, in a process of its own and behind the wall.
    """
    from carecontact.policies.process import PolicyProcess
    from carecontact.policies.registry import resolve_policy

    resolve_policy(policy)
    if ":" not in policy:
        return
    try:
        with PolicyProcess(
            policy, first_deadline_s=deadline_s, deadline_s=deadline_s, search_path=[str(search_path)]
        ) as process:
            process.start()
    except PolicyError as error:
        raise ConfigError(
            f"--policy {policy} does not start (looked in {search_path} first): {reason(str(error))}"
        ) from None
