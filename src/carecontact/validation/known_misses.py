"""The limits that shipped persons are known to miss: those, and only those, that docs/validation.md names.

A known miss fails its check all the same. It is told apart from a miss that nobody has found before, so it must not
cover more than what was measured: one version of the person, one body, one tool and one tissue.
"""

from __future__ import annotations

from collections.abc import Set
from typing import Literal

from carecontact.contract.protocol import Protocol
from carecontact.protocols import load_protocol

ScrubLimit = Literal["noise", "mean force", "time at speed", "friction"]

PAGE_PROTOCOL = "bathing-v2"
"""The protocol of person-v1 with which the scrubs of the page were measured."""
NINE_BODIES = frozenset(
    f"{who}{build}" for who in ("man-adult", "man-old", "woman-adult", "woman-old") for build in ("-heavy", "-light")
) | {"man-adult"}
SCRUBS: dict[tuple[str, float], dict[ScrubLimit, Set[str]]] = {
    ("abdomen", 15.0): {
        "noise": NINE_BODIES,
        "friction": {"man-adult", "man-adult-light", "woman-adult-heavy", "woman-old-light"},
    },
    ("upper_arm", 15.0): {"mean force": {"woman-adult-heavy"}, "time at speed": {"woman-old-heavy"}},
}
"""Region and mean force [N] of a scrub -> limit -> the bodies of person-v1 that miss it with the cap."""
BREATHS: dict[tuple[str, Literal["inner", "whole"]], Set[str]] = {
    ("abdomen", "whole"): {"man-adult", "man-adult-heavy", "man-adult-light", "man-old-heavy", "man-old-light"},
    ("chest", "inner"): {"man-adult-heavy", "man-old-heavy", "woman-adult-heavy", "woman-old-heavy"},
}
"""Part of the trunk and area of it -> the bodies of person-v1 whose visible skin misses the declared size of a
breath."""


def known_of_scrub(protocol: Protocol, region: str, newton: float) -> Set[ScrubLimit]:
    """Return the limits that this person is known to miss in a scrub with this mean force [N]."""
    if not _scrubbed_as_on_the_page(protocol):
        return frozenset()
    of_scrub = SCRUBS.get((region, newton), {})
    return {limit for limit, bodies in of_scrub.items() if protocol.person.body in bodies}


def known_of_breath(protocol: Protocol, part: str, area: Literal["inner", "whole"]) -> bool:
    """Return whether this person's visible skin is known to miss the declared size of a breath there.

    Neither tissue nor tool has a part in it.
    """
    person = protocol.person
    return person.version == "person-v1" and person.body in BREATHS.get((part, area), ())


def _scrubbed_as_on_the_page(protocol: Protocol) -> bool:
    """Whether nothing but the body differs from the page's protocol of what a scrub depends on."""
    page = load_protocol(PAGE_PROTOCOL)
    person = protocol.person.model_copy(update={"body": page.person.body})
    return (
        person == page.person
        and protocol.scene.tool == page.scene.tool
        and protocol.physics == page.physics
        and protocol.impedance == page.impedance
    )
