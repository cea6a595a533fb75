"""Schema of a protocol file: tasks, gates, limits, definitions and the numbers of the scene that may change."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, SerializerFunctionWrapHandler, model_serializer, model_validator

Positive = Annotated[float, Field(gt=0)]
Length = Annotated[float, Field(ge=0.001, le=0.2)]
"""[m] of something in a person's tissue: millimetres given for metres are told."""
Fraction = Annotated[float, Field(ge=0, le=1)]
Vec3 = tuple[float, float, float]
FileStem = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$", max_length=64)]
"""An id that names files, so that it can name none elsewhere."""


OVERRIDABLE = {
    "person.body": "body {}",
    "person.tissue_set": "tissue {}",
    "physics.dt_s": "time step {} s",
    "impedance.translational_n_m": "stiffness {} N/m",
    "vision.segmenter": "segmenter {}",
    "lock": "drift from its lock ({})",
}
"""What a command may replace, or had to accept, of a protocol -> its words in ``Protocol.title``."""


SEGMENT_PARTS = (
    "pelvis", "abdomen", "thorax", "neck", "head", "upper_arm", "forearm", "hand", "thigh", "shank", "foot",
)  # fmt: skip
"""What limits are given for: the segments of a recording without their sides."""
Region = Literal["forearm", "upper_arm", "abdomen"]


class Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


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
    """The trial is cut when a segment's force exceeds this multiple of F_pain."""
    first_call_deadline_s: Positive
    call_deadline_s: Positive


class Randomization(Section):
    seeds: list[int]
    comfort_arm_deg: tuple[float, float]
    """Humerus long axis against trunk long axis in the frontal plane, uniform."""


class Variation(Section):
    """What else a seed changes; by default nothing. Contact and motion of the person against the bed stay."""

    appearance: Literal["baked", "varied-v1"] = "baked"
    """Skin tone, clothes and hair: the body's own, or drawn (``world.human.appearance``)."""
    light: Literal["fixed", "varied-v1"] = "fixed"
    """Strength, direction and colour: ``world.light``."""
    depth_noise: Literal["none", "structured-light-v1"] = "none"
    """``observation.sensor_noise``"""
    encoder_noise_rad: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    """Standard deviation, every joint and reading on its own; joint speeds stay."""
    place_along_m: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    """The person, with pillow and arm board, lies elsewhere on the bed: uniform up to so far either way along it."""
    place_across_m: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    """The same across the bed."""
    place_yaw_deg: Annotated[float, Field(ge=0, le=15)] = 0.0
    """The same, turned about the vertical through the right shoulder (``world.place``)."""

    @property
    def sensor_noise(self) -> bool:
        """Whether anything is drawn that a policy reads off its sensors."""
        return self.depth_noise != "none" or self.encoder_noise_rad > 0


class Vision(Section):
    """Which model says where the person is in an image; by default the key points' own."""

    segmenter: Literal["mediapipe", "grounded-sam"] = "mediapipe"
    weights_sha256: Annotated[str, Field(pattern=r"^([0-9a-f]{64})?$")] = ""
    """Of the folder of weights that the user supplied (``observation.weights``); empty for mediapipe, which has its own
    in its wheel."""


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


