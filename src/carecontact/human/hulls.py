"""Plates and hulls of the rigid person: surfaces that give way to a knock, and the planes in which neighbours meet."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from carecontact.human.body import Array, Body, SegmentInertia
from carecontact.human.shell import belly_half_width, belly_span

# Light plates on damped slides carry hulls of trunk, legs and the soft arm, so that these give way to a knock.
#
# Trunk and legs are one rigid piece of some 60 kg. A tool that hit hulls on it directly would feel the damper of
# MuJoCo's contact, whose force grows with the colliding mass (41 N for each kg of effective mass at 0.2 m/s), and
# nothing of a chest or a thigh. A plate is light, and its springs have published stiffness. The head, the neck, the
# feet, the left arm, the hands and the middle of the back have none: their contact is that of BARE_SOLREF.

FREQUENCY_RAD_S, SHANK_RAD_S = 500.0, 600.0
"""Natural frequency of a plate on its spring; our choice. A blow of 1 kg loses little to the plate's own mass, and the
physics step of 2 ms still resolves the spring (that of 4 ms in the fast mode only because damping is integrated
implicitly). The shank has the stiffest spring; its higher frequency gives it a plate of 0.17 kg in place of 0.24 kg."""
LEAST_MASS_KG = 0.1
DAMPING_RATIO = 1.2
"""Damping ratio of the plate alone, which returns without oscillating; a tool of 1 to 10 kg feels 0.1 to 0.5 of its own
critical damping. It gives the chest 56 N s/m: resuscitation found 257 N s/m over strokes of 46 mm (median of 30
patients; "A simple model to describe the relationship between compression force and depth during CPR", conference
abstract 13048), and damping that grows with the depth (Gruben et al. 1993, J Biomech Eng 115:195, abstract), so that
about 56 N s/m are left at 5 mm, as deep as knocks go (assumed to be in proportion to the depth). Assumed to hold for
the other parts."""
SIZE_M = 0.02
"""Radius of gyration of a plate, which never turns relative to its segment."""
SOLREF, SOLIMP = (0.004, 1.0), (0.98, 0.99, 0.001, 0.5, 2.0)
"""MuJoCo's parameters of the contact with a plate. Its time constant is as short as the step of 2 ms allows, so that
the plate's spring and not the contact determines the force of a knock. The fast mode lengthens it to twice its own
step."""
BARE_SOLREF, BARE_SOLIMP = (0.04, 0.25), (0.95, 0.99, 0.001, 0.5, 2.0)
"""The same where bone has no plate, as in the hand. Stiffness and damping of such a contact are in proportion to the
colliding mass: 10 N/mm and 50 N s/m for each kg, a quarter of critical damping (our choice). 4.4 kg meet at most 45
N/mm; in the standard, the hand's spring has 75 N/mm and the other arm's 30 and 40 N/mm."""
RIGID_TOOL_SOLIMP, BARE_RIGID_TOOL_SOLIMP = (0.1, 0.99, 0.0002, 0.5, 2.0), (0.1, 0.99, 0.001, 0.5, 2.0)
"""Both impedances for a rigid tool: they begin low and grow with depth, over 0.2 and 1 mm.

