"""VoxPoser with other times than those that were fixed before the first scored run, to see what hangs on them.

    carecontact run --policy tools.voxposer_times:Settle1 --tasks T1,T4,T6 --out runs/voxposer-settle-1

The release has neither number (docs/evidence/methods.md). No table counts these as the method.
"""

from __future__ import annotations

from carecontact.policies.voxposer.policy import VoxPoser


class Settle1(VoxPoser):
    """Holds the end of a path for 1 s instead of 0.4 s."""

    name = "voxposer-settle-1"
    settle_s = 1.0


class Horizon3(VoxPoser):
    """Executes 3 s of a plan before the next look instead of 1.5 s."""

    name = "voxposer-horizon-3"
    horizon_s = 3.0
