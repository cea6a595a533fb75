"""The policies that have a name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from carecontact.errors import ConfigError, UnknownNameError
from carecontact.interface.policy import IMPORTABLE, LOOK_CONTROLS, SCHEMES, VARIANT, PolicyRef
from carecontact.registry import Registry

Role = Literal["method", "blind", "probe", "privileged"]
"""What a policy is for: a method may be ranked. A blind baseline lacks an ability that a task is meant to require, and
the best of them is the floor under every rate. A probe changes one thing about a method, to see whether the world
rewards it. A privileged policy is given the simulation, and its rate is the ceiling. Only methods are ranked."""


@dataclass(frozen=True, kw_only=True)
class PolicyRow:
    target: str
    """``module:Class``. It is imported in the policy's own process, and by `carecontact list policies`."""
    description: str
    languages: tuple[str, ...] = ()
    """Kinds of language backend that --language may name, the policy's default first. A policy that lists any takes the
    arguments ``language`` and ``record``."""
    role: Role = "method"


SHIPPED = {
    "zero-action": PolicyRow(
        target="carecontact.policies.blind:ZeroAction",
        role="blind",
        description="Blind baseline: stays parked for the whole trial. It must fail every task safely.",
    ),
    "hover": PolicyRow(
        target="carecontact.policies.blind:Hover",
        role="blind",
        description="Blind baseline: finds the named region and waits 50 mm above it. It must fail every task safely.",
    ),
    "random": PolicyRow(
        target="carecontact.policies.blind:RandomTargets",
        role="blind",
        description="Blind baseline: moves to random targets in the workspace. A gate that it passes is too easy.",
    ),
    "replay": PolicyRow(
        target="carecontact.policies.replay:Replay",
        role="blind",
        description="Blind baseline: repeats the state machine's actions at another arm angle, without looking.",
    ),
    "replay-registered": PolicyRow(
        target="carecontact.policies.replay:ReplayRegistered",
        role="blind",
        description="Blind baseline: repeats recorded actions relative to the overhead camera's pose, without looking.",
    ),
    "mean-person": PolicyRow(
        target="carecontact.policies.mean_person:MeanPersonPolicy",
        role="blind",
        description="Blind baseline: the state machine's motions on the average person, without a picture.",
    ),
    "mean-person-hybrid": PolicyRow(
        target="carecontact.policies.mean_person:MeanPersonHybrid",
        role="blind",
        description="Blind baseline: mean-person that presses with 3 N of feedforward, without stiffness that way.",
    ),
    "mean-person-estimated": PolicyRow(
        target="carecontact.policies.mean_person:MeanPersonEstimated",
        role="blind",
        description="Blind baseline: mean-person that holds a force which it estimates from the encoders.",
    ),
    "mean-person-search": PolicyRow(
        target="carecontact.policies.mean_person:MeanPersonSearch",
        role="blind",
        description="Blind baseline: mean-person-estimated that feels for the region at up to five places.",
    ),
    "feint-and-wait": PolicyRow(
        target="carecontact.policies.blind:FeintAndWait",
        role="probe",
        description="Probe: approaches the person, goes back and waits before the state machine acts; must not pay.",
    ),
    "state-machine": PolicyRow(
        target="carecontact.policies.state_machine:StateMachine",
        languages=("rules-v1", "replay", "live"),
        description="The paper's method: perceive once, choose contact primitives by language, execute open loop.",
    ),
    "look-and-press": PolicyRow(
        target="carecontact.policies.look_and_press:LookAndPress",
        languages=("rules-v1", "replay", "live"),
        description="The state machine's motions, pressed by a feedforward force; looks again and tries again.",
    ),
    "learned": PolicyRow(
        target="carecontact.policies.point_flow:PointFlow",
        description="Point clouds in, targets out: cloned from demonstrations of T1 and T3, the only tasks it knows.",
    ),
    "voxposer": PolicyRow(
        target="carecontact.policies.voxposer.policy:VoxPoser",
        languages=("replay", "live"),
        description="VoxPoser: programs, by default written by hand, write value maps; a greedy planner follows them.",
    ),
    "voxposer-phased": PolicyRow(
        target="carecontact.policies.voxposer.policy:VoxPoserPhased",
        languages=("replay", "live"),
        description="VoxPoser until the tool touches, then the paper's progress objective. Default programs: by hand.",
    ),
    "oracle": PolicyRow(
        target="carecontact.oracle.policy:Oracle",
        role="privileged",
        description="Privileged ceiling: the state machine's motions, given the true skin, pose and contact force.",
    ),
}
POLICIES: Registry[PolicyRow] = Registry("policy", row=PolicyRow, plural="policies")
for _name, _row in SHIPPED.items():
    POLICIES.register(_name, _row)


def role_of(policy: str) -> Role:
    """Return the role of a policy as results name it; one that no row here describes is a method. A control of what it
    observes changes one thing about it, and is a probe."""
    if (variant := VARIANT.search(policy)) is not None:
        return "probe" if variant[1] in LOOK_CONTROLS else role_of(policy[: variant.start()])
    try:
        return POLICIES[policy].role if policy in POLICIES else "method"
    except ConfigError:  # another package's row that cannot be loaded any more
        return "method"


def is_privileged(ref: PolicyRef) -> bool:
    """Whether this package's own row says so: no other package's policy is ever given a simulation."""
    return ref.kind == "registered" and POLICIES.package(ref.name) is None and role_of(ref.name) == "privileged"


def policy_target(ref: PolicyRef) -> str:
    """Return ``module:Class`` of a registered or importable policy.

    Raises UnknownNameError listing the registered names; ConfigError for a privileged policy, which no process but a
    trial's own may run; ValueError for a remote policy, which has no target here.
    """
    if ref.kind == "remote":
        raise ValueError(f"{ref.text} is not a policy of this host")
    if ref.kind == "importable":
        return ref.name
    try:
        row = POLICIES[ref.name]
    except UnknownNameError as error:
        addresses = (f"{scheme}://HOST:PORT" for scheme in SCHEMES)
        raise UnknownNameError("policy", ref.name, (*error.valid, IMPORTABLE, *addresses)) from None
    if row.role == "privileged":
        raise ConfigError(
            f"policy {ref.text} is privileged: it is given the simulation of a trial, so it cannot be served, checked, "
            f"audited or run in a process of its own; give it to carecontact run"
        )
    return row.target
