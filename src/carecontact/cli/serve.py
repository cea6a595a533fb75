"""``carecontact serve``: a policy on this host for trials on another."""

from __future__ import annotations

import os
from pathlib import Path

from carecontact.cli.language import language_environment
from carecontact.cli.policy_name import check_policy
from carecontact.errors import ConfigError
from carecontact.hosting.serving import LOAD_DEADLINE_S, serve_trials


def serve(policy: str, *, host: str, port: int, at_once: int | None, language: str | None) -> int:
    """Until it is interrupted. Raises ConfigError for what cannot be served or where nothing can listen."""
    from carecontact.contract.policy_address import remote_address
    from carecontact.trials.supervisor import available_cores

    if not 0 <= port <= 65535:
        raise ConfigError(f"--port {port}: expected 0 to 65535")
    if at_once is not None and at_once < 1:
        raise ConfigError(f"--at-once {at_once}: must be at least 1")
    if remote_address(policy) is not None:
        raise ConfigError(f"{policy}: this is served already; give a registered name or module:Class")
    folder = Path.cwd()
    os.environ.update(language_environment(policy, language=language, record=None))
    check_policy(policy, search_path=folder, deadline_s=LOAD_DEADLINE_S)
    serve_trials(
        policy,
        host=host,
        port=port,
        at_once=at_once or available_cores(),
        search_path=[str(folder)],
        on_port=lambda bound: print(f"{policy}: serving at {host} port {bound}", flush=True),
        on_event=lambda said: print(said, flush=True),
    )
    return 0
