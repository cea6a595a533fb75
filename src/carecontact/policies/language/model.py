"""A language model as language backend: it reads the instruction and chooses an option, both by closed schemas."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, create_model

from carecontact.errors import LanguageError
from carecontact.policies.language.backend import ActionVerb, Intent, Manner, Option, RegionName, Side
from carecontact.policies.language.completion import Message
from carecontact.policies.language.transcript import Transcript
from carecontact.policies.language.untrusted import one_line
from carecontact.regions import REGIONS

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
        """Return the intent of an instruction.

        Raises LanguageError, with the model's words, if the model finds the instruction unclear, and also if an arm has
        no side or the abdomen has one.
        """
        messages = [Message(role="system", content=PARSE), Message(role="user", content=instruction)]
        said = self._transcript.answer(messages, Reading, purpose="parse", prompt_version=PROMPT_VERSION)
        if said.unclear.strip():
            unclear = one_line(said.unclear, limit=300)
            raise LanguageError(f"instruction {instruction!r}: {self.name} finds it unclear: {unclear}")
        if REGIONS[said.region].sided != (said.side != "none"):
            answer = f"side {said.side} for the {said.region}"
            valid = "right or left" if REGIONS[said.region].sided else "none"
            raise LanguageError(f"instruction {instruction!r}: {self.name} answers {answer}; valid: {valid}")
        return Intent(action=said.action, region=said.region, side=said.side, manner=said.manner)

    def choose(self, intent: Intent, options: Sequence[Option]) -> int:
        """Return the index of the option that the model chooses."""
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
        messages = [Message(role="system", content=CHOOSE), Message(role="user", content=asked)]
        chosen = self._transcript.answer(messages, schema, purpose="choose", prompt_version=PROMPT_VERSION)
        return int(chosen.model_dump()["number"])

    def take_calls(self) -> list[dict[str, object]]:
        """Return the calls to the language model since the last time, for the recording."""
        return self._transcript.take_calls()
