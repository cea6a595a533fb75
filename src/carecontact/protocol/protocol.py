"""A protocol as a whole, the checks over its sections, and the spec of one trial under it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from fnmatch import fnmatchcase
from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from carecontact.interface.regions import REGIONS
from carecontact.protocol.gates import ContactDefinition, FileStem, Gates, Section, Task, absent, regions_of
from carecontact.protocol.person import Person
from carecontact.protocol.sections import (
    SEGMENT_PARTS,
    ArmErrors,
    Camera,
    Distractors,
    Foam,
    ForceLimits,
    Impedance,
    Level,
    Phases,
    Physics,
    Randomization,
    Scene,
    Variation,
    Vision,
    sideless,
)

FRICTION = "person.tissue.*.friction"
"""Stands for the friction of several regions that is the same on all of them."""
REPLACED_WORDS = {
    "person.body": "body {}",
    "person.tissue_set": "tissue {}",
    "scene.tool": "tool {}",
    "physics.dt_s": "time step {} s",
    "impedance.translational_n_m": "stiffness {} N/m",
    "vision.segmenter": "segmenter {}",
    FRICTION: "friction {}",
    "lock": "differences from its lock ({})",
}
"""Dotted path of a replaced field -> its words; any other path stands for itself. ``lock`` is not a field: it
stands for a run on a protocol that differs from its lock (``protocol.lock``)."""
CAMERA_NAMES = ("overhead", "bedside", "exterior", "wrist")


def protocol_title(protocol_id: str, overrides: Mapping[str, str]) -> str:
    """``bathing-v3 with body woman-old-light``; the same friction on several regions is one replaced field."""
    replaced = dict(overrides)
    friction = {path: value for path, value in overrides.items() if fnmatchcase(path, FRICTION)}
    if len(friction) > 1 and len(set(friction.values())) == 1:
        replaced = {path: value for path, value in overrides.items() if path not in friction}
        replaced[FRICTION] = next(iter(friction.values()))
    words = [REPLACED_WORDS.get(path, f"{path} {{}}").format(value) for path, value in sorted(replaced.items())]
    return f"{protocol_id} with {' and '.join(words)}" if words else protocol_id


def _contradictions(rules: Protocol) -> Iterator[str]:
    """What contradicts itself over several fields of a protocol: the field, and what is expected."""
    ids = [task.id for task in rules.tasks]
    if not ids or len(set(ids)) != len(ids):
        yield f"tasks: expected at least one, each with an id of its own; got {ids}"
    for task in rules.tasks:
        if task.action not in rules.gates.actions:
            yield f"gates.{task.action}: missing, and task {task.id} needs it"
        if task.region not in rules.contact.neighbourhood:
            yield f"contact.neighbourhood.{task.region}: missing, and task {task.id} needs it"
    soft, owner = [name for name in rules.regions if REGIONS[name].soft], dict[str, str]()
    if set(rules.person.tissue) != set(soft):
        yield (
            f"person.tissue: expected exactly {sorted(soft)}, the soft regions of every person and of the tasks; "
            f"got {sorted(rules.person.tissue)}"
        )
    for name in soft:
        other = owner.setdefault(REGIONS[name].segment, name)
        if other != name:
            yield (
                f"tasks: {other} and {name} are both soft regions of {REGIONS[name].segment}; "
                "expected at most one soft region per segment"
            )
    if set(rules.cameras) != set(CAMERA_NAMES):
        yield f"cameras: expected overhead, bedside, exterior and wrist, got {sorted(rules.cameras)}"
    if bool(rules.vision.weights_sha256) != (rules.vision.segmenter == "grounded-sam"):
        yield (
            "vision.weights_sha256: expected the sha256 of the weights with segmenter grounded-sam, "
            "and an empty text with mediapipe"
        )
    seeds, pain = rules.randomization.seeds, rules.limits.f_pain_n
    if len(set(seeds)) != len(seeds) or min(seeds, default=-1) < 0:
        yield f"randomization.seeds: expected distinct whole numbers >= 0, got {seeds!s:.80}"
    if not pain or min(pain.values()) <= 0:
        yield f"limits.f_pain_n: expected at least one segment, each above 0 N, got {pain}"
    for unknown in sorted(pain.keys() - set(SEGMENT_PARTS)):
        yield f"limits.f_pain_n: no segment {unknown!r}; valid: {', '.join(SEGMENT_PARTS)}"
    robot, errors = rules.scene.robot, rules.arm_errors
    if errors is not None and errors.friction and len(robot.friction_nm) != len(robot.joints):
        yield f"arm_errors.friction: the friction of robot {robot.id} is not known; expected 0, got {errors.friction:g}"
    if rules.foam is not None:
        for task_id in rules.foam.prompts:
            if task_id not in ids:
                yield f"foam.prompts.{task_id}: no such task; valid: {', '.join(ids)}"
            elif not REGIONS[rules.task(task_id).region].soft:
                yield f"foam.prompts.{task_id}: the {rules.task(task_id).region} is rigid, and foam needs soft skin"
        if rules.gates.set != "exam":
            yield f"gates.set: foam needs the exam's gates, got {rules.gates.set}"
        if rules.gates.foam is None:
            yield "gates.foam: missing, and [foam] needs it"
    yield from _disordered(rules)
    steps = rules.physics.target_period_s / rules.physics.dt_s
    if abs(steps - round(steps)) > 1e-9:
        yield f"physics.target_period_s: expected a whole number of dt_s, got {steps:g} of them"


def _disordered(rules: Protocol) -> Iterator[str]:
    """Low ends that are not below high ends, and a stiffness of the arm outside its bounds."""
    contact, impedance, scene, phases = rules.contact, rules.impedance, rules.scene, rules.phases
    if contact.off_n >= contact.on_n:
        yield f"contact.off_n: expected less than on_n {contact.on_n}, got {contact.off_n}"
    ranges = {
        "randomization.comfort_arm_deg": [rules.randomization.comfort_arm_deg],
        "impedance.translational_bounds": [impedance.translational_bounds],
        "impedance.rotational_bounds": [impedance.rotational_bounds],
        "impedance.workspace": list(zip(impedance.workspace_low_m, impedance.workspace_high_m, strict=True)),
        "scene.board": list(zip(scene.board_low_m, scene.board_high_m, strict=True)),
        "phases.settle": [(phases.settle_min_s, phases.settle_max_s)],
    }
    for name, low, high in ((name, *pair) for name, pairs in ranges.items() for pair in pairs):
        if not low < high:
            yield f"{name}: expected low below high, got {low} and {high}"
    for name, value, (low, high) in (
        ("translational_n_m", impedance.translational_n_m, impedance.translational_bounds),
        ("rotational_nm_rad", impedance.rotational_nm_rad, impedance.rotational_bounds),
    ):
        if not low <= value <= high:
            yield f"impedance.{name}: expected {low:g} to {high:g}, its bounds, got {value:g}"


class Protocol(Section):
    """Everything that a benchmark fixes, with a hash over all of it."""

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
    arm_errors: ArmErrors | None = Field(default=None, exclude_if=absent)
    person: Person
    tasks: list[Task]
    contact: ContactDefinition
    gates: Gates
    limits: ForceLimits
    foam: Foam | None = Field(default=None, exclude_if=absent)
    """Foam that marks where to touch and what to clean; None: there is none."""
    distractors: Distractors | None = Field(default=None, exclude_if=absent)
    """Objects that a policy could mistake for foam; None without any."""
    level: str = ""
    """Which level of its file this is; empty for a file without levels (``protocols.levels``)."""
    levels: dict[str, Level] = Field(default_factory=dict[str, Level])
    """All levels of the file, in its order: a seed's person must suit each of them. Written by the loader."""
    overrides: dict[str, str] = Field(default_factory=dict[str, str])
    """Fields that a command replaced for this run: dotted path -> new value (``protocols.overrides``)."""

    @property
    def name(self) -> str:
        """The id, and the level where there is one: what results call this protocol, such as ``my-protocol L2``."""
        return f"{self.id} {self.level}" if self.level else self.id

    @property
    def title(self) -> str:
        """See ``protocol_title``."""
        return protocol_title(self.name, self.overrides)

    @property
    def regions(self) -> tuple[str, ...]:
        """Every region of this protocol's worlds and recordings, in the order of their columns."""
        return regions_of(self.tasks)

    @property
    def soft_regions(self) -> tuple[str, ...]:
        """The regions that have a soft shell, and so a row in ``person.tissue``."""
        return tuple(name for name in self.regions if name in self.person.tissue)

    def task(self, task_id: str) -> Task:
        """Return a task with the prompt that a policy receives, which may name foam. Raises KeyError."""
        task = {t.id: t for t in self.tasks}[task_id]
        prompt = None if self.foam is None else self.foam.prompts.get(task_id)
        return task if prompt is None else task.model_copy(update={"prompt": prompt})

    def has_foam(self, task_id: str) -> bool:
        """Whether a task's region has foam on it."""
        return self.foam is not None and task_id in self.foam.prompts

    def f_pain(self, segment: str) -> float:
        """F_pain [N] of a segment; ``right_forearm`` and ``left_forearm`` are both ``forearm``."""
        limits = self.limits.f_pain_n
        return limits.get(sideless(segment), min(limits.values()))

    def most_n(self, action: str, segment: str) -> float:
        """Return the largest force [N] that a segment may bear in a trial of an action: its safety gate, gamma' F_pain,
        or the largest force of the whole trial (``gates.Conduct.peak_n``) if that is less."""
        gate_n, conduct = self.limits.gamma * self.f_pain(segment), (self.gates.conduct or {}).get(action)
        return gate_n if conduct is None else min(gate_n, conduct.peak_n)

    def has_own_limit(self, segment: str) -> bool:
        """Whether the limits name the segment; else ``f_pain`` is the strictest entry."""
        return sideless(segment) in self.limits.f_pain_n

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for fault in _contradictions(self):
            raise ValueError(fault)
        return self

    @property
    def draws(self) -> bool:
        """Whether a recording has to say what the seed drew of the world."""
        return self.variation.draws_models or self.arm_errors is not None

    @property
    def drawn_as(self) -> str:
        """Name from which seeds draw (``Randomization.drawn_as``)."""
        return self.randomization.drawn_as or self.id

    @property
    def sha256(self) -> str:
        """Hash of the canonical JSON, so that spelling and comments in the TOML do not count."""
        content = self.model_dump(mode="json", exclude=None if self.overrides else {"overrides"})
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def commitment(salt: str) -> str:
    """Return the sha256 of a salt's characters, in base 16: what may be published before the salt."""
    return hashlib.sha256(salt.encode()).hexdigest()


