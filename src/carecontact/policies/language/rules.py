"""``rules-v1``: a small closed vocabulary. What it does not understand it refuses; it never guesses."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from carecontact.errors import ContractError, LanguageError
from carecontact.policies.language.backend import Intent, Option, spoken_regions
from carecontact.regions import REGIONS

ACTIONS: Mapping[str, tuple[str, ...]] = {
    "touch": (
        "touch",
        "contact",
        "feel",
        "rest your hand on",
        "place your hand on",
        "lay your hand on",
    ),
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
    """Language backend ``rules-v1``.

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
            raise LanguageError(f"instruction {instruction!r}: which {region.replace('_', ' ')}? say right or left")
        if not REGIONS[region].sided and side != "none":
            raise LanguageError(f"instruction {instruction!r}: the {region} has no {side} side that rules-v1 knows")
        return region, side

    def choose(self, intent: Intent, options: Sequence[Option]) -> int:
        """Raises ContractError if no option has the intended primitive."""
        fitting = [option for option in options if option.primitive == intent.action]
        if not fitting:
            raise ContractError(f"none of {len(options)} options is a {intent.action}")
        depth = _preferred({option.depth_m for option in fitting}, intent.manner)
        speed = _preferred({option.speed_m_s for option in fitting}, intent.manner)

        def cost(index: int) -> tuple[float, ...]:
            option = options[index]
            return (
                option.primitive != intent.action,
                option.approach == "far_side",
                -option.key_point if intent.action == "push" else abs(option.key_point - 0.5),
                abs(option.depth_m - depth),
                abs(option.speed_m_s - speed),
                index,
            )

        return min(range(len(options)), key=cost)

    def take_calls(self) -> list[dict[str, object]]:
        """None: nobody was asked."""
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


def _named(text: str, table: Mapping[str, tuple[str, ...]]) -> list[str]:
    return [name for name, phrases in table.items() if any(_contains(text, phrase) for phrase in phrases)]


def _at_most_one(instruction: str, text: str, what: str, table: Mapping[str, tuple[str, ...]]) -> str:
    found = _named(text, table)
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
