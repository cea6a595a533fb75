"""What is known of a region before any person is there, and the registry of all regions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from carecontact.errors import ConfigError
from carecontact.regions.anatomy import JOINTS, LIMB_PARTS, SEGMENTS, check_names, check_pair
from carecontact.registry import Registry


@dataclass(frozen=True, kw_only=True)
class Tube:
    """Shape of a soft region on a limb: a shell round it, open below."""

    span: tuple[float, float]
    """Start and end of the shell as shares of the line from the segment's joint to the next one."""
    pushed_from_side: bool = False
    """Whether the mesh is also fine at mid-length on the sides, where a tool pushes."""
    closed_by: tuple[str, str]
    """Segments, without their side, whose surface closes the rigid ends: the one nearer the trunk, then the other."""
    near_end_from: float = -0.03
    """Place where the nearer rigid end begins, as a share of the same line; negative: before the joint."""
    beside_trunk: bool = False
    """Whether the trunk can be in the way of a hand that comes from above. On bodies where it is, the region lies
    nearer the next joint (``world.human.clearance``)."""
    held_out_m: tuple[tuple[float, float], ...] = ()
    """Places (along, across) of the region's frame where validation compares the tissue with published curves [m];
    each is at least 8 mm from those of tools/fit_tissue.py."""

    def __post_init__(self) -> None:
        """Raises ConfigError for a ``closed_by`` that is not two of LIMB_PARTS."""
        check_pair("Tube.closed_by", self.closed_by, LIMB_PARTS)


@dataclass(frozen=True, kw_only=True)
class Belly:
    """Shape of the soft region on the front of the trunk: a patch from the pelvis to the lower ribs, sized by the body
    (``world.human.shell.trunk_shell``)."""

    held_out_m: tuple[tuple[float, float], ...] = ()
    """As in ``Tube``."""


@dataclass(frozen=True, kw_only=True)
class LimbSight:
    """How a policy finds a region of a limb in an image: between two joints of one side."""

    joints: tuple[str, str]
    """Names of the joints without their side, the one nearer the trunk first."""
    ahead: tuple[float, float] = (0.0, 0.0)
    """The pose estimator marks joints short of their centres, or beyond: what is added to the first and the second
    joint, as shares of the line between them. Means over rendered persons from above (seeds below 1000); a property of
    the estimator and not of anatomy."""
    free_from: float = 0.0
    """Share of the line before which limb and trunk are one. Where it is above 0, the shipped policies also keep clear
    of a chest that stands higher than the limb."""

    def __post_init__(self) -> None:
        """Raises ConfigError for ``joints`` that are not two of JOINTS."""
        check_pair("LimbSight.joints", self.joints, JOINTS)


@dataclass(frozen=True, kw_only=True)
class TrunkSight:
    """How a policy finds a region of the trunk in an image: between the middles of two pairs of joints."""

    joints: tuple[str, str]
    """Names of the joints without their side, the one nearer the feet first."""
    ahead: tuple[float, float] = (0.0, 0.0)
    """As in ``LimbSight``."""
    middle: float
    """Middle of the region as a share of the line between the two pairs."""
    length: float
    """Length of the region, as a share of that line's length."""

    def __post_init__(self) -> None:
        """Raises ConfigError for ``joints`` that are not two of JOINTS."""
        check_pair("TrunkSight.joints", self.joints, JOINTS)


@dataclass(frozen=True, kw_only=True)
class Region:
    """One part of the body that a task can name."""

    segment: str
    """Body segment that the region lies on, with its side; forces are counted per segment."""
    neighbourhood: tuple[str, ...]
    """Segments on which success may be earned, where a protocol does not say otherwise."""
    shape: Tube | Belly | None = None
    """Shape of the soft shell. None: the region is rigid, which means the whole segment with its rigid surface. A rigid
    region needs no row of tissue, and nothing of indentation is scored on it."""
    words: tuple[str, ...] = ()
    """What ``rules-v1`` takes for the region in an instruction, apart from its side. Empty: ``rules-v1`` refuses the
    region."""
    sight: LimbSight | TrunkSight | None = None
    """None: the shipped policies cannot find the region, and a report does not say whether it was in view."""
    close_up_azimuth_deg: float = 60.0
    """Direction of the close-up's view in the world [deg]: from the bed and the feet, where the robot does not stand in
    the way."""
    scripted_along_m: float = 0.0
    """Places at which validation makes its scripted contacts, along the region's axis from the middle that it has on a
    body whose trunk is not in the way [m]."""

    def __post_init__(self) -> None:
        """Raises ConfigError for a segment that no body has, a neighbourhood without one, ``words`` that are one text,
        and a limb's shape or sight on a segment that has no side."""
        check_names("Region.segment", (self.segment,), SEGMENTS)
        check_names("Region.neighbourhood", self.neighbourhood, SEGMENTS)
        if isinstance(self.words, str):
            raise ConfigError(f"Region.words: expected a tuple of texts, got {self.words!r}")
        for field, of_a_limb in (("shape", isinstance(self.shape, Tube)), ("sight", isinstance(self.sight, LimbSight))):
            if of_a_limb and not self.sided:
                kind = type(getattr(self, field)).__name__
                raise ConfigError(f"Region.{field}: {kind} is for a limb, and {self.segment} has no side")

    @property
    def soft(self) -> bool:
        return self.shape is not None

    @property
    def sided(self) -> bool:
        """Whether the body has one on either side, so that an instruction has to name the side."""
        return self.side != "none"

    @property
    def side(self) -> Literal["right", "left", "none"]:
        """Side of the body, as the person calls it."""
        if self.segment.startswith("right_"):
            return "right"
        return "left" if self.segment.startswith("left_") else "none"

    @property
    def sight_joints(self) -> tuple[str, ...]:
        """Joints, with their sides, that have to be visible for the region to be in view; empty without ``sight``."""
        match self.sight:
            case LimbSight(joints=joints):
                return tuple(f"{self.side} {joint}" for joint in joints)
            case TrunkSight(joints=(lower, upper)):
                return tuple(f"{side} {joint}" for joint in (upper, lower) for side in ("left", "right"))
            case None:
                return ()


REGIONS: Registry[Region] = Registry("region", row=Region, scan="carecontact.regions")
"""Name -> row. Other packages add rows through the entry-point group ``carecontact.regions``. Policies may read it: a
module that registers a region must import nothing of carecontact but ``carecontact.regions``."""

STANDARD_REGIONS = ("forearm", "upper_arm", "abdomen")
"""Regions that every world and every recording has, in this order: there the person is soft whatever the tasks are. Any
other region is part of the worlds of those protocols alone whose tasks name it."""


def all_regions() -> tuple[str, ...]:
    """Names of all registered regions: the standard ones in their order, then the others by name."""
    return (*STANDARD_REGIONS, *(name for name in REGIONS if name not in STANDARD_REGIONS))
