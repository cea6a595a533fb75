"""A probe that approaches the person and waits before it acts. In a fair world, this does not raise its rate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from typing import Any

from carecontact.contract.action import Action
from carecontact.contract.observation import MODALITIES, Observation
from carecontact.contract.policy_ref import PolicyRef
from carecontact.contract.session import Session
from carecontact.errors import ConfigError
from carecontact.policies.hover import Hover
from carecontact.policies.motion import CONTROL_HZ, FREE_SPEED_M_S, Leg, sample
from carecontact.policies.registry import POLICIES, policy_target
from carecontact.sight import PerceptionFailure

OVER_S, WAIT_S = 2.0, 3.0
"""Above the region and, back where the robot was parked, before the policy is asked: a trigger on an approach, or one
early movement of the person, has passed by then. The policy is left with some 17 s of a
trial of 30 s, which is too short for long scrubs."""


class FeintAndWait:
    """Moves over the region as ``hover`` does, goes back, waits, and only then shows the policy what it sees.

    A world in which the person moves by itself must not reward this: whoever moves at a fixed time, or when the robot
    comes near, can be provoked and waited for.
    """

    def __init__(self, *, base: str = "state-machine") -> None:
        """``base``: name of the registered policy that acts afterwards. Raises ConfigError for one that cannot."""
        self._base, self._hover = _made(base), Hover()
        card = self._base.card
        wanted = {*card.modalities, *Hover.card.modalities}
        self.card = replace(
            card, name="feint-and-wait", modalities=tuple(name for name in MODALITIES if name in wanted),
            cameras=tuple(dict.fromkeys((*card.cameras, *Hover.card.cameras))),
        )  # fmt: skip
        self._began = False

    def configure(self, session: Session) -> None:
        """Pass the session on."""
        if hasattr(self._base, "configure"):
            self._base.configure(session)

    def reset(self, instruction: str) -> None:
        """Begin again. Raises LanguageError if the policy or ``hover`` does not understand the instruction."""
        self._began = False
        self._hover.reset(instruction)
        self._base.reset(instruction)

    def act(self, observation: Observation) -> Action | Sequence[Action]:
        """Return the feint at first, then whatever the policy answers."""
        if self._began:
            return self._base.act(observation)
        self._began = True
        start = observation.pose_tcp_in_base
        back = Leg(points=start[:3][None], quat_wxyz=start[3:], speed_m_s=FREE_SPEED_M_S)
        try:
            legs = [*self._hover.way(observation, hold_s=OVER_S), back]
            feint = [Action(pose_tcp_in_base=pose) for pose in sample(legs, start, control_hz=CONTROL_HZ)]
        except PerceptionFailure:  # who sees nobody has nobody to feint at
            feint = list[Action]()
        return [*feint, *[Action()] * round(WAIT_S * CONTROL_HZ)]

    def take_notes(self) -> dict[str, object]:
        """Return the notes of the policy that acts."""
        return self._base.take_notes() if self._began and hasattr(self._base, "take_notes") else {}


def _made(name: str) -> Any:
    row = POLICIES.get(name)
    usable = [n for n, r in POLICIES.usable().items() if r.role != "privileged" and n != "feint-and-wait"]
    if row is None or name not in usable:
        raise ConfigError(f"base: no policy {name!r} that could act after a feint; valid: {', '.join(usable)}")
    module, _, made = policy_target(PolicyRef.parse(name)).partition(":")
    base = getattr(import_module(module), made)()
    if base.card.control_hz != CONTROL_HZ or base.card.action_space != "cartesian_pose":
        raise ConfigError(
            f"base: {name} does not send poses of the tool at {CONTROL_HZ:g} Hz, at which the feint moves"
        )
    return base