MuJoCo's friction drives sliding bodies apart, as if an acceleration of friction coefficient times damping times sliding
speed acted along the normal. The contact holds it with D times that, where D is d / (1 - d) times the colliding mass
and d the impedance. If this exceeds the press already at the surface (at 60 mm/s, a plate of 0.2 kg and 0.98: 150 N),
there is no depth at which a gliding tool is in balance: the contact drops out for single steps and rattles with several
N. With a d that grows from 0.1, there is one for every press above 0.4 N. Knocks feel 0.2 mm more way."""


@dataclass(frozen=True, kw_only=True)
class Give:
    """Force of a part of the surface at a depth x: a x + b x^2."""

    a_n_m: float
    b_n_m2: float = 0.0
    frequency_rad_s: float = FREQUENCY_RAD_S
    source: str

    @property
    def mass_kg(self) -> float:
        return max(LEAST_MASS_KG, self.a_n_m / self.frequency_rad_s**2)

    @property
    def damping_ns_m(self) -> float:
        return 2.0 * DAMPING_RATIO * float(np.sqrt(self.a_n_m * self.mass_kg))

    def force_n(self, depth_m: Array) -> Array:
        return self.a_n_m * depth_m + self.b_n_m2 * depth_m**2


STERNUM = (
    "F = 54.9 D + 10.8 D^2 [N, cm], mean of 10 patients during resuscitation (Tsitlik et al. 1983, Crit Care Med "
    "11:685, abstract)"
)
ISO = "effective spring constant of the {} in ISO/TS 15066:2016, from secondary transcriptions, to be checked"
GIVES: dict[str, Give] = {
    "chest": Give(a_n_m=5_490.0, b_n_m2=108_000.0, source=STERNUM),
    "shoulder": Give(a_n_m=35_000.0, source=ISO.format("back and shoulders")),
    "upper_arm": Give(a_n_m=30_000.0, source=ISO.format("upper arms and elbow joints")),
    "forearm": Give(a_n_m=40_000.0, frequency_rad_s=SHANK_RAD_S, source=ISO.format("lower arms and wrist joints")),
    "flank": Give(a_n_m=10_000.0, source=ISO.format("abdomen")),
    "hip": Give(a_n_m=25_000.0, source=ISO.format("pelvis")),
    "thigh": Give(a_n_m=50_000.0, source=ISO.format("thighs")),
    "shank": Give(a_n_m=60_000.0, frequency_rad_s=SHANK_RAD_S, source=ISO.format("lower legs")),
}
BELLY_FLOOR = "belly_floor"
"""Plate that carries the bone under the abdomen's soft region."""
FLOOR_GIVE = Give(a_n_m=10_000.0, source=ISO.format("abdomen"))
"""The standard's spring is of the whole abdomen. The soft tissue over the plate, and what it yields, come on top."""
SEGMENT_OF = {"chest": "thorax", "shoulder": "thorax", "flank": "abdomen", "hip": "pelvis"}
"""Part -> segment, for parts that are not named after a segment."""
ARM = ("upper_arm", "forearm")
"""Parts of which only the arm with soft regions has plates; the other arm is rigid. The plate carries the bone under
the soft region and the bare bone at its ends: shoulder cap and elbow, elbow and wrist."""
FRONT, ACROSS_ARM = np.array([0.0, -1.0, 0.0]), np.array([-0.6, 0.0, 0.8])
"""Directions in the mesh frame of the bind pose. The arms of the nine bodies hang there at 42 to 70 deg from straight
down, so that the second is within 17 deg of square to them."""
SIDEWAYS = {"left": np.array([1.0, 0.0, 0.0]), "right": np.array([-1.0, 0.0, 0.0])}
REACHED_FROM_THE_SIDE = "right"
"""Side on which the robot stands; plates on this side also give way sideways."""
INNER_SIDES = ("flank", "thigh")
"""Parts of the other side of which a tool can reach the inner side: across the abdomen, or between the legs. The
shank's stays rigid, because each degree of freedom makes a step at rest dearer by some 0.7 %."""


@dataclass(frozen=True, kw_only=True)
class Plate:
    name: str
    """Side and part, as in ``right_thigh``."""
    segment: str
    give: Give
    outward: Array
    """(n, 3) directions from which it gives way, in the mesh frame of the bind pose"""

    @property
    def breathes(self) -> bool:
        """Whether the plate moves with the chest's breathing."""
        return self.name.endswith("_chest")


def _plates() -> Iterator[Plate]:
    for part, give in GIVES.items():
        for side, sideways in SIDEWAYS.items():
            reached = side == REACHED_FROM_THE_SIDE
            if part in ARM and not reached:
                continue
            across = ACROSS_ARM if part in ARM else sideways
            aside = [across] if reached else [-sideways] if part in INNER_SIDES else []
            segment = SEGMENT_OF.get(part, f"{side}_{part}")
            yield Plate(name=f"{side}_{part}", segment=segment, give=give, outward=np.array([FRONT, *aside]))
    yield Plate(name=BELLY_FLOOR, segment="abdomen", give=FLOOR_GIVE, outward=np.array([FRONT]))


PLATES = tuple(_plates())


def plates_of(segment: str) -> list[Plate]:
    return [plate for plate in PLATES if plate.segment == segment]


def plate_under(segment: str) -> str | None:
    """Return the name of the plate that carries the bone under a segment's soft region; None: the segment does."""
    if segment == "abdomen":
        return BELLY_FLOOR
    return next((plate.name for plate in plates_of(segment)), None)


def plate_body(plate: str) -> str:
    return f"human_plate_{plate}"


