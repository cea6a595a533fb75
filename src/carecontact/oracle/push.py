"""How the oracle pushes: it brings the tool beside the limb, then pushes until the wrist has moved."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from carecontact.contract.action import Action
from carecontact.oracle.follow import Follower
from carecontact.oracle.truth import Truth
from carecontact.policies.motion import CONTROL_HZ, FREE_SPEED_M_S, Leg, sample

F64 = npt.NDArray[np.float64]

SPEED_M_S = 0.06
BACK_M_S = FREE_SPEED_M_S
"""Speed [m/s] of retreat, the fastest that the impedance's target may have: the tool gives way to a person who moves
the arm against it."""
WRIST_M = 0.030
"""Distance [m] by which the oracle moves the wrist: a push needs at least 20 mm, and more than 100 mm is rough."""
MOST_WRIST_M = 0.075
"""Displacement [m] of the wrist at which the tool lets go, because the person moves the arm as well: less than 100
mm."""
HOLDS_N = 4.0
"""Force [N] of the push, above the 3 N from which contact counts as a push."""
MOST_N = 18.0
"""Largest force [N], below the 20 N at which a person may withdraw the arm."""
TOUCHES_N = 0.5
HOLD_S = 1.2
FARTHEST_M = 0.20
"""Largest distance [m] of the target beyond the place where the limb's side was; from there the tool always goes
back."""
PUSHES = 4
"""Index of the leg that pushes."""


class Push:
    """Gives one target for each control period; ``ended`` is true after the last one."""

    def __init__(self, truth: Truth, legs: Sequence[Leg], start_pose: F64) -> None:
        """``legs``: all legs of a push that ends where the tool just touches the limb."""
        self._truth, self._follower = truth, Follower(truth)
        low, touching = legs[PUSHES - 1].points[-1], legs[PUSHES].points[-1]
        self._way = (touching - low) / np.linalg.norm(touching - low)
        self._quat = legs[PUSHES].quat_wxyz
        self._ahead = list(sample(legs[:PUSHES], start_pose, control_hz=CONTROL_HZ))
        at = np.concatenate([low, self._quat])
        self._after = list(sample(legs[PUSHES + 1 :], at, control_hz=CONTROL_HZ))
        self._low = low
        self._from: F64 | None = None
        """Place where the push began; None before it."""
        self._on_m, self._held, self._wrist, self._went_too_far = 0.0, 0, None, False

    @property
    def succeeded(self) -> bool:
        """Whether the push kept its force for long enough; if not, the limb moved where the tool did not follow."""
        return self._held >= HOLD_S * CONTROL_HZ

    @property
    def ended(self) -> bool:
        return not self._ahead and not self._after

    def act(self) -> Action:
        """Return the target for the next control period."""
        if self._ahead:
            pose = self._ahead.pop(0)
            return Action(pose_tcp_in_base=np.concatenate([self._follower.follow(pose[:3]), pose[3:]]))
        return Action(pose_tcp_in_base=self._beside())

    def _beside(self) -> F64:
        """Return the target pose (7,) from which the push begins."""
        if self._from is None:
            # From here on the limb moves because it is pushed: the target no longer follows it.
            self._from = self._follower.follow(self._low)
        if not self.succeeded and self._on_m < FARTHEST_M and not self._went_too_far:
            self._push()
            return np.concatenate([self._from + self._on_m * self._way, self._quat])
        pose = self._after.pop(0)
        return np.concatenate([pose[:3] - self._low + self._from, pose[3:]])

    def _push(self) -> None:
        force, wrist = self._truth.force_n(), self._truth.wrist()
        if self._wrist is None and force > TOUCHES_N:
            self._wrist = wrist
        moved = 0.0 if self._wrist is None else float(np.linalg.norm((wrist - self._wrist)[:2]))
        enough = moved >= WRIST_M and force >= HOLDS_N
        self._held = self._held + 1 if enough else 0
        self._went_too_far = moved > MOST_WRIST_M
        if force > MOST_N:
            self._on_m -= BACK_M_S / CONTROL_HZ
        elif not enough:
            self._on_m += SPEED_M_S / CONTROL_HZ
