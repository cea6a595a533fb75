"""What counts as known is what docs/validation.md names, and nothing beside it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from carecontact.contract.protocol import Protocol
from carecontact.protocols import load_protocol, overridden
from carecontact.protocols.friction import friction_changes
from carecontact.validation.known_misses import BREATHS, NINE_BODIES, SCRUBS, known_of_breath, known_of_scrub
from carecontact.world.human.library import body_names

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "validation.md").read_text()
BELLY, ARM = ("abdomen", 15.0), ("upper_arm", 15.0)


def page_protocol(**changes: Any) -> Protocol:
    return overridden(load_protocol("bathing-v2"), {key.replace("__", "."): value for key, value in changes.items()})


def test_they_are_of_shipped_bodies() -> None:
    assert set(body_names()) == NINE_BODIES
    named = [bodies for of_scrub in SCRUBS.values() for bodies in of_scrub.values()] + list(BREATHS.values())
    assert all(bodies <= NINE_BODIES for bodies in named)


def test_a_scrub_of_person_v1_misses_what_the_page_says_of_this_body() -> None:
    assert known_of_scrub(page_protocol(), *BELLY) == {"noise", "friction"}
    assert known_of_scrub(page_protocol(person__body="man-old-light"), *BELLY) == {"noise"}
    assert known_of_scrub(page_protocol(person__body="woman-old-heavy"), *ARM) == {"time at speed"}
    assert known_of_scrub(page_protocol(), *ARM) == set()
    assert known_of_scrub(page_protocol(), "abdomen", 5.0) == set()


@pytest.mark.parametrize(
    "other",
    [
        load_protocol("bathing-v3-draft"),
        load_protocol("bathing-wide-v1", level="L0"),
        load_protocol("bathing-wide-v2-draft", level="L0"),
        page_protocol(scene__tool="mitt"),
        overridden(page_protocol(), friction_changes(page_protocol(), "soapy")),
        page_protocol(physics__dt_s=0.004),
        page_protocol(person__body="smplx:FILE.npz?sex=F"),
    ],
)
def test_no_miss_is_known_of_another_person_tool_tissue_friction_or_step(other: Protocol) -> None:
    assert all(known_of_scrub(other, *scrub) == set() for scrub in SCRUBS)


def test_the_breaths_of_the_page_are_the_known_ones() -> None:
    """The page prints what is beyond the limit in bold."""
    rows = re.findall(r"\| ([a-z-]+) \| 0\.02 mm \| (\**)[\d.]+ mm\** \| (\**)[\d.]+ mm\** \|", PAGE)
    assert {body for body, _, _ in rows} == NINE_BODIES
    for body, belly, chest in rows:
        person = page_protocol(person__body=body)
        assert known_of_breath(person, "abdomen", "whole") is bool(belly), body
        assert known_of_breath(person, "chest", "inner") is bool(chest), body
        assert not known_of_breath(person, "abdomen", "inner"), body
    newest = overridden(load_protocol("bathing-v3-draft"), {"person.body": "man-old-heavy"})
    assert not known_of_breath(newest, "chest", "inner")
