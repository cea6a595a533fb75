"""The name on the card of a policy that is reached by its address."""

from __future__ import annotations

import pytest

from carecontact.scoring import score_recording
from tests.scoring.synthetic import touch


@pytest.mark.parametrize(
    ("policy", "name", "title"),
    [
        ("ws://192.0.2.7:8765", "my-vla 3", "my-vla 3 at ws://192.0.2.7:8765"),
        ("mine:Mine", None, "mine:Mine"),
    ],
)
def test_an_address_is_shown_with_the_name_of_what_answers_there(policy: str, name: str | None, title: str) -> None:
    made = touch()
    spec = made.header.spec.model_copy(update={"policy": policy})
    card = {**(made.header.card or {}), "name": "my-vla 3"}
    object.__setattr__(made, "header", made.header.model_copy(update={"spec": spec, "card": card}))
    score = score_recording(made)
    assert (score.policy_name, score.policy_title) == (name, title)
