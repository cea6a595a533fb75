"""The shape of the soft ground that an indenter meets: a flat layer, or a round limb about a round bone."""

from __future__ import annotations

from dataclasses import dataclass

from carecontact.validation.fem.materials import POISSON, Skin


@dataclass(frozen=True, kw_only=True)
class Ground:
    """Tissue bonded to rigid bone at ``thickness_m`` under its surface, without end along and, where flat, across."""

    thickness_m: float
    """Skin and the tissue below it together."""
    limb_radius_m: float | None = None
    """Of a round limb's surface; None: flat."""
    poisson: float = POISSON


@dataclass(frozen=True, kw_only=True)
class Medium:
    """A ground and what it is made of."""

    ground: Ground
    skin: Skin
    tissue_pa: float
    """Young's modulus of what lies under the skin."""
