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
    ("text", "shown", "scheme", "path", "options"),
    [
        (
            "openpi://gpu:8000?horizon=5&profile=pi05-droid", "openpi://gpu:8000?profile=pi05-droid&horizon=5",
            "openpi", "/", {"profile": "pi05-droid", "horizon": "5"},
        ),
        (
            "roboarena://[fe80::1]:8091/v1/realtime/robot/openpi?exterior=0",
            "roboarena://[fe80::1]:8091/v1/realtime/robot/openpi?exterior=0",
            "roboarena", "/v1/realtime/robot/openpi", {"exterior": "0"},
        ),
        ("vla-eval://gpu:8000/", "vla-eval://gpu:8000", "vla-eval", "/", {}),
        ("vla-eval://gpu:8000?space=joint_position", "vla-eval://gpu:8000?space=joint_position", "vla-eval", "/",
         {"space": "joint_position"}),
    ],
)  # fmt: skip
def test_the_address_of_a_dialect_has_a_path_and_options(
    text: str, shown: str, scheme: str, path: str, options: dict[str, str]
) -> None:
    ref = PolicyRef.parse(text)
    assert (ref.kind, ref.text, ref.scheme, ref.path, dict(ref.options)) == ("remote", shown, scheme, path, options)
    assert PolicyRef.parse(shown) == ref


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("openpi://host", r"expected openpi://HOST:PORT\[/PATH\]\?profile=NAME, for example"),
        (
            "openpi://host:80?profil=x",
            r"no option named 'profil' \(did you mean 'profile'\?\); valid: profile, horizon",
        ),
        ("openpi://host:80?profile=", "profile: expected a value, got none"),
        ("openpi://host:80?profile", "expected openpi://HOST:PORT"),
        ("openpi://host:80?horizon=0", "horizon: expected 1 to 2000 actions, got '0'"),
        ("openpi://host:80?horizon=99999999999", "horizon: expected 1 to 2000 actions"),
        ("openpi://host:80?exterior=2", "exterior: expected 0 or 1"),
        ("openpi://host:80?exterior=1&exterior=0", "expected each option once"),
        ("roboarena://host:80?horizon=8", "no option named 'horizon'; valid: exterior"),
        ("vla-eval://host:80?profile=x", "no option named 'profile'; valid: space"),
        ("openpi://:secret@host:80", "a key never stands in the address; put it into CARECONTACT_API_KEY"),
        ("openpi://secret@host:80", "a key never stands in the address; put it into CARECONTACT_API_KEY"),
        ("opnpi://host:80", r"other schemes: openpi, roboarena, vla-eval \(did you mean 'openpi'\?\)"),
        ("ws://host:80?profile=x", "expected ws://HOST:PORT"),
    ],
)
def test_a_malformed_address_of_a_dialect_says_what_is_valid(text: str, says: str) -> None:
    with pytest.raises(ConfigError, match=says) as caught:
        PolicyRef.parse(text)
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize(
    "text", [":", "module:", ":Class", "a b:Class", "module:Class:x", "../up:Class", "m:os.system"]
)
def test_a_malformed_class_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="expected module:Class"):
        PolicyRef.parse(text)
