"""The other sections of a protocol: robot, scene, physics, limits, vision, and what each seed draws."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from carecontact.interface.regions import SEGMENTS
from carecontact.interface.robot import EMBODIMENTS, ActionBounds, Compliance, Robot
from carecontact.protocol.gates import Fraction, Length, Positive, Section, Vec3, one_of, registered

DAMPING_RATIO = 1.0
"""Share of critical damping of the Cartesian impedance until an action changes it."""


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
    def compliance(self) -> Compliance:
        """What acts until an action changes it, which a policy receives with the bounds."""
        return Compliance(
            stiffness=(self.translational_n_m, self.rotational_nm_rad),
            damping_ratio=DAMPING_RATIO,
            effective_mass_kg=self.effective_mass_kg,
            effective_inertia_kgm2=self.effective_inertia_kgm2,
        )

    @property
    def action_bounds(self) -> ActionBounds:
        """What an action may ask for, which a policy receives before its first one."""
        return ActionBounds(
            workspace_low_m=self.workspace_low_m,
            workspace_high_m=self.workspace_high_m,
            translational_stiffness=self.translational_bounds,
            rotational_stiffness=self.rotational_bounds,
        )


def sideless(segment: str) -> str:
    """``right_forearm`` and ``left_forearm`` -> ``forearm``."""
    return segment.removeprefix("right_").removeprefix("left_")


SEGMENT_PARTS = tuple(dict.fromkeys(map(sideless, SEGMENTS)))
"""Names that limits can be given for: the segments of a recording without their sides."""


class ForceLimits(Section):
    pack: str
    source: str
    gamma: Annotated[float, Field(gt=0, le=1)]
    """gamma': the safety gate is at this share of F_pain."""
    f_pain_n: dict[str, float]
    """One of SEGMENT_PARTS -> F_pain [N]; segments not named take the strictest entry and are flagged."""


class Physics(Section):
    dt_s: Positive
    """Physics step; scorer streams are sampled at every step."""
    integrator: Literal["implicitfast"]
    target_period_s: Positive
    """The impedance target moves this often, along a straight line to the policy's last target."""
    max_tcp_speed_m_s: Positive
    max_tcp_rotation_rad_s: Positive


class Phases(Section):
    settle_min_s: Positive
    settle_max_s: Positive
    settle_speed_m_s: Positive
    settle_hold_s: Positive
    time_limit_s: Positive
    truncation_over_pain: Positive
    """The benchmark stops the trial when a segment's force exceeds this multiple of F_pain."""
    first_call_deadline_s: Positive
    call_deadline_s: Positive
    latency_s: Annotated[float, Field(ge=0, le=10)] = 0.0
    """Simulated time between an observation and the first action that answers it; the last target holds meanwhile. At
    0 the world stands still while a policy computes."""


class Camera(Section):
    position_m: Vec3
    look_at_m: Vec3
    up: Vec3
    fovy_deg: Positive
    width: Annotated[int, Field(gt=0, le=1280)]
    height: Annotated[int, Field(gt=0, le=960)]
    mount: Literal["world", "hand"] = "world"


class Scene(Section):
    mattress_top_m: float
    robot_base_m: Vec3
    robot_yaw_deg: float
    parked_joint_rad: tuple[float, ...]
    board_low_m: tuple[float, float]
    """Arm board: low corner (x, y), world."""
    board_high_m: tuple[float, float]
    board_friction: Positive
    tool: Annotated[str, registered(EMBODIMENTS)] = "caps"
    """The robot, named by what its hand wears: a rigid cap over the fingertips, or a soft wash mitt
    (``interface.robot``)."""

    @property
    def robot(self) -> Robot:
        return EMBODIMENTS[self.tool]

    @model_validator(mode="after")
    def _one_angle_for_each_joint(self) -> Self:
        if (count := len(self.robot.joints)) != len(self.parked_joint_rad):
            raise ValueError(f"parked_joint_rad: expected {count} angles [rad], got {len(self.parked_joint_rad)}")
        return self


Spread = Annotated[float, Field(ge=0, le=0.5)]


