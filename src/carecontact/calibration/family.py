"""The laws that calibration chooses among: which terms a law has, and its numbers as parameters of a fit.

Every law has a level, the anchor's pressure at the typical depth. If damping is fitted, it also has the damping at half
of that depth. A *term* adds one parameter to it:

- ``bend`` k: the tangent a + 2 b x + 3 c x^2 follows (1 - k x / depth)^2, ``ROUND`` of it, so that it never reaches
  zero. Where k is above zero, b is below it. Where it is below zero, b is a (exp(-k) - 1) ``ROUND`` / depth and c is 0;
- ``rise`` q: the tangent grows by a (exp(q) - 1) times the square of the depth, which is c;
- ``growth``: the share of the damping at half depth that grows with indentation, as in Hunt and Crossley's contact.

Every choice of parameters within the bounds is a convex law, so that a fit never meets one that ``Tissue`` refuses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from carecontact.calibration.trial import Array
from carecontact.contract.protocol import Tissue
from carecontact.contract.protocol.person import LARGEST_CONTACT

TERMS = ("bend", "rise", "growth")
ROUND = 0.9
"""The tangent of a bent law never falls below its value at first touch times 1 minus this share."""
_LOW = {"level": np.log(1e-3), "damping": np.log(1.0), "bend": -4.0, "rise": 0.0, "growth": 0.0}
_HIGH = {"level": np.log(1e3), "damping": np.log(1e9), "bend": 3.0, "rise": 5.0, "growth": 0.95}
_SCALE = {"level": 0.3, "damping": 1.0, "bend": 0.3, "rise": 0.5, "growth": 0.5}
STEP = {"level": 0.03, "damping": 0.1, "bend": 0.05, "rise": 0.1, "growth": 0.1}
"""Steps of the parameters for finite differences."""


@dataclass(frozen=True, kw_only=True)
class Family:
    """Laws with the same terms, on one mesh."""

    base: Tissue
    """Gives all fields besides the law and, if damping is not fitted, the ratio of damping to stiffness."""
    depth_m: float
    """Typical depth of the trials."""
    damping: bool
    """Whether damping is fitted."""
    terms: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        return ("level", *(("damping",) if self.damping else ()), *self.terms)

    @property
    def low(self) -> Array:
        return np.array([_LOW[name] for name in self.names])

    @property
    def high(self) -> Array:
        return np.array([_HIGH[name] for name in self.names])

    @property
    def scale(self) -> Array:
        return np.array([_SCALE[name] for name in self.names])

    @property
    def candidates(self) -> tuple[str, ...]:
        """Terms that may still be added to a law of this family."""
        return tuple(t for t in TERMS if t not in self.terms and (t != "growth" or self.damping))

    def plus(self, term: str) -> Family:
        """Return the family with one more term, whose parameter comes last. At the value 0, the law is the one without
        it.
        """
        return replace(self, terms=(*self.terms, term))

    def tissue(self, p: Array) -> Tissue:
        """Return the tissue with the law (a, b, c, damping and its growth) of parameters in the order of ``names``."""
        of = dict(zip(self.names, map(float, p), strict=True))
        level = np.exp(of["level"]) * _pressure(self.base, self.depth_m)
        bend = of.get("bend", 0.0)
        slope = ROUND * (bend if bend > 0 else -np.expm1(-bend))
        square = ROUND * max(bend, 0.0) ** 2 + np.expm1(of.get("rise", 0.0))
        # ``Tissue`` refuses anchors that are much softer than the contact layer.
        softest = 1.01 * self.base.contact_n_m3 / LARGEST_CONTACT
        a = max(level / self.depth_m / (1 - slope + square / 3), softest)
        if self.damping:
            half, growth = np.exp(of["damping"]), of.get("growth", 0.0)
            damping, grows = half * (1 - growth), 2 * half * growth / self.depth_m
        else:
            ratio = level / _pressure(self.base, self.depth_m)
            damping, grows = ratio * self.base.damping_ns_m3, ratio * self.base.damping_growth_ns_m4
        law = {
            "a_n_m3": a, "b_n_m4": -a * slope / self.depth_m, "c_n_m5": a * square / 3 / self.depth_m**2,
            "damping_ns_m3": damping, "damping_growth_ns_m4": grows,
        }  # fmt: skip
        return self.base.model_copy(update={name: float(value) + 0.0 for name, value in law.items()})

    def start(self, scale: float) -> Array:
        """Return the parameters of the base law, made ``scale`` times as stiff, without any term."""
        half = self.base.damping_ns_m3 + self.base.damping_growth_ns_m4 * self.depth_m / 2
        return np.array([np.log(scale), np.log(scale * half)][: len(self.names)])


def _pressure(tissue: Tissue, depth: float) -> float:
    return tissue.a_n_m3 * depth + tissue.b_n_m4 * depth**2 + tissue.c_n_m5 * depth**3