TRAINING_SALT = commitment("carecontact: persons for training")
"""Salt of every trial in which a policy may learn, so that none of its persons is the person of a seed of the exam. It
is public; the scores of its trials say that they are salted."""
TRAINING_SHA256 = commitment(TRAINING_SALT)


class TrialSpec(BaseModel):
    """Everything that determines a trial besides the policy's answers. Frozen; part of the recording's header."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    protocol: Protocol
    task_id: str
    seed: int
    policy: str
    """Text of its ``PolicyRef``: a registered name, ``module:Class`` or an address."""
    policy_arguments: dict[str, str] = {}
    """Arguments of --policy-arg: name -> text. A language backend that --language named stands in the policy's card."""
    policy_environment: tuple[str, ...] = ()
    """Names of the variables that --policy-env let pass."""
    noise_salt: str = ""
    """Drawn once per run whose protocol has sensor noise, and never shown to the policy: if protocol and seed alone
    determined the noise, a policy could find the seed by comparing a single reading with the noise of every published
    seed."""
    salt: str = Field(default="", repr=False)
    """Secret of a run whose persons no one may know beforehand: every draw of the trial depends on it. A recording
    never holds it, only its hash (``sealed``); empty for a run on published seeds."""
    salt_sha256: str = ""
    """Hash of the salt of a recorded trial, in base 16."""

    @property
    def commitment(self) -> str:
        """The sha256 of the salt in base 16, which may be published before the run; empty where there is no salt."""
        return commitment(self.salt) if self.salt else self.salt_sha256

    @property
    def sealed(self) -> Self:
        """The trial with the hash of its salt in place of the salt, as a recording names it."""
        return self.model_copy(update={"salt": "", "salt_sha256": self.commitment}) if self.salt else self

    @property
    def trains(self) -> bool:
        """Whether its person is one of those on whom policies are trained."""
        return self.commitment == TRAINING_SHA256

    @property
    def opened(self) -> Self:
        """The trial of a recording with its salt again, where that is public."""
        return self.model_copy(update={"salt": TRAINING_SALT, "salt_sha256": ""}) if self.trains else self

    @property
    def trial_id(self) -> str:
        """File stem, e.g. ``T1-s003``; unique inside a run, which has one policy."""
        return f"{self.task_id}-s{self.seed:03d}"