def add_plate(bone: mujoco.MjsBody, plate: Plate, centre: Array) -> mujoco.MjsBody:
    """Add a plate to a bone and return its body. ``centre``: (3,) place of the plate's mass in the bone's frame."""
    name, give = plate_body(plate.name), plate.give
    inertia = np.full(3, give.mass_kg * SIZE_M**2)
    made = bone.add_body(name=name, explicitinertial=True, mass=give.mass_kg, ipos=centre, inertia=inertia)
    spring = {"stiffness": [give.a_n_m, give.b_n_m2, 0.0], "damping": [give.damping_ns_m, 0.0, 0.0]}
    for number, outward in enumerate(plate.outward):
        made.add_joint(name=f"{name}_{number}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=-outward, **spring)
    return made


def meet_rigid_tool(spec: mujoco.MjSpec) -> None:
    """Let a rigid tool glide over all hulls without rattling. Not for one that gives way: its own contact decides."""
    for geom in spec.geoms:
        if geom.name.startswith(("human_hull_", "human_core_")):
            geom.solimp = RIGID_TOOL_SOLIMP if geom.solref[0] == SOLREF[0] else BARE_RIGID_TOOL_SOLIMP


def without_plates(row: SegmentInertia, places: list[tuple[Plate, Array]]) -> tuple[float, Array, Array]:
    """Return mass, centre (3,) and inertia tensor (3, 3), in the mesh frame, of a segment's bone without its plates.

    ``places``: the plates and the places of their masses in the mesh frame.
    """
    mass = row.mass_kg - sum(plate.give.mass_kg for plate, _ in places)
    centre = (row.mass_kg * row.centre_m - sum(plate.give.mass_kg * at for plate, at in places)) / mass
    tensor = row.axes @ np.diag(row.moments_kgm2) @ row.axes.T - mass * _spread(centre - row.centre_m)
    for plate, at in places:
        tensor -= plate.give.mass_kg * (_spread(at - row.centre_m) + SIZE_M**2 * np.eye(3))
    return mass, centre, tensor


def _spread(offset: Array) -> Array:
    """Return the inertia (3, 3) of a unit mass at an offset (3,)."""
    return offset @ offset * np.eye(3) - np.outer(offset, offset)


# Where hulls overlap, both plates carry what lies there, each with a spring of its own, and that place is too stiff.
# Therefore the hulls of neighbouring plates meet in planes.

ARMPIT_M, NECK_M = 0.07, 0.10
ARMPIT_SHARE, GIRDLE_SHARE = 1.15, 0.45
"""The plane between chest and shoulder girdle runs through a point ARMPIT_M below the height of the shoulder's joint,
at ARMPIT_SHARE of the way from the breastbone to it, and one NECK_M above that height at GIRDLE_SHARE of the way. So
the ribs belong to the chest as far as the armpit (our choice)."""
HIP_M = 0.13
"""Distance from the abdomen's lower end down to the plane between hip and thigh."""
RIM_M = 0.015
"""How far the flank reaches under the abdomen's soft region, so that no gap is left between them."""


@dataclass(frozen=True, kw_only=True)
class Plane:
    """A plane in the mesh frame; what it bounds lies at negative heights."""

    normal: Array
    """(3,) unit vector"""
    offset_m: float

    def height_m(self, points: Array) -> Array:
        """Return the heights (n,) of points (n, 3) over the plane."""
        return points @ self.normal - self.offset_m

    @property
    def turned(self) -> Plane:
        return Plane(normal=-self.normal, offset_m=-self.offset_m)


def below(z_m: float) -> Plane:
    return Plane(normal=np.array([0.0, 0.0, 1.0]), offset_m=z_m)


def girdle(body: Body, side: str) -> Plane:
    """Return the plane between chest and shoulder girdle; the chest lies below it."""
    sideways, shoulder = SIDEWAYS[side], body.joint_centre[f"{side}_upper_arm"]
    lower = shoulder * [ARMPIT_SHARE, 1.0, 1.0] - [0.0, 0.0, ARMPIT_M]
    upper = shoulder * [GIRDLE_SHARE, 1.0, 1.0] + [0.0, 0.0, NECK_M]
    run = lower - upper
    normal = np.array([-run[2], 0.0, run[0]]) * sideways[0]
    normal /= np.linalg.norm(normal)
    return Plane(normal=normal, offset_m=float(normal @ lower))


def parted(body: Body) -> dict[str, Array]:
    """Return, for every plate whose hull would otherwise overlap another's, the points (n, 3) of its hull."""
    low, high = belly_span(body)
    hip = low - HIP_M
    found: dict[str, Array] = {}
    for side, outward in SIDEWAYS.items():
        middle = Plane(normal=-outward, offset_m=float(-outward @ body.joint_centre["pelvis"]))
        beside = Plane(normal=-outward, offset_m=RIM_M - belly_half_width(body))
        arm = girdle(body, side)
        ribs, trunk = ("thorax", "left_clavicle", "right_clavicle"), ("thorax", "abdomen", "pelvis")
        pelvis = ("pelvis", "left_thigh", "right_thigh", "abdomen")
        found |= {
            f"{side}_chest": clipped(body, ribs, below(high).turned, middle, arm),
            f"{side}_shoulder": clipped(body, ribs, below(high).turned, middle, arm.turned),
            f"{side}_flank": clipped(body, trunk, below(low).turned, below(high), beside),
            f"{side}_hip": clipped(body, pelvis, below(hip).turned, below(low), middle),
            f"{side}_thigh": clipped(body, (f"{side}_thigh",), below(hip)),
        }
    return found


def clipped(body: Body, segments: tuple[str, ...], *planes: Plane) -> Array:
    """Return the vertices (n, 3) of some segments below all planes, and where their edges cross a plane."""
    mine = np.isin(body.owner, [body.segments.index(s) for s in segments])
    faces = body.faces[mine[body.faces].all(1)]
    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1), axis=0)
    rows = [body.vertices[mine]]
    for plane in planes:
        a, b = body.vertices[edges[:, 0]], body.vertices[edges[:, 1]]
        over_a, over_b = plane.height_m(a), plane.height_m(b)
        cross = over_a * over_b < 0
        share = over_a[cross] / (over_a[cross] - over_b[cross])
        rows.append(a[cross] + share[:, None] * (b - a)[cross])
    points = np.concatenate(rows)
    return points[np.all([plane.height_m(points) < 1e-9 for plane in planes], axis=0)]
