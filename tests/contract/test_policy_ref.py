from __future__ import annotations

import pytest

from carecontact.contract.policy_ref import PolicyRef
from carecontact.errors import ConfigError


@pytest.mark.parametrize(
    ("text", "kind"),
    [("hover", "registered"), ("my_policy:Mine", "importable"), ("my.package:make", "importable")],
)
def test_names_and_classes_keep_their_text(text: str, kind: str) -> None:
    ref = PolicyRef.parse(text)
    assert (ref.kind, ref.text, str(ref)) == (kind, text, text)


@pytest.mark.parametrize(
    ("text", "shown", "place", "credentials"),
    [
        ("ws://gpu-3.example.org:8765/", "ws://gpu-3.example.org:8765", ("gpu-3.example.org", 8765), ""),
        ("ws://u:p%2Fw@[fe80::1]:80", "ws://[fe80::1]:80", ("fe80::1", 80), "u:p/w"),
    ],
)
def test_an_address_shows_no_credentials(text: str, shown: str, place: tuple[str, int], credentials: str) -> None:
    ref = PolicyRef.parse(text)
    assert (ref.kind, ref.text, (ref.host, ref.port), ref.credentials) == ("remote", shown, place, credentials)
    assert "p/w" not in repr(ref)
    assert PolicyRef.parse(ref.text).text == ref.text


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("ws://host", "expected ws://HOST:PORT"),
        ("ws://:80", "expected ws://HOST:PORT"),
        ("ws://host:0", "expected ws://HOST:PORT"),
        ("ws://host:99999", "Port out of range"),
        ("ws://user:secret@host:80/path", "policy 'ws://host:80/path': expected"),
        ("wss://user:secret@host:80", "policy 'wss://host:80': expected ws://HOST:PORT.*; for an encrypted connection"),
        ("http://host:80", "expected ws://HOST:PORT"),
        ("ws://secret@host:80", "expected USER:PASSWORD before the @"),
    ],
)
def test_a_malformed_address_is_refused_without_its_password(text: str, says: str) -> None:
    with pytest.raises(ConfigError, match=says) as caught:
        PolicyRef.parse(text)
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize(
    "text", [":", "module:", ":Class", "a b:Class", "module:Class:x", "../up:Class", "m:os.system"]
)
def test_a_malformed_class_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="expected module:Class"):
        PolicyRef.parse(text)