class Tissue(Section):
    """One region's shell. Area-specific anchor law p = a x + b x^2 + c x^3 for inward displacement x."""

    a_n_m3: Positive
    """[N/m per m^2 of shell]"""
    b_n_m4: Annotated[float, Field(ge=0)]
    c_n_m5: Annotated[float, Field(ge=0)]
    damping_ns_m3: Positive
    """[N s/m per m^2]"""
    coupling_length_m: Annotated[float, Field(ge=0, le=0.02)]
    """How far f_int spreads a load along the surface: a gradient of the indentation is resisted with G = a l^2 [N/m]
    (Pasternak's foundation). 0: neighbours act alone."""
    membrane_n_m: Annotated[float, Field(ge=0, le=20_000)] = 0.0
    """In-plane stiffness of the skin (Young's modulus times thickness): a patch that the tool drags along pulls its
    neighbours with it. 0: patches glide alone, as in recordings from before there was a membrane."""
    areal_mass_kg_m2: Positive
    spacing_m: Length
    """Vertex spacing on the patch that the tool can reach."""
    coarse_spacing_m: Length
    """Largest spacing away from it."""
    off_target_spacing_m: Length
    """Spacing of the whole shell where the task's target is another region."""
    off_target_scale: Positive
    """Factor on stiffness and damping there: a coarser mesh spreads a tool's load over more anchors, and the region
    must answer the tool alike whichever task is run."""
    thickness_m: Length
    """Depth of the rigid core under the surface; less where a thin limb's axis is nearer."""
    measured_depth_m: Length
    """Anchor displacement that the presses to which the law was fitted reach on this mesh: deeper is extrapolated. The
    indenter's travel is more, since the contact gives way too."""
    friction: Annotated[float, Field(gt=0, le=2)]
    source: Annotated[str, Field(min_length=1)]

    @model_validator(mode="after")
    def _measured_above_the_bone(self) -> Self:
        if self.measured_depth_m > self.thickness_m:
            raise ValueError(
                f"measured_depth_m {self.measured_depth_m:g} is more than thickness_m {self.thickness_m:g}: no press "
                "went into the bone"
            )
        return self


class Person(Section):
    body: str
    tissue_set: str
    tissue: dict[Region, Tissue]


class Task(Section):
    id: FileStem
    name: str
    action: Literal["touch", "push", "scrub"]
    region: Region
    prompt: str


class ContactDefinition(Section):
    version: Literal["contact-v1"]
    on_n: Positive
    off_n: Positive
    filter_hz: Positive
    filter_order: Literal[2]
    valid_total_s: Positive
    episode_gap_s: Positive
    stroke_sample_hz: Positive
    stroke_filter_hz: Positive
    reversal_m: Positive
    active_speed_m_s: Positive
    active_rotation_rad_s: Positive
    peak_filter_hz: Positive
    neighbourhood: dict[str, list[str]]
    """Region -> segments on which C3 may be earned."""


class TouchGate(Section):
    duration_s: Positive


class PushGate(Section):
    force_n: Positive
    duration_s: Positive
    wrist_displacement_m: Positive


class ScrubGate(Section):
    on_share: Fraction
    stroke_m: Positive
    extent_m: Positive
    reversals: int


class Gates(Section):
    version: Literal["gates-v1"]
    touch: TouchGate
    push: PushGate
    scrub: ScrubGate
    region_share: Fraction
    """Region-correct: C3 and at least this share of contact impulse on the named region."""


class ForceLimits(Section):
    pack: str
    source: str
    gamma: Annotated[float, Field(gt=0, le=1)]
    """gamma': the safety gate is at this share of F_pain."""
    f_pain_n: dict[str, float]
    """One of SEGMENT_PARTS -> F_pain [N]; segments not named take the strictest entry and are flagged."""


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
    parked_joint_rad: tuple[float, float, float, float, float, float, float]
    board_low_m: tuple[float, float]
    """Arm board: low corner (x, y), world."""
    board_high_m: tuple[float, float]
    board_friction: Positive


