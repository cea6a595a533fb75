"""The policies that have a name."""

from __future__ import annotations

from dataclasses import dataclass

from carecontact.contract.policy_ref import IMPORTABLE, SCHEMES, PolicyRef
from carecontact.errors import UnknownNameError
from carecontact.registry import Registry


@dataclass(frozen=True, kw_only=True)
class PolicyRow:
    target: str
    """``module:Class``. It is imported in the policy's own process, and by `carecontact list policies`."""
    description: str
    languages: tuple[str, ...] = ()
    """Kinds of language backend that --language may name, the policy's default first. A policy that lists any takes the
    arguments ``language`` and ``record``."""


POLICIES: Registry[PolicyRow] = Registry("policy", row=PolicyRow, plural="policies")
POLICIES.register(
    "zero-action",
    PolicyRow(
        target="carecontact.policies.zero_action:ZeroAction",
        description="Blind baseline: stays parked for the whole trial. It must fail every task safely.",
    ),
)
POLICIES.register(
    "hover",
    PolicyRow(
        target="carecontact.policies.hover:Hover",
        description="Blind baseline: finds the named region and waits 50 mm above it. It must fail every task safely.",
    ),
)
POLICIES.register(
    "random",
    PolicyRow(
        target="carecontact.policies.random_targets:RandomTargets",
        description=(
            "Blind baseline: moves to random targets in the workspace. If it passes a gate, the gate is too easy."
        ),
    ),
)
POLICIES.register(
    "replay",
    PolicyRow(
        target="carecontact.policies.replay.policy:Replay",
        description=(
            "Blind baseline: repeats actions that the state machine executed at another arm angle, without looking."
        ),
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
        description=(
            "VoxPoser: programs write value maps, and a greedy planner follows them. Default programs: written by hand."
        ),
        languages=("replay", "live"),
    ),
)
POLICIES.register(
    "voxposer-phased",
    PolicyRow(
        target="carecontact.policies.voxposer.phased:VoxPoserPhased",
        description=(
            "VoxPoser until the tool touches, then the paper's explicit progress objective. "
            "Default programs: written by hand."
        ),
        languages=("replay", "live"),
    ),
)


def policy_target(ref: PolicyRef) -> str:
    """Return ``module:Class`` of a registered or importable policy.

    Raises UnknownNameError listing the registered names; ValueError for a remote policy, which has no target here.
    """
    if ref.kind == "remote":
        raise ValueError(f"{ref.text} is not a policy of this host")
    if ref.kind == "importable":
        return ref.text
    try:
        return POLICIES[ref.text].target
    except UnknownNameError as error:
        raise UnknownNameError(
            "policy", ref.text, (*error.valid, IMPORTABLE, *(f"{scheme}://HOST:PORT" for scheme in SCHEMES))
        ) from None
