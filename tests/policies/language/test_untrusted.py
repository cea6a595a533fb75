from __future__ import annotations

import base64
import html
import json
from collections.abc import Callable
from urllib.parse import quote

import pytest

from carecontact.policies.language.untrusted import REMOVED, Cleaner, one_line

KEY = "k/ey+\"with'<odd>&parts"


@pytest.mark.parametrize(
    "spelled",
    [
        str,
        str.upper,
        json.dumps,
        repr,
        html.escape,
        quote,
        lambda s: quote(s, safe=""),
        lambda s: s.replace("/", "\\/"),
    ],
)
def test_every_spelling_is_found(spelled: Callable[[str], str]) -> None:
    said = f"before {spelled(KEY)} after"
    cleaned = Cleaner([KEY]).text(said)
    assert REMOVED in cleaned
    assert cleaned.startswith("before ")
    assert cleaned.endswith(" after")
    assert len(cleaned) <= len(f"before '{REMOVED}' after")


@pytest.mark.parametrize("before", ["", "x", "xy", "xyz", "Bearer ", "user:"])
@pytest.mark.parametrize("encode", [base64.b64encode, base64.urlsafe_b64encode])
def test_in_base64_at_any_offset(before: str, encode: Callable[[bytes], bytes]) -> None:
    key = "sk-0123456789??>>secret"
    cleaned = Cleaner([key]).text(encode((before + key + " and more").encode()).decode())
    assert REMOVED in cleaned
    left = base64.b64decode(cleaned.partition(REMOVED)[0] + "==", altchars=b"-_").decode(errors="replace")
    assert key[:2] not in left


def test_a_placeholder_is_no_secret() -> None:
    assert Cleaner(["none", "", "test"]).text('{"side": "none"}') == '{"side": "none"}'
    assert Cleaner().text("x") == "x"


def test_of_two_secrets_the_longer_first() -> None:
    assert Cleaner(["secret", "secret-and-more"]).text("secret-and-more") == REMOVED


def test_what_is_cut_holds_no_part_of_a_secret() -> None:
    assert "secret" not in Cleaner(["secretsecretsecret"]).line("x" * 20 + "secretsecretsecret", limit=32)


@pytest.mark.parametrize(
    ("said", "line"),
    [("a\n\n  b\t", "a b"), ("\x1b[31m", r"\x1b[31m"), ("x" * 20, "x" * 20), ("x" * 21, "x" * 14 + " [...]"),
     ("\x00" * 6, r"\x00\x00\x00\x" + " [...]"), ("", "")],
)  # fmt: skip
def test_one_line(said: str, line: str) -> None:
    assert one_line(said, limit=20) == line
