"""The policies that have a name."""

from __future__ import annotations

from dataclasses import dataclass

from carecontact.errors import ConfigError, UnknownNameError
from carecontact.registry import Registry


@dataclass(frozen=True, kw_only=True)
class PolicyRow:
    target: str
    """``module:Class``; imported only in the policy's own process."""
    description: str
    languages: tuple[str, ...] = ()
    """Kinds of language backend that it takes by --language, its default first; empty: it takes none."""


POLICIES: Registry[PolicyRow] = Registry("policy", plural="policies")
POLICIES.register(
    "zero-action",
    PolicyRow(
        target="carecontact.policies.zero_action:ZeroAction",
        description="Null arm: stays parked for the whole trial. Must fail every task safely.",
    ),
)
POLICIES.register(
    "hover",
    PolicyRow(
        target="carecontact.policies.hover:Hover",
        description="Null arm: finds the named region by vision and waits 50 mm above it. Must fail every task safely.",
    ),
)
POLICIES.register(
    "random",
    PolicyRow(
        target="carecontact.policies.random_targets:RandomTargets",
        description="Null arm: random targets over the whole workspace. What it passes, a gate gives away.",
    ),
)
POLICIES.register(
    "replay",
    PolicyRow(
        target="carecontact.policies.replay.policy:Replay",
        description="Null arm: the state machine's actions for another posture, repeated blindly.",
    ),
)
POLICIES.register(
    "state-machine",
    PolicyRow(
        target="carecontact.policies.state_machine.policy:StateMachine",
        description="The paper's method: perceive once, choose contact primitives by language, execute open loop.",
        languages=("rules-v1", "replay", "live"),
    ),
)
POLICIES.register(
    "voxposer",
    PolicyRow(
        target="carecontact.policies.voxposer.policy:VoxPoser",
        description="Value maps from a language model's programs, a greedy planner over them, and no force map.",
        languages=("replay", "live"),
    ),
)
POLICIES.register(
    "voxposer-phased",
    PolicyRow(
        target="carecontact.policies.voxposer.phased:VoxPoserPhased",
        description="VoxPoser up to the touch, then an explicit progress objective: the paper's proposal.",
        languages=("replay", "live"),
    ),
)


def resolve_policy(name: str) -> str:
    """``module:Class`` of a registered name; ``module:Class`` itself passes through.

    Raises UnknownNameError listing the names, or ConfigError for a malformed ``module:Class``.
    """
    if ":" in name:
        module, _, attribute = name.partition(":")
        if not attribute.isidentifier() or not all(part.isidentifier() for part in module.split(".")):
            raise ConfigError(f"policy {name!r}: expected module:Class, for example my_policy:MyPolicy")
        return name
    try:
        return POLICIES[name].target
    except UnknownNameError as error:
        raise UnknownNameError("policy", name, (*error.valid, "module:Class", "ws://HOST:PORT")) from None