class BasePlacement(Section):
    """Where the robot may stand beside the bed: a base is drawn, and drawn again, until it serves the task's region
    (``episode.base_placement``).

    A base's height is against a bed that stays: a lower base is a bed raised against the robot.
    """

    manner: Literal["nearest", "anywhere"]
    """``nearest``: the draws begin at ``centre`` and spread from there, so that the robot moves no farther than this
    person needs. ``anywhere``: every draw is uniform over the whole spread, as if someone had rolled the robot there.
    """
    centre_m: Vec3
    """World."""
    centre_yaw_deg: float
    spread_m: tuple[Spread, Spread, Spread]
    """Up to so far either way along each axis of the world."""
    spread_yaw_deg: Annotated[float, Field(ge=0, le=45)]
    tries: Annotated[int, Field(ge=1, le=10_000)] = 1000
    """A person for whom no base serves after so many draws is replaced by another draw."""


class ArmErrors(Section):
    """How a real arm differs from its model; the arm of a protocol without this table is ideal. A policy learns these
    sizes (``interface.robot.Session``), and never what was drawn."""

    force_bias_n: Annotated[float, Field(ge=0, le=5)] = 1.0
    """Standard deviation of a force at the tool, along each axis of the base, that the arm exerts beside what is
    commanded; drawn by the seed, constant in a trial. Assumed: the maker of the shipped arm gives all of its arms the
    masses of an average one (frankarobotics/franka_ros, issue 404), and what that leaves is not published."""
    friction: Annotated[float, Field(ge=0, le=5)] = 1.0
    """Dry friction of the joints, as a multiple of what was identified (``Robot.friction_nm``)."""

    def joint_friction_nm(self, robot: Robot) -> tuple[float, ...]:
        """(joints,)"""
        return tuple(self.friction * torque for torque in robot.friction_nm)


DRAWN = ("bodies", "shoulder_rotation_deg", "palm_deg", "place_toward_head_m", "overhead_shift_m", "overhead_turn_deg",
         "parking")  # fmt: skip
"""Fields that change the compiled model with the seed."""
Angles = tuple[float, float]


def _ordered(pair: Angles) -> Angles:
    if not -180 <= pair[0] <= pair[1] <= 180:
        raise ValueError(f"expected [low, high] degrees, low at most high, got [{pair[0]:g}, {pair[1]:g}]")
    return pair


class Randomization(Section):
    seeds: list[int]
    comfort_arm_deg: tuple[float, float]
    """Angle between the humerus' long axis and the trunk's in the frontal plane; uniform over this range."""
    drawn_as: str = ""
    """Name from which seeds draw, in place of the protocol's id: a draft that is renamed when it is frozen keeps its
    persons."""


class Variation(Section):
    """What else a seed changes; by default nothing. Contact and motion of the person against the bed stay."""

    appearance: Literal["baked", "varied-v1"] = "baked"
    """Skin tone, clothes and hair: the body's own, or drawn (``human.skin.draw_appearance``)."""
    light: Literal["fixed", "varied-v1"] = "fixed"
    """Strength, direction and colour: ``world.room.draw_light``."""
    depth_noise: Literal["none", "structured-light-v1"] = "none"
    """``sensing.builder.structured_light``"""
    encoder_noise_rad: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    """Standard deviation, every joint and reading on its own. The joints' speeds get noise that belongs to it
    (``sensing.builder.SPEED_PER_ANGLE``)."""
    place_along_m: Annotated[float, Field(ge=0, le=0.2)] = 0.0
    """The person, with pillow and arm board, lies elsewhere on the bed: uniform up to so far either way along it."""
    place_across_m: Annotated[float, Field(ge=0, le=0.2)] = 0.0
    """The same across the bed."""
    place_yaw_deg: Annotated[float, Field(ge=0, le=15)] = 0.0
    """The same, turned about the vertical through the right shoulder (``world.draws.Place``)."""
    calibration_m: Annotated[float, Field(ge=0, le=0.05)] = 0.0
    """Standard deviation of the error with which the cell knows where each fixed camera is, along each axis."""
    calibration_deg: Annotated[float, Field(ge=0, le=5)] = 0.0
    """The same about each axis of the camera (``sensing.calibration``)."""
    tissue: Literal["declared", "published-v1"] = "declared"
    """How stiff the soft regions are: as ``person.tissue`` says, or that times a factor that is drawn from published
    differences between people (``human.soft_region.Spread``)."""
    place_toward_head_m: Annotated[float | None, Field(ge=0, le=0.2)] = None
    """Farthest toward the head, where that is less than ``place_along_m``: patients slide down in bed, not up."""
    bodies: tuple[str, ...] = ()
    """The person is one of these: a block of as many seeds has each of them once, in an order of its own. Without any
    it is ``person.body``."""
    shoulder_rotation_deg: Annotated[Angles, AfterValidator(_ordered)] = (0.0, 0.0)
    """Added to ``person.shoulder_rotation_deg``; uniform over this range."""
    palm_deg: Annotated[Angles, AfterValidator(_ordered)] = (0.0, 0.0)
    """Added to ``person.palm_deg``; uniform over this range."""
    overhead_shift_m: Annotated[float, Field(ge=0, le=0.2)] = 0.0
    """The overhead camera is mounted elsewhere: uniform up to so far either way along each axis of the world."""
    overhead_turn_deg: Annotated[float, Field(ge=0, le=10)] = 0.0
    """The same, turned about each axis of the camera."""
    parking: BasePlacement | None = None
    """The places where the robot may stand; without it, the robot stands at ``scene.robot_base_m``."""

    @property
    def sensor_noise(self) -> bool:
        """Whether the protocol adds noise to what the policy's sensors read."""
        return self.depth_noise != "none" or self.encoder_noise_rad > 0

    @property
    def draws_models(self) -> bool:
        """Whether trials of one region and several seeds have several compiled models."""
        return any(getattr(self, name) != type(self).model_fields[name].default for name in DRAWN)


