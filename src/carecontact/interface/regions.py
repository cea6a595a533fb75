"""The regions of the body that a task can name: plain data, found by name in REGIONS."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from carecontact.errors import ConfigError
from carecontact.registry import Registry

LIMB_PARTS = ("clavicle", "upper_arm", "forearm", "hand", "thigh", "shank", "foot")
"""Parts of the surface that the body has on either side."""
SEGMENTS = (
    *("pelvis", "abdomen", "thorax", "neck", "head"),
    *(f"{side}_{name}" for side in ("right", "left") for name in LIMB_PARTS[1:]),
)
"""Segments of the body, in the order of a recording; forces are counted per segment."""
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
    nearer the next joint (``human.pose.free_middle``)."""
    held_out_m: tuple[tuple[float, float], ...] = ()
    """Places (along, across) of the region's frame where validation compares the tissue with published curves [m];
    each is at least 8 mm from those of tools/fit_tissue.py."""

    def __post_init__(self) -> None:
        """Raises ConfigError for a ``closed_by`` that is not two of LIMB_PARTS."""
        check_pair("Tube.closed_by", self.closed_by, LIMB_PARTS)


@dataclass(frozen=True, kw_only=True)
class Belly:
    """Shape of the soft region on the front of the trunk: a patch from the pelvis to the lower ribs, sized by the body
    (``human.shell.trunk_shell``)."""

    held_out_m: tuple[tuple[float, float], ...] = ()
    """As in ``Tube``."""


@dataclass(frozen=True, kw_only=True)
class _Sight:
    joints: tuple[str, str]
    """Names of two joints without their side, on a limb the one nearer the trunk first, on the trunk the one nearer
    the feet."""
    ahead: tuple[float, float] = (0.0, 0.0)
    """The pose estimator marks joints short of their centres, or beyond: what is added to the first and the second
    joint, as shares of the line between them. Means over rendered persons from above (seeds below 1000); a property of
    the estimator and not of anatomy."""

    def __post_init__(self) -> None:
        """Raises ConfigError for ``joints`` that are not two of JOINTS."""
        check_pair(f"{type(self).__name__}.joints", self.joints, JOINTS)


@dataclass(frozen=True, kw_only=True)
class LimbSight(_Sight):
    """How a policy finds a region of a limb in an image: between two joints of one side."""

    free_from: float = 0.0
    """Share of the line before which limb and trunk are one. Where it is above 0, the shipped policies also keep clear
    of a chest that stands higher than the limb."""


@dataclass(frozen=True, kw_only=True)
class TrunkSight(_Sight):
    """How a policy finds a region of the trunk in an image: between the middles of two pairs of joints."""

    middle: float
    """Middle of the region as a share of the line between the two pairs."""
    length: float
    """Length of the region, as a share of that line's length."""


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


REGIONS: Registry[Region] = Registry("region", row=Region)
"""Name -> row. Other packages add rows through the entry-point group ``carecontact.regions``. Policies may read it: a
module that registers a region must import nothing of carecontact but ``carecontact.interface.regions``."""

STANDARD_REGIONS = ("forearm", "upper_arm", "abdomen")
"""Regions that every world and every recording has, in this order: there the person is soft whatever the tasks are. Any
other region is part of the worlds of those protocols alone whose tasks name it."""


def all_regions() -> tuple[str, ...]:
    """Names of all registered regions: the standard ones in their order, then the others by name."""
    return (*STANDARD_REGIONS, *(name for name in REGIONS if name not in STANDARD_REGIONS))


# From the pelvis to the lower ribs.
REGIONS.register(
    "abdomen",
    Region(
        segment="abdomen",
        neighbourhood=("thorax", "abdomen", "pelvis"),
        shape=Belly(held_out_m=((0.018, -0.020), (-0.020, 0.026), (0.012, 0.040), (-0.014, -0.045), (0.004, 0.012))),
        words=("abdomen", "belly", "stomach", "tummy"),
        # Middle: the umbilicus is at 0.61 of stature, hip and shoulder joints at 0.53 and 0.82 (Drillis and Contini
        # 1966). Length: the soft belly, symphysis to lower ribs; assumed.
        sight=TrunkSight(joints=("hip", "shoulder"), ahead=(-0.035, -0.025), middle=0.27, length=0.40),
    ),
)


# From the elbow to the wrist.
REGIONS.register(
    "forearm",
    Region(
        segment="right_forearm",
        neighbourhood=("right_hand", "right_forearm", "right_upper_arm"),
        shape=Tube(
            span=(0.05, 0.96),
            # The forearm is also pushed from the side: 90 degrees must lie between free vertices.
            pushed_from_side=True,
            closed_by=("upper_arm", "hand"),
            held_out_m=((0.016, -0.007), (-0.019, 0.009), (0.045, -0.009), (-0.052, 0.004), (0.006, 0.011)),
        ),
        words=("forearm", "fore arm", "fore-arm", "lower arm"),
        sight=LimbSight(joints=("elbow", "wrist")),
    ),
)


# From under the armpit to the elbow.
REGIONS.register(
    "upper_arm",
    Region(
        segment="right_upper_arm",
        neighbourhood=("right_forearm", "right_upper_arm", "thorax"),
        shape=Tube(
            # It begins under the armpit, where the arm is a tube.
            span=(0.25, 0.97),
            closed_by=("clavicle", "forearm"),
            # The shoulder's cap reaches over the joint.
            near_end_from=-0.25,
            beside_trunk=True,
            held_out_m=((0.016, -0.007), (-0.019, 0.009), (0.006, 0.011)),
        ),
        words=("upper arm", "upper-arm", "upperarm", "biceps", "bicep", "triceps"),
        # Free of the trunk from the fold of the armpit on; that share is assumed.
        sight=LimbSight(joints=("shoulder", "elbow"), ahead=(0.11, 0.06), free_from=0.33),
        close_up_azimuth_deg=15.0,
        # Toward the elbow, where the robot's hand stays clear of a large chest.
        scripted_along_m=0.055,
    ),
)
