"""The parts of the body that a region can name: segments and joints."""

from __future__ import annotations

from collections.abc import Iterable

from carecontact.errors import ConfigError

SEGMENTS = (
    "pelvis", "abdomen", "thorax", "neck", "head",
    *(f"{side}_{name}" for side in ("right", "left")
      for name in ("upper_arm", "forearm", "hand", "thigh", "shank", "foot")),
)  # fmt: skip
"""Segments of the body, in the order of a recording; forces are counted per segment."""

LIMB_PARTS = ("clavicle", "upper_arm", "forearm", "hand", "thigh", "shank", "foot")
"""Parts of the surface that the body has on either side."""

JOINTS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
"""Joints, without their side, whose centres are known and whose key points a pose estimator marks."""


def check_names(what: str, names: Iterable[str], valid: tuple[str, ...]) -> None:
    """Raises ConfigError, which begins with ``what``, for a name that is not among ``valid``, for a text in place of a
    tuple of names, and where there is no name at all."""
    if isinstance(names, str) or not (names := tuple(names)):
        raise ConfigError(f"{what}: expected a tuple of names, got {names!r}; valid: {', '.join(valid)}")
    unknown = [name for name in names if name not in valid]
    if unknown:
        raise ConfigError(f"{what}: {unknown[0]!r} is unknown; valid: {', '.join(valid)}")


def check_pair(what: str, names: tuple[str, ...], valid: tuple[str, ...]) -> None:
    """Check two different names as ``check_names`` does."""
    check_names(what, names, valid)
    if len(set(names)) != 2 or len(names) != 2:
        raise ConfigError(f"{what}: expected two different names, got {', '.join(names)}; valid: {', '.join(valid)}")
