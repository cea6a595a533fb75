"""What a language backend chooses, and two that do: fixed rules, and a language model that is asked for the choice."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal, Protocol

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, GetJsonSchemaHandler, create_model
from pydantic_core import CoreSchema

from carecontact.errors import ContractError, LanguageError
from carecontact.interface.regions import REGIONS, all_regions
from carecontact.policies.language.completion import Answer, Message, Transcript, one_line

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
    """Lists the valid names in the schema for a language model."""

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"enum": list(spoken_regions()), "type": "string"}


RegionName = Annotated[str, AfterValidator(_spoken), _AsEnum()]


class Intent(BaseModel):
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
        """Return the requests to a language model since the last call: purpose, backend, model, sha256 of request and
        completion; empty for rules."""
        ...


ACTIONS: Mapping[str, tuple[str, ...]] = {
    "touch": ("touch", "contact", "feel", "rest your hand on", "place your hand on", "lay your hand on"),
    "push": ("push", "shove", "nudge", "displace", "move aside", "push aside"),
    "scrub": ("scrub", "wash", "wipe", "rub", "clean", "bathe", "cleanse"),
}
SIDES: Mapping[str, tuple[str, ...]] = {"right": ("right", "right-hand"), "left": ("left", "left-hand")}
MANNERS: Mapping[str, tuple[str, ...]] = {
    "gentle": ("gently", "gentle", "softly", "soft", "lightly", "light", "carefully", "careful", "tenderly"),
    "firm": ("firmly", "firm", "strongly", "strong", "hard", "vigorously", "forcefully"),
}
NEGATIONS = ("not", "don't", "dont", "never", "avoid", "without", "no", "stop", "except")


class Rules:
    """Language backend ``rules-v1``: a small closed vocabulary; it refuses what it does not understand.

    ``parse``: exactly one action and one region must be named, a limb needs its side, at most one manner, no negation.
    ``choose``: options of the intended primitive; then the near or upper approach; then, for a push, the longest lever
    (most distal key point), otherwise the key point nearest the region's middle; then, for depth and speed each, the
    least for ``gentle``, the most for ``firm``, the middle value otherwise; then the lowest index.
    """

    name = "rules-v1"

    def parse(self, instruction: str) -> Intent:
        """Raises LanguageError that says what is missing or ambiguous and which words are known."""
        text = _plain(instruction)
        action = _one(instruction, text, "action", ACTIONS)
        region, side = self.parse_place(instruction)
        manner = _at_most_one(instruction, text, "manner", MANNERS)
        return Intent.model_validate({"action": action, "region": region, "side": side, "manner": manner})

    def parse_place(self, instruction: str) -> tuple[str, str]:
        """Region and side, whatever the action is. Raises LanguageError as ``parse``."""
        text = _plain(instruction)
        region = _one(instruction, text, "region", {name: REGIONS[name].words for name in spoken_regions()})
        side = _at_most_one(instruction, text, "side", SIDES)
        if REGIONS[region].sided and side == "none":
            name = region.replace("_", " ")
            raise LanguageError(f"instruction {instruction!r}: which {name}? valid: right or left")
        if not REGIONS[region].sided and side != "none":
            raise LanguageError(f"instruction {instruction!r}: the {region} has no {side} side that rules-v1 knows")
        return region, side

    def choose(self, intent: Intent, options: Sequence[Option]) -> int:
        """Raises ContractError if no option has the intended primitive."""
        fitting = {index: option for index, option in enumerate(options) if option.primitive == intent.action}
        if not fitting:
            raise ContractError(f"none of {len(options)} options is a {intent.action}")
        depth = _preferred({option.depth_m for option in fitting.values()}, intent.manner)
        speed = _preferred({option.speed_m_s for option in fitting.values()}, intent.manner)

        def cost(index: int) -> tuple[float, ...]:
            option = fitting[index]
            place = -option.key_point if intent.action == "push" else abs(option.key_point - 0.5)
            return (
                option.approach == "far_side",
                place,
                abs(option.depth_m - depth),
                abs(option.speed_m_s - speed),
                index,
            )

        return min(fitting, key=cost)

    def take_calls(self) -> list[dict[str, object]]:
        return []


def _plain(instruction: str) -> str:
    """Return the text in small letters and with single spaces. Raises LanguageError for a negation."""
    text = re.sub(r"\s+", " ", instruction.lower().replace("\u2019", "'")).strip()
    negated = [word for word in NEGATIONS if _contains(text, word)]
    if negated:
        raise LanguageError(f"instruction {instruction!r}: rules-v1 refuses negation ({', '.join(negated)})")
    return text


def _contains(text: str, phrase: str) -> bool:
    return re.search(rf"(?<![\w'-]){re.escape(phrase)}(?![\w'-])", text) is not None


def _at_most_one(instruction: str, text: str, what: str, table: Mapping[str, tuple[str, ...]]) -> str:
    found = [name for name, phrases in table.items() if any(_contains(text, phrase) for phrase in phrases)]
    if len(found) > 1:
        raise LanguageError(f"instruction {instruction!r}: more than one {what} ({', '.join(found)})")
    return found[0] if found else "none"


def _one(instruction: str, text: str, what: str, table: Mapping[str, tuple[str, ...]]) -> str:
    found = _at_most_one(instruction, text, what, table)
    if found == "none":
        known = "; ".join(f"{name}: {', '.join(phrases)}" for name, phrases in table.items())
        raise LanguageError(f"instruction {instruction!r}: no {what} that rules-v1 knows ({known})")
    return found


def _preferred(values: set[float], manner: str) -> float:
    ordered = sorted(values)
    return {"gentle": ordered[0], "firm": ordered[-1], "none": ordered[(len(ordered) - 1) // 2]}[manner]


PROMPT_VERSION = "state-machine-v1"

PARSE = """\
A robot arm bathes a person who lies on a bed. Put what it is told into the schema.
action: touch (rest on the skin), push (move the limb aside) or scrub (slide back and forth while in contact).
region: the part of the body. side: the person's own right or left, none for the abdomen.
manner: gentle or firm if the words say so, otherwise none.
unclear: empty if the instruction says exactly one action on exactly one region, with its side where it is an arm;
otherwise what is missing or contradictory in a few words. Never guess."""
CHOOSE = """\
A robot arm bathes a person who lies on a bed. It has listed all motions that it can carry out. Select one of them for
the instruction. The motion runs without further looks and nothing measures force: key_point is the place along the
region (0 nearest the trunk or the feet, 1 farthest), depth_m how far the tool is sent beyond the surface that is seen
(400 N are added for each metre that the tissue does not give way), speed_m_s how fast it moves while it touches.
Answer with the number of the motion and one short sentence of reason."""


class Reading(BaseModel):
    """The schema in which a model says what an instruction means."""

    model_config = ConfigDict(extra="forbid")

    action: ActionVerb
    region: RegionName
    side: Side
    manner: Manner
    unclear: str


class LanguageModel:
    """Language backend over any source of completions. Its methods raise LanguageError if the source fails."""

    def __init__(self, transcript: Transcript) -> None:
        self.name = transcript.name
        self._transcript = transcript

    def parse(self, instruction: str) -> Intent:
        reading = self._answer(PARSE, instruction, Reading, purpose="parse")
        if reading.unclear.strip():
            unclear = one_line(reading.unclear, limit=300)
            raise LanguageError(f"instruction {instruction!r}: {self.name} finds it unclear: {unclear}")
        sided = REGIONS[reading.region].sided
        if sided != (reading.side != "none"):
            answer, valid = f"side {reading.side} for the {reading.region}", "right or left" if sided else "none"
            raise LanguageError(f"instruction {instruction!r}: {self.name} answers {answer}; valid: {valid}")
        return Intent(**reading.model_dump(exclude={"unclear"}))

    def choose(self, intent: Intent, options: Sequence[Option]) -> int:
        rows = [{"number": k, **asdict(option)} for k, option in enumerate(options)]
        listed = "\n".join(json.dumps(row) for row in rows)
        asked = f"Instruction: {intent.model_dump_json()}\nMotions:\n{listed}"

        def whole(number: object) -> object:
            # A Literal would accept true for 1, and its own message would list every number.
            if type(number) is not int or not 0 <= number < len(options):
                raise ValueError(f"expected a whole number from 0 to {len(options) - 1}, got {number!r:.40}")
            return number

        numbers: Any = Annotated[Literal[tuple(range(len(options)))], BeforeValidator(whole)]  # pyright: ignore[reportInvalidTypeForm]
        schema = create_model("Choice", __config__=ConfigDict(extra="forbid"), number=(numbers, ...), reason=(str, ...))
        return int(self._answer(CHOOSE, asked, schema, purpose="choose").model_dump()["number"])

    def _answer(self, role: str, query: str, schema: type[Answer], *, purpose: str) -> Answer:
        messages = [Message(role="system", content=role), Message(role="user", content=query)]
        return self._transcript.answer(messages, schema, purpose=purpose, prompt_version=PROMPT_VERSION)

    def take_calls(self) -> list[dict[str, object]]:
        return self._transcript.take_calls()
