"""The shape of the soft ground under an indenter: a flat layer, or a round limb around a round bone."""

from __future__ import annotations

from dataclasses import dataclass

from carecontact.validation.fem.materials import POISSON, Skin


@dataclass(frozen=True, kw_only=True)
class Ground:
    """Tissue that is bonded to rigid bone at ``thickness_m`` under its surface. It is infinite along and, if flat,
    across.
    """

    thickness_m: float
    """Thickness of the skin and the tissue below it together."""
    limb_radius_m: float | None = None
    """Radius of a round limb's surface; None for flat ground."""
    poisson: float = POISSON


@dataclass(frozen=True, kw_only=True)
class Medium:
    """A ground and what it is made of."""

    ground: Ground
    skin: Skin
    tissue_pa: float
    """Young's modulus of the tissue under the skin."""
