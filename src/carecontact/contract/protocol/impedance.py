"""Stiffness, damping and limits of the arm's controller."""

from __future__ import annotations

from carecontact.contract.protocol.section import Positive, Section, Vec3


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
