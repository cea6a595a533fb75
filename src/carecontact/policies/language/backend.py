"""What a language backend answers, and the protocol that every one of them follows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Protocol

from pydantic import AfterValidator, BaseModel, ConfigDict, GetJsonSchemaHandler
from pydantic_core import CoreSchema

from carecontact.regions import REGIONS, all_regions

ActionVerb = Literal["touch", "push", "scrub"]
Side = Literal["right", "left", "none"]
Manner = Literal["gentle", "firm", "none"]
Approach = Literal["above", "near_side", "far_side"]


def spoken_regions() -> tuple[str, ...]:
    """The regions that an instruction can name: those whose row can be loaded and has words for it."""
    rows = REGIONS.usable()
    return tuple(name for name in all_regions() if name in rows and rows[name].words)


def _spoken(name: str) -> str:
    if name not in spoken_regions():
        raise ValueError(f"no region {name!r} that an instruction can name; valid: {', '.join(spoken_regions())}")
    return name


class _AsEnum:
    """Shows a language model the names to choose from."""

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"enum": list(spoken_regions()), "type": "string"}


RegionName = Annotated[str, AfterValidator(_spoken), _AsEnum()]


class Intent(BaseModel):
    """Everything that an instruction may mean."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    action: ActionVerb
    region: RegionName
    side: Side
    """Side of the body, as the person calls it; ``none`` for the abdomen."""
    manner: Manner


@dataclass(frozen=True, kw_only=True)
class Option:
    """One thing that a policy can do, in words and numbers a language model can weigh."""

    primitive: ActionVerb
    approach: Approach
    """``near_side`` faces the robot."""
    key_point: float
    """Place along the region: 0 proximal (abdomen: caudal), 1 distal (abdomen: cranial)."""
    depth_m: float
    """Commanded beyond the surface that is seen."""
    speed_m_s: float
    """Speed of the tool while it touches or is about to."""


class LanguageBackend(Protocol):
    """Deterministic for rules and replays. Both methods raise LanguageError when the backend fails."""

    name: str
    """``rules-v1``, ``replay:<hash>:<model>`` or ``live:<model>``; travels with every result."""

    def parse(self, instruction: str) -> Intent:
        """Return the intent of an instruction. Raises LanguageError where it is unclear; it never guesses."""
        ...

    def choose(self, intent: Intent, options: Sequence[Option]) -> int:
        """Index of the option to execute. Raises ContractError where none can be."""
        ...

    def take_calls(self) -> list[dict[str, object]]:
        """What a language model was asked since the last time: purpose, backend, model, sha256 of request and
        completion; empty for rules."""
        ...
