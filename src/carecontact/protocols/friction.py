"""Named states of the skin, each with its coefficient of friction against the tool and the source of that value."""

from __future__ import annotations

from dataclasses import dataclass

from carecontact.contract.protocol import Protocol
from carecontact.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class SkinState:
    coefficient: float
    source: str


SKIN_STATES = {
    "dry": SkinState(
        coefficient=0.5,
        source="typical of dry skin, which is above 0.2: the review of Derler and Gerhardt 2012 (Tribology Letters "
        "45:1; only its abstract was read)",
    ),
    "wet": SkinState(
        coefficient=1.0,
        source="the least of what the same review calls typical of moist or wet skin: above 1, falling with pressure",
    ),
    "soapy": SkinState(
        coefficient=0.2,
        source="assumed, the lower end of dry skin: soapy palms slid more easily on grab rails than dry and wet ones "
        "(Ergonomics 2001, 44:973; only its abstract was read, which gives no coefficient)",
    ),
}


def friction_changes(rules: Protocol, friction: str) -> dict[str, object]:
    """Return fields of ``rules`` that give all of its soft regions one coefficient, as ``overridden`` takes them.

    Args:
        friction: a name of SKIN_STATES, or a number. The fields' own bounds apply to it.

    Raises ConfigError for anything else.
    """
    if friction in SKIN_STATES:
        value = SKIN_STATES[friction].coefficient
    else:
        try:
            value = float(friction)
        except ValueError:
            raise ConfigError(
                f"--friction {friction!r}: expected {', '.join(SKIN_STATES)} or a coefficient, such as 0.8"
            ) from None
    return {f"person.tissue.{region}.friction": value for region in rules.soft_regions}
