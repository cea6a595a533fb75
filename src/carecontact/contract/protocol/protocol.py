"""A protocol: everything that a benchmark fixes, with a hash over all of it."""

from __future__ import annotations

import hashlib
import json
from typing import Literal, Self

from pydantic import Field, model_validator

from carecontact.contract.protocol import consistency
from carecontact.contract.protocol.contact import ContactDefinition
from carecontact.contract.protocol.gates import Gates
from carecontact.contract.protocol.impedance import Impedance
from carecontact.contract.protocol.level import Level
from carecontact.contract.protocol.limits import ForceLimits, sideless
from carecontact.contract.protocol.person import Person
from carecontact.contract.protocol.physics import Phases, Physics
from carecontact.contract.protocol.scene import Camera, Scene
from carecontact.contract.protocol.section import FileStem, Section
from carecontact.contract.protocol.task import Task, regions_of
from carecontact.contract.protocol.title import protocol_title
from carecontact.contract.protocol.variation import Randomization, Variation
from carecontact.contract.protocol.vision import Vision


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
    def _consistent(self) -> Self:
        consistency.check_person(self.person, self.tasks)
        consistency.check_tasks(self.tasks, self.gates, self.contact)
        consistency.check_cameras(self.cameras)
        consistency.check_vision(self.vision)
        consistency.check_seeds(self.randomization)
        consistency.check_limits(self.limits)
        consistency.check_ranges(
            randomization=self.randomization, impedance=self.impedance, scene=self.scene, phases=self.phases,
            contact=self.contact,
        )  # fmt: skip
        consistency.check_period(self.physics)
        return self

    @property
    def drawn_as(self) -> str:
        """Name from which seeds draw (``Randomization.drawn_as``)."""
        return self.randomization.drawn_as or self.id

    @property
    def sha256(self) -> str:
        """Hash of the canonical JSON, so that spelling and comments in the TOML do not count."""
        content = self.model_dump(mode="json", exclude=None if self.overrides else {"overrides"})
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