Rgb = tuple[int, int, int]

FOAM_COLOURS: dict[str, Rgb] = {"cyan": (0, 236, 232), "lime": (110, 235, 0), "magenta": (236, 0, 190)}
"""Colours of foam as sRGB under the default light: at least 40 in CIELAB (delta E of 1976) from every skin, garment,
hair, linen and part of the robot, which white, pale blue and pink are not. A test measures it."""
OTHER_COLOURS: dict[str, Rgb] = {"orange": (240, 130, 20), "yellow": (240, 205, 20), "blue": (30, 70, 220),
                                 "red": (215, 35, 30)}  # fmt: skip
"""Colours of things that are no foam: as saturated as foam is, and at least 40 from each of its colours."""


class Foam(Section):
    """A patch of foam on the skin of the region that a task names (``human.foam``). It has a colour and no substance:
    neither depth images nor forces know of it."""

    along: tuple[Fraction, Fraction]
    """The patch's middle, as shares of the region's length from the end nearer the trunk (abdomen: the feet)."""
    around_deg: Annotated[float, Field(ge=0, le=60)]
    """The middle lies up to so far either way from the side of the region that faces up, about the region's axis."""
    disc_m: Length
    """Radius of the disc of every task but a scrub."""
    oval_m: tuple[Length, Length]
    """Half length along the region and half width across it of a scrub's oval."""
    room_m: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    """Least distance between the patch and either end of the region, so that a tool on the patch touches no other
    segment. On a region that is too short for it, the patch lies in the middle."""
    colours: Annotated[tuple[Annotated[str, one_of("colour", FOAM_COLOURS)], ...], Field(min_length=1)]
    """The seed draws one of them."""
    prompts: dict[str, str]
    """Task -> its instruction with the foam, in place of the task's own. A task that is not named has no foam."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.along[0] > self.along[1]:
            raise ValueError(f"along: expected [low, high], low at most high, got {list(self.along)}")
        return self


class Distractors(Section):
    """A towel on the bed and a dressing on a limb that no task names, in strong colours that foam does not have. They
    can be seen, and nothing else: neither has contact, and the dressing, which is painted, has no depth either."""

    towel_m: tuple[Length, Length]
    """Half length along the bed and half width across it of the folded towel beside the legs."""
    dressing_m: tuple[Length, Length]
    """Half length along the limb and half width across it of the dressing."""
    colours: Annotated[tuple[Annotated[str, one_of("colour", OTHER_COLOURS)], ...], Field(min_length=1)]
    """The seed draws one of them for each."""


class Vision(Section):
    """The model that makes the masks; by default, it is the one that finds the key points."""

    segmenter: Literal["mediapipe", "grounded-sam"] = "mediapipe"
    weights_sha256: Annotated[str, Field(pattern=r"^([0-9a-f]{64})?$")] = ""
    """Hash of the folder of weights that the user supplied (``sensing.grounded_sam.weights_sha256``); empty for
    mediapipe, which has its own in its wheel."""


class Level(Section):
    """The fields of one level that decide whether a person suits it; each person must suit all levels of a file."""

    variation: Variation
    reposition_m: Annotated[float, Field(ge=0, le=0.2)] = 0.0
    """How far the person moves the wrist along the board at most."""
