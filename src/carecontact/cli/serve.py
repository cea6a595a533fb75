"""``carecontact serve``: a policy on this host for trials on another."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import tyro

from carecontact.cli.console import drop_output
from carecontact.cli.groups import PolicyGroup
from carecontact.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class Serve:
    """Serve a policy to `carecontact run --policy ws://HOST:PORT` on another host, until Ctrl-C. Every trial that
    connects gets a process of its own. Anyone who reaches the port may use it: see docs/trust.md."""

    policy: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="POLICY")]
    """Name from `carecontact list policies`, or module:Class, importable from the current folder."""
    given: PolicyGroup = field(default_factory=PolicyGroup)
    host: str = "127.0.0.1"
    """Address to listen on; 0.0.0.0 listens on all addresses of this host."""
    port: int = 8765
    """Port to listen on; 0 chooses a free port."""
    at_once: int | None = None
    """Number of trials that run at once; further trials wait. Default: one per core."""

    after_interrupt: ClassVar[str] = "; all policy processes end, too"

    def __call__(self) -> int:
        from carecontact.cli.policy import arguments_text, check_policy, policy_setup
        from carecontact.policies.registry import policy_target
        from carecontact.running.workers import available_cores
        from carecontact.serving.serve import LOAD_DEADLINE_S, serve_trials

        if not 0 <= self.port <= 65535:
            raise ConfigError(f"--port {self.port}: expected 0 to 65535")
        if self.at_once is not None and self.at_once < 1:
            raise ConfigError(f"--at-once {self.at_once}: must be at least 1")
        setup = policy_setup(self.policy, self.given)
        if setup.ref.kind == "remote":
            raise ConfigError(
                f"{setup.ref}: a policy with an address is served already; give a registered name or module:Class"
            )
        policy_target(setup.ref)  # refuses a privileged policy
        check_policy(setup, deadline_s=LOAD_DEADLINE_S)
        name = f"{setup.ref}{arguments_text(setup)}"
        serve_trials(
            setup,
            host=self.host,
            port=self.port,
            at_once=self.at_once or available_cores(),
            on_port=lambda bound: _print(f"{name}: serving on {self.host}, port {bound}"),
            on_event=_print,
        )
        return 0


def _print(line: str) -> None:
    """Print a line for as long as somebody reads them, or they can be stored; the server goes on without."""
    try:
        # In one piece, because the threads of several trials print.
        print(f"{line}\n", end="", flush=True)
    except OSError:
        drop_output(sys.stdout.fileno())