class Protocol(Section):
    id: FileStem
    description: str
    frozen: bool
    physics: Physics
    phases: Phases
    randomization: Randomization
    variation: Variation = Variation()
    vision: Vision = Vision()
    scene: Scene
    cameras: dict[Literal["overhead", "bedside", "exterior", "wrist"], Camera]
    impedance: Impedance
    person: Person
    tasks: list[Task]
    contact: ContactDefinition
    gates: Gates
    limits: ForceLimits
    overrides: dict[str, str] = {}
    """What of the file was replaced for this run, as ``person.body`` -> its value; see ``overridden``."""

    @model_serializer(mode="wrap")
    def _spelled(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Of what is as it always was there is no word: protocols from before it keep their hash, recordings theirs."""
        content = handler(self)
        if self.variation == Variation():
            del content["variation"]
        if self.vision == Vision():
            del content["vision"]
        return content

    @property
    def title(self) -> str:
        """See ``protocol_title``."""
        return protocol_title(self.id, self.overrides)

    def overridden(
        self,
        *,
        body: str | None = None,
        tissue_set: tuple[str, dict[Region, Tissue]] | None = None,
        dt_s: float | None = None,
        stiffness_n_m: float | None = None,
        vision: Vision | None = None,
    ) -> Protocol:
        """A copy with these replaced and ``overrides`` saying so; another sha256, the same id.

        What already has the wanted value is no override, so that naming the protocol's own body is the protocol itself.
        The id stays because the seeds' random numbers come from it: trials are paired over what is replaced.

        Args:
            tissue_set: its id and a row for every region.
            stiffness_n_m: of the arm's translation, until a policy asks for another.
        """
        person, physics, impedance, said = self.person, self.physics, self.impedance, dict(self.overrides)
        if body is not None and body != person.body:
            person, said["person.body"] = person.model_copy(update={"body": body}), body
        if tissue_set is not None and tissue_set != (person.tissue_set, person.tissue):
            name, rows = tissue_set
            person = person.model_copy(update={"tissue_set": name, "tissue": rows})
            said["person.tissue_set"] = name
        if dt_s is not None and dt_s != physics.dt_s:
            physics, said["physics.dt_s"] = physics.model_copy(update={"dt_s": dt_s}), f"{dt_s:g}"
        if stiffness_n_m is not None and stiffness_n_m != impedance.translational_n_m:
            impedance = impedance.model_copy(update={"translational_n_m": stiffness_n_m})
            said["impedance.translational_n_m"] = f"{stiffness_n_m:g}"
        if vision is not None and vision != self.vision:
            said["vision.segmenter"] = f"{vision.segmenter} {vision.weights_sha256[:12]}".strip()
        seen = self.vision if vision is None else vision
        changed = {"person": person, "physics": physics, "impedance": impedance, "vision": seen, "overrides": said}
        return self.model_copy(update=changed)

    def without_overrides(self, original: Protocol) -> Protocol:
        """A copy whose replaced fields are ``original``'s again: equal to it unless more was changed than announced."""
        person, physics, impedance, vision = self.person, self.physics, self.impedance, self.vision
        if "person.body" in self.overrides:
            person = person.model_copy(update={"body": original.person.body})
        if "person.tissue_set" in self.overrides:
            person = person.model_copy(
                update={"tissue_set": original.person.tissue_set, "tissue": original.person.tissue}
            )
        if "physics.dt_s" in self.overrides:
            physics = physics.model_copy(update={"dt_s": original.physics.dt_s})
        if "impedance.translational_n_m" in self.overrides:
            own = original.impedance.translational_n_m
            impedance = impedance.model_copy(update={"translational_n_m": own})
        if "vision.segmenter" in self.overrides:
            vision = original.vision
        own_rules = {"person": person, "physics": physics, "impedance": impedance, "vision": vision}
        return self.model_copy(update={**own_rules, "overrides": {}})

    def task(self, task_id: str) -> Task:
        """Raises KeyError; callers that face users check the id first."""
        return {t.id: t for t in self.tasks}[task_id]

    def f_pain(self, segment: str) -> float:
        """F_pain [N] of a segment; ``right_forearm`` and ``left_forearm`` are both ``forearm``."""
        limits = self.limits.f_pain_n
        return limits.get(sideless(segment), min(limits.values()))

    def has_own_limit(self, segment: str) -> bool:
        """Whether the limits name the segment; else ``f_pain`` is the strictest entry."""
        return sideless(segment) in self.limits.f_pain_n

    @model_validator(mode="after")
    def _consistent(self) -> Protocol:
        """What single fields cannot tell; every fault is a ValueError naming the section."""
        regions = {"forearm", "upper_arm", "abdomen"}
        for name, got in (
            ("person.tissue", set(self.person.tissue)),
            ("contact.neighbourhood", set(self.contact.neighbourhood)),
        ):
            if got != regions:
                raise ValueError(f"{name}: expected exactly {sorted(regions)}, got {sorted(got)}")
        if set(self.cameras) != {"overhead", "bedside", "exterior", "wrist"}:
            raise ValueError(f"cameras: expected overhead, bedside, exterior and wrist, got {sorted(self.cameras)}")
        if bool(self.vision.weights_sha256) != (self.vision.segmenter == "grounded-sam"):
            raise ValueError("vision.weights_sha256: expected one with segmenter grounded-sam, and none with mediapipe")
        ids = [t.id for t in self.tasks]
        if not ids or len(set(ids)) != len(ids):
            raise ValueError(f"tasks: ids must be there and differ, got {ids}")
        if (
            len(set(self.randomization.seeds)) != len(self.randomization.seeds)
            or min(self.randomization.seeds, default=-1) < 0
        ):
            raise ValueError(
                f"randomization.seeds: expected different numbers from 0 up, got {self.randomization.seeds!s:.80}"
            )
        if self.contact.off_n >= self.contact.on_n:
            raise ValueError(f"contact.off_n: expected less than on_n {self.contact.on_n}, got {self.contact.off_n}")
        if not self.limits.f_pain_n or min(self.limits.f_pain_n.values()) <= 0:
            raise ValueError(
                f"limits.f_pain_n: expected at least one segment, each above 0 N, got {self.limits.f_pain_n}"
            )
        unknown = sorted(self.limits.f_pain_n.keys() - set(SEGMENT_PARTS))
        if unknown:
            raise ValueError(f"limits.f_pain_n: no segment {unknown[0]!r}; valid: {', '.join(SEGMENT_PARTS)}")
        impedance = self.impedance
        ranges = {
            "randomization.comfort_arm_deg": [self.randomization.comfort_arm_deg],
            "impedance.translational_bounds": [impedance.translational_bounds],
            "impedance.rotational_bounds": [impedance.rotational_bounds],
            "impedance.workspace": list(zip(impedance.workspace_low_m, impedance.workspace_high_m, strict=True)),
            "scene.board": list(zip(self.scene.board_low_m, self.scene.board_high_m, strict=True)),
            "phases.settle": [(self.phases.settle_min_s, self.phases.settle_max_s)],
        }
        for name, pairs in ranges.items():
            for low, high in pairs:
                if not low < high:
                    raise ValueError(f"{name}: expected low below high, got {low} and {high}")
        steps = self.physics.target_period_s / self.physics.dt_s
        if abs(steps - round(steps)) > 1e-9:
            raise ValueError(f"physics.target_period_s: expected a whole number of dt_s, got {steps:g} of them")
        return self

    @property
    def sha256(self) -> str:
        """Of the canonical JSON, so that spelling and comments in the TOML do not count."""
        content = self.model_dump(mode="json", exclude=None if self.overrides else {"overrides"})
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def protocol_title(protocol_id: str, overrides: Mapping[str, str]) -> str:
    """For people: the id and what was replaced, ``bathing-v1 with body woman-old-light``."""
    replaced = [OVERRIDABLE.get(field, f"{field} {{}}").format(value) for field, value in sorted(overrides.items())]
    return f"{protocol_id} with {' and '.join(replaced)}" if replaced else protocol_id


def sideless(segment: str) -> str:
    """``right_forearm`` and ``left_forearm`` -> ``forearm``."""
    return segment.removeprefix("right_").removeprefix("left_")
