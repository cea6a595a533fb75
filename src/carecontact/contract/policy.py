"""The card a policy shows and the two methods it has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from carecontact.contract.action import ACTION_SPACES, Action, ActionBounds
from carecontact.contract.observation import MODALITIES, Observation
from carecontact.errors import ContractError

CAMERAS = ("overhead", "bedside", "exterior", "wrist")


@dataclass(frozen=True, kw_only=True)
class PolicyCard:
    """What a policy asks for; only what it names is rendered."""

    name: str
    action_space: str = "cartesian_pose"
    modalities: tuple[str, ...] = ()
    """Of MODALITIES, for every camera named, at every ``act`` call."""
    cameras: tuple[str, ...] = ("overhead",)
    control_hz: float = 10.0
    """Rate at which the actions of a chunk are executed: 1-50 Hz."""
    language_backend: str = "none"
    """``none``, ``rules-v1``, ``replay:<hash>`` or ``live:<model>``; travels with every result."""

    def __post_init__(self) -> None:
        if not self.name:
            raise ContractError("PolicyCard.name is empty")
        if self.action_space not in ACTION_SPACES:
            raise ContractError(f"PolicyCard.action_space {self.action_space!r}; valid: {', '.join(ACTION_SPACES)}")
        for got, valid, field in ((self.modalities, MODALITIES, "modalities"), (self.cameras, CAMERAS, "cameras")):
            unknown = [g for g in got if g not in valid]
            if unknown:
                raise ContractError(f"PolicyCard.{field} {unknown}; valid: {', '.join(valid)}")
        if not 1 <= self.control_hz <= 50:
            raise ContractError(f"PolicyCard.control_hz {self.control_hz}; valid: 1 to 50")


@dataclass(frozen=True, kw_only=True)
class Session:
    """What holds for every trial of a protocol: limits and cameras. Carries no seed, task id or label."""

    action_bounds: ActionBounds
    joint_low_rad: tuple[float, ...]
    """(7,) lower joint limits of the robot"""
    joint_high_rad: tuple[float, ...]
    """(7,)"""
    camera_sizes_px: dict[str, tuple[int, int]]
    """Camera -> (width, height); every camera of the scene, asked for or not."""
    time_limit_s: float


@runtime_checkable
class Policy(Protocol):
    """Runs in a process of its own. Nothing about the trial but the instruction ever reaches it.

    Optional: a policy that has a method ``configure(session: Session) -> None`` is given the session before every
    ``reset``, for example to plan inside the workspace bounds.
    """

    card: PolicyCard

    def reset(self, instruction: str) -> None: ...

    def act(self, observation: Observation) -> Action | Sequence[Action]: ...
