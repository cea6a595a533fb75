"""Stiffness, damping and limits of the arm's controller."""

from __future__ import annotations

from carecontact.contract.protocol.section import Positive, Section, Vec3
from carecontact.contract.session import ActionBounds


class Impedance(Section):
    translational_n_m: Positive
    rotational_nm_rad: Positive
    translational_bounds: tuple[float, float]
    rotational_bounds: tuple[float, float]
    effective_mass_kg: Positive
    """Translational damping is 2 sqrt(K m)."""
    effective_inertia_kgm2: Positive
    force_clamp_n: Positive
    torque_clamp_nm: Positive
    workspace_low_m: Vec3
    workspace_high_m: Vec3

    @property
    def action_bounds(self) -> ActionBounds:
        """What an action may ask for, as a policy is told before its first one."""
        return ActionBounds(
            workspace_low_m=self.workspace_low_m,
            workspace_high_m=self.workspace_high_m,
            translational_stiffness=self.translational_bounds,
            rotational_stiffness=self.rotational_bounds,
        )
