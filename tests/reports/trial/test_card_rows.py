"""The page says what the policy declared, and what of its views the page cannot show."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from carecontact.contract.policy import PolicyCard
from carecontact.recording.schema import Recording
from carecontact.reports.trial.card_rows import card_rows, not_shown_text
from tests.reports.synthetic_trial import whole_trial


def with_card(card: dict[str, Any] | None, **arrays: Any) -> Recording:
    recording = whole_trial()
    header = recording.header.model_copy(update={"card": card})
    return replace(recording, header=header, arrays={**recording.arrays, **arrays})


def test_the_card_is_told_in_words() -> None:
    card = PolicyCard(
        name="mine", modalities=("rgb", "points"), cameras=("overhead", "wrist"), control_hz=20,
        language_backend="rules-v1", out_of_bounds="clip", arguments={"b": "2", "a": "1"}, environment=("KEY",),
    )  # fmt: skip
    assert card_rows(with_card(dict(card.plain())).header) == [
        ("Name", "mine"),
        ("Cameras", "overhead, wrist: rgb, points"),
        ("Control rate", "20 actions a second"),
        ("Action space", "cartesian_pose, executed by cartesian-impedance"),
        ("Workspace", "a target outside it is moved onto its border"),
        ("Language", "rules-v1"),
        ("Arguments", "a=1 b=2"),
        ("Environment variables", "KEY"),
    ]
    blind = dict(card_rows(with_card(dict(PolicyCard(name="blind").plain())).header))
    assert blind["Cameras"] == "overhead: no image, only where each stands and how it projects"
    assert "Language" not in blind
    assert card_rows(with_card(None).header) == []


def test_what_the_page_does_not_show_is_told() -> None:
    """Two looks, of which each was sent a colour image."""
    images = {f"policy/frames/000{look}/overhead/rgb": np.zeros((2, 2, 3), np.uint8) for look in (0, 1)}
    plain = {"name": "p", "cameras": ["overhead"], "modalities": ["rgb"]}
    whole = with_card(plain, **images)
    assert not_shown_text(whole, 0) == ""
    assert not_shown_text(whole, 1) == "1 stored picture of later looks is not on this page."
    bare = {path: array for path, array in whole.arrays.items() if not path.startswith("policy/frames/")}
    assert not_shown_text(replace(whole, arrays=bare), 0) == "2 further pictures of later looks were not stored."
    more = with_card({**plain, "modalities": ["rgb", "points", "masks", "landmarks"]}, **images)
    assert not_shown_text(more, 0) == (
        "The policy was also sent points, masks and landmarks at each look; a recording keeps only colour and depth "
        "images."
    )
