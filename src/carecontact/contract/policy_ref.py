"""A reference to a policy, as the user writes it: a registered name, ``module:Class`` or the address of a server."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, Self, get_args
from urllib.parse import parse_qsl, unquote, urlencode, urlsplit

from carecontact.contract.action import MAX_CHUNK
from carecontact.errors import ConfigError, did_you_mean

IMPORTABLE, REMOTE = "module:Class", "ws://HOST:PORT"
"""How an imported policy and one on the native wire are written."""
Scheme = Literal["ws", "openpi", "roboarena", "vla-eval"]
SCHEMES: tuple[str, ...] = get_args(Scheme)
"""``ws`` is the native wire; the others are dialects (docs/dialects.md)."""
OPTIONS: dict[str, tuple[str, ...]] = {
    "ws": (),
    "openpi": ("profile", "horizon", "exterior"),
    "roboarena": ("exterior",),
    "vla-eval": ("space",),
}
"""Scheme -> what may stand behind the question mark."""
API_KEY = "CARECONTACT_API_KEY"
"""Variable that holds the key of a dialect's server, if it wants one."""
EXPECTED = {
    "ws": f"{REMOTE}, for example ws://192.0.2.7:8765",
    "openpi": "openpi://HOST:PORT[/PATH]?profile=NAME, for example openpi://192.0.2.7:8000?profile=pi05-droid",
    "roboarena": "roboarena://HOST:PORT[/PATH], for example roboarena://192.0.2.7:8000",
    "vla-eval": "vla-eval://HOST:PORT[?space=NAME], for example vla-eval://192.0.2.7:8000?space=joint_position",
}


@dataclass(frozen=True, kw_only=True)
class PolicyRef:
    """A reference to a policy. Parse a text once with ``parse`` and pass the reference on."""

    kind: Literal["registered", "importable", "remote"]
    text: str
    """What recordings, manifests and messages show: it never holds credentials."""
    scheme: Scheme = "ws"
    """What the server of a remote policy speaks."""
    host: str = ""
    """Host of a remote policy; ``port`` belongs to it."""
    port: int = 0
    path: str = "/"
    """Path that the server of a remote policy is asked for."""
    options: tuple[tuple[str, str], ...] = ()
    """Names and values behind the question mark in a remote policy's address. They are sent to no server."""
    credentials: str = field(default="", repr=False)
    """``USER:PASSWORD`` for ``ws``, the key for a dialect, or empty."""

    def __str__(self) -> str:
        return self.text

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read ``state-machine``, ``module:Class`` (a function that returns a policy will do),
        ``ws://[USER:PASSWORD@]HOST:PORT``, or the address of a dialect as EXPECTED has it. Whether a registered name
        or a profile exists is checked when it is looked up.

        Raises ConfigError for a malformed ``module:Class`` or address; the message shows no password.
        """
        if "://" in text:
            return cls._address(text)
        if ":" not in text:
            return cls(kind="registered", text=text)
        module, _, attribute = text.partition(":")
        if not attribute.isidentifier() or not all(part.isidentifier() for part in module.split(".")):
            address = f"; for a policy's server, ws://{text}" if attribute.isdigit() else ""
            raise ConfigError(f"policy {text!r}: expected {IMPORTABLE}, for example my_policy:MyPolicy{address}")
        return cls(kind="importable", text=text)

    @classmethod
    def _address(cls, text: str) -> Self:
        given = text.partition("://")[0]
        shown = f"{given}://{text.rpartition('@')[2].removeprefix(f'{given}://')}"
        scheme = next((name for name in get_args(Scheme) if name == given), None)
        if scheme is None:
            tunnel = "; for an encrypted connection, use a tunnel such as ssh -L" if given == "wss" else ""
            others = f"; other schemes: {', '.join(SCHEMES[1:])}{did_you_mean(given, SCHEMES)}"
            raise ConfigError(f"policy {shown!r}: expected {EXPECTED['ws']}{others if given != 'wss' else tunnel}")
        expected = f"expected {EXPECTED[scheme]}"
        try:
            parts = urlsplit(text)
            host, port = parts.hostname, parts.port
            pairs = parse_qsl(parts.query, keep_blank_values=True, strict_parsing=bool(parts.query))
        except ValueError as error:
            raise ConfigError(f"policy {shown!r}: {expected}: {error}") from None
        native = scheme == "ws" and (parts.path not in ("", "/") or parts.query)
        if not host or not port or parts.fragment or native:
            raise ConfigError(f"policy {shown!r}: {expected}")
        credentials = ""
        if parts.username is not None:
            if scheme != "ws":
                raise ConfigError(f"policy {shown!r}: a key never stands in the address; put it into {API_KEY}")
            if not parts.username or parts.password is None:
                raise ConfigError(f"policy {shown!r}: expected USER:PASSWORD before the @")
            credentials = f"{unquote(parts.username)}:{unquote(parts.password)}"
        options = _options(shown, scheme, pairs)
        path = parts.path or "/"
        place = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        query = f"?{urlencode(options)}" if options else ""
        return cls(
            kind="remote", text=f"{scheme}://{place}{'' if path == '/' else path}{query}", scheme=scheme, host=host,
            port=port, path=path, options=options, credentials=credentials,
        )  # fmt: skip


def _options(shown: str, scheme: str, pairs: list[tuple[str, str]]) -> tuple[tuple[str, str], ...]:
    """Return the options in the order of OPTIONS, so that one request has one text."""
    valid = OPTIONS[scheme]
    for name, value in pairs:
        if name not in valid:
            known = ", ".join(valid)
            raise ConfigError(f"policy {shown!r}: no option named {name!r}{did_you_mean(name, valid)}; valid: {known}")
        if name == "exterior" and value not in ("0", "1"):
            raise ConfigError(
                f"policy {shown!r}: exterior: expected 0 or 1, the number of the first camera, got {value!r}"
            )
        if name == "horizon" and not (value.isascii() and value.isdigit() and 1 <= int(value[:9]) <= MAX_CHUNK):
            raise ConfigError(f"policy {shown!r}: horizon: expected 1 to {MAX_CHUNK} actions, got {value!r}")
        if not value:
            raise ConfigError(f"policy {shown!r}: {name}: expected a value, got none")
    chosen = dict(pairs)
    if len(chosen) != len(pairs):
        raise ConfigError(f"policy {shown!r}: expected each option once")
    return tuple((name, chosen[name]) for name in valid if name in chosen)
