from __future__ import annotations

import pytest

from carecontact.policies.language.completion import CompletionRequest
from carecontact.policies.language.sampling import Sampling

REQUEST = CompletionRequest(model="m", messages=(), max_tokens=5, temperature=0.5, prompt_version="p")
USUAL, NEWER = Sampling(), Sampling(limit="max_completion_tokens")


def test_what_is_sent() -> None:
    assert USUAL.parameters(REQUEST) == {"temperature": 0.5, "max_tokens": 5}
    assert Sampling(temperature=False, limit="max_completion_tokens").parameters(REQUEST) == {
        "max_completion_tokens": 5
    }


@pytest.mark.parametrize(
    ("parameter", "message", "expected"),
    [
        ("max_tokens", "Use 'max_completion_tokens' instead.", NEWER),
        (None, "'max_tokens' is not supported. Use 'max_completion_tokens' instead.", NEWER),
        ("temperature", "Only the default (1) value is supported.", Sampling(temperature=False)),
        (None, "temperature and max_tokens", Sampling(temperature=False, limit="max_completion_tokens")),
        ("model", "the model takes no temperature", USUAL),
        (None, "max_completion_tokens is too large", USUAL),
        (None, "no", USUAL),
    ],
)
def test_what_an_error_changes(parameter: str | None, message: str, expected: Sampling) -> None:
    assert USUAL.adapted(parameter, message) == expected
    assert expected.adapted(parameter, message) == expected
