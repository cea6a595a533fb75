"""What a policy is: its card, the methods that it has, and how a command line names it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Literal, NoReturn, Protocol, Self, cast, get_args, runtime_checkable
from urllib.parse import parse_qsl, unquote, urlencode, urlsplit

from carecontact.errors import ConfigError, ContractError, did_you_mean
from carecontact.interface.action import ACTION_SPACES, MAX_CHUNK, Action
from carecontact.interface.deltas import DEFAULT_DELTAS, DELTA_SPACE, DELTAS
from carecontact.interface.observation import MODALITIES, Observation
from carecontact.interface.robot import CARTESIAN_IMPEDANCE, CONTROLS

CAMERAS = ("overhead", "bedside", "exterior", "wrist")
OUT_OF_BOUNDS = ("error", "clip")
MAX_NAME = 200
"""Characters of a card's name and language backend: they stand in headers, tables and file names."""
MAX_CAMERA_HZ = 50.0
"""The highest control rate: no policy can receive observations more often."""
MAX_ARGUMENTS, MAX_ARGUMENT = 64, 2000
"""Number of arguments or variables of a policy, and characters of one value: they stand in every recording."""

IMPORTABLE, REMOTE = "module:Class", "ws://HOST:PORT"
"""How an imported policy and one on the native wire are written."""
Scheme = Literal["ws", "openpi", "roboarena", "vla-eval"]
SCHEMES: tuple[str, ...] = get_args(Scheme)
"""``ws`` is the native wire; the others are dialects (docs/vla.md)."""
OPTIONS: dict[str, tuple[str, ...]] = {
    "ws": (),
    "openpi": ("profile", "horizon", "exterior", "orientation"),
    "roboarena": ("exterior",),
    "vla-eval": ("space", "profile", "orientation"),
}
"""Scheme -> what may stand behind the question mark."""
TRAINED = re.compile(r"[0-9a-f]{64}|[A-Za-z0-9._-]{1,80}:[0-9]{1,9}(-[0-9]{1,9})?(,[0-9]{1,9}(-[0-9]{1,9})?){0,99}")
"""An entry of a card's ``trained_on``."""
LOOK_CONTROLS = ("shuffled-look", "frozen-look", "no-touch")
"""Controls of what a policy observes (``episode.looks``)."""
VARIANT = re.compile(r"\+(shuffled-look|frozen-look|no-touch|dagger|noise-[1-9][0-9]?mm)$")
"""What may follow a policy's name in results: a control, or how demonstrations were made with it (``oracle.teaching``).
The same policy with another variant is another policy."""
API_KEY = "CARECONTACT_API_KEY"
"""Variable that holds the key of a dialect's server, if it wants one."""
EXPECTED = {
    "ws": f"{REMOTE}, for example ws://192.0.2.7:8765",
    "openpi": "openpi://HOST:PORT[/PATH]?profile=NAME, for example openpi://192.0.2.7:8000?profile=pi05-droid",
    "roboarena": "roboarena://HOST:PORT[/PATH], for example roboarena://192.0.2.7:8000",
    "vla-eval": "vla-eval://HOST:PORT[?space=NAME], for example vla-eval://192.0.2.7:8000?space=joint_position",
}


@dataclass(frozen=True, kw_only=True)
class PolicyCard:
    """What a policy requests. Only what it names is rendered."""

    name: str
    action_space: str = "cartesian_pose"
    """Name from ACTION_SPACES."""
    delta: str = ""
    """Name from DELTAS, only for ``cartesian_delta``: what the numbers of a delta mean. Without a name there, ``osc``.
    """
    control: str = CARTESIAN_IMPEDANCE
    """Name from CONTROLS: the controller that executes the actions. Joint spaces need one of the joint controllers."""
    modalities: tuple[str, ...] = ()
    """Names from MODALITIES. Every view of a camera holds each of them; without any, it holds what is known of the
    camera by calibration: where it stands and how it projects."""
    cameras: tuple[str, ...] = ("overhead",)
    camera_hz: Mapping[str, float] = field(default_factory=dict[str, float], hash=False)
    """Camera -> rate at which it takes views, at most MAX_CAMERA_HZ. A camera with a rate of 0 takes one for the first
    observation and whenever an action asks for one (``Action.look``); a camera that is not named here takes one for
    every observation. Until its next view, every observation holds its last one (``Observation.new``)."""
    control_hz: float = 10.0
    """Rate at which the actions of a chunk are executed: 1-50 Hz."""
    tool_velocity: bool = False
    """Whether observations have ``velocity_tcp_in_base``."""
    language_backend: str = "none"
    """``none``, ``rules-v1``, ``replay:<hash>:<model>`` or ``live:<model>``; travels with every result. The model of
    completions that a person wrote is ``authored``."""
    out_of_bounds: str = "error"
    """What a target position outside the workspace does: ``error`` ends the trial as a failure of the policy's process;
    ``clip`` moves the position onto the border of the workspace, and every score counts how often."""
    arguments: Mapping[str, str] = field(default_factory=dict[str, str], hash=False)
    """Arguments of --policy-arg: name -> text. The benchmark fills this field in; a policy leaves it empty."""
    trained_on: tuple[str, ...] = ()
    """On whom the policy was trained: the sha256 of the salt that drew the persons, as a dataset's README.md has it, or
    the seeds of a protocol, such as ``bathing-wide-v2:0-26``. A run on any of them is refused."""
    environment: tuple[str, ...] = ()
    """Names of the caller's variables that --policy-env let pass; never their values. Added like ``arguments``."""

    def __post_init__(self) -> None:
        """Raises ContractError naming the field, what was expected and what was got."""
        # Whatever its annotations say, a card is written by hand.
        given = {name: cast(object, value) for name, value in vars(self).items()}
        for name in ("name", "language_backend"):
            text = given[name]
            if not isinstance(text, str) or not text.isprintable() or not 0 < len(text) <= MAX_NAME:
                _wrong(name, f"1 to {MAX_NAME} printable characters", text)
        if self.action_space not in ACTION_SPACES:
            _wrong("action_space", f"one of {', '.join(ACTION_SPACES)}", self.action_space)
        if self.action_space == DELTA_SPACE and not self.delta:
            object.__setattr__(self, "delta", DEFAULT_DELTAS)
        if self.delta not in (DELTAS if self.action_space == DELTA_SPACE else ("",)):
            valid = f"one of {', '.join(DELTAS)}, with the action space {DELTA_SPACE}"
            _wrong("delta", f"{valid}, and nothing with any other", self.delta)
        fitting = controls_for(self.action_space)
        if self.control not in fitting:
            _wrong("control", f"one of {', '.join(fitting)}, with the action space {self.action_space}", self.control)
        if self.out_of_bounds not in OUT_OF_BOUNDS:
            _wrong("out_of_bounds", f"one of {', '.join(OUT_OF_BOUNDS)}", self.out_of_bounds)
        for kind, valid in (("modalities", MODALITIES), ("cameras", CAMERAS)):
            names, expected = given[kind], f"a tuple of names out of {', '.join(valid)}"
            if not isinstance(names, tuple | list):
                _wrong(kind, expected, names)
            if unknown := [name for name in cast(Sequence[object], names) if name not in valid]:
                _wrong(kind, expected, unknown[0])
        object.__setattr__(self, "camera_hz", _camera_rates(given["camera_hz"], self.cameras))
        if not isinstance(given["tool_velocity"], bool):
            _wrong("tool_velocity", "True or False", given["tool_velocity"])
        for entry in self.trained_on if isinstance(given["trained_on"], tuple | list) else [given["trained_on"]]:
            if not isinstance(entry, str) or TRAINED.fullmatch(entry) is None:
                _wrong(
                    "trained_on",
                    "a tuple of the sha256 of salts and of PROTOCOL:SEEDS such as bathing-wide-v2:0-26",
                    entry,
                )
        check_arguments(given["arguments"])
        check_variables(given["environment"])
        rate = given["control_hz"]
        if isinstance(rate, bool) or not isinstance(rate, int | float) or not 1 <= rate <= 50:
            _wrong("control_hz", "a number from 1 to 50 [Hz]", rate)
        object.__setattr__(self, "control_hz", float(rate))  # as it arrives over the wire

    def plain(self) -> dict[str, object]:
        """Return the card as JSON has it, with lists for tuples.

        Fields that cards did not always have are left out at their defaults, so that such a card is written as it
        always was.
        """
        entries = {field.name: getattr(self, field.name) for field in fields(self)}
        entries |= {name: list(entries[name]) for name in ("modalities", "cameras", "trained_on", "environment")}
        entries |= {name: dict(entries[name]) for name in ("arguments", "camera_hz")}
        later: dict[str, object] = {
            "arguments": {},
            "camera_hz": {},
            "environment": [],
            "out_of_bounds": "error",
            "trained_on": [],
        }
        later |= {"control": CARTESIAN_IMPEDANCE, "delta": "", "tool_velocity": False}
        return {name: value for name, value in entries.items() if name not in later or value != later[name]}


def controls_for(action_space: str) -> list[str]:
    """Return the controllers that can execute the actions of a space."""
    in_joints = ACTION_SPACES[action_space].in_joints
    return [name for name, control in CONTROLS.usable().items() if (control.joint is not None) == in_joints]


def _camera_rates(given: object, cameras: Sequence[str]) -> dict[str, float]:
    """Return the rates as they arrive over the wire. Raises ContractError for anything else than a mapping from cameras
    of the card to rates."""
    expected = f"a mapping from cameras of the card ({', '.join(cameras)}) to rates from 0 to {MAX_CAMERA_HZ:g} [Hz]"
    if not isinstance(given, Mapping):
        _wrong("camera_hz", expected, given)
    rates: dict[str, float] = {}
    for name, rate in cast(Mapping[object, object], given).items():
        if name not in cameras or isinstance(rate, bool) or not isinstance(rate, int | float):
            _wrong("camera_hz", expected, {name: rate})
        if not 0 <= rate <= MAX_CAMERA_HZ:
            _wrong("camera_hz", expected, {name: rate})
        rates[str(name)] = float(rate)
    return rates


def check_arguments(given: object) -> None:
    """Raises ContractError for names or texts that cannot stand in a card."""
    expected = f"at most {MAX_ARGUMENTS} names with printable texts of at most {MAX_ARGUMENT} characters"
    if not isinstance(given, Mapping):
        _wrong("arguments", expected, given)
    entries = cast(Mapping[object, object], given)
    for name, text in entries.items():
        fits = isinstance(text, str) and text.isprintable() and len(text) <= MAX_ARGUMENT
        if len(entries) > MAX_ARGUMENTS or not isinstance(name, str) or not name.isidentifier() or not fits:
            _wrong("arguments", expected, {name: text})


def check_variables(given: object) -> None:
    """Raises ContractError for what cannot be names of environment variables in a card."""
    expected = f"at most {MAX_ARGUMENTS} names of variables"
    if not isinstance(given, tuple | list):
        _wrong("environment", expected, given)
    names = cast(Sequence[object], given)
    for name in names:
        if len(names) > MAX_ARGUMENTS or not isinstance(name, str) or not name.isidentifier():
            _wrong("environment", expected, name)


def _wrong(field: str, expected: str, got: object) -> NoReturn:
    raise ContractError(f"PolicyCard.{field}: expected {expected}, got {got!r:.80}")


@runtime_checkable
class Policy(Protocol):
    """The interface of a policy; the benchmark runs it in a process of its own.

    Apart from its observations and the session, a policy learns nothing about the trial but the instruction.

    Optional methods: ``configure(session: Session) -> None`` receives the session before every ``reset``, for example
    to plan inside the workspace bounds. ``take_notes() -> dict[str, object]`` is called after every ``act`` and once
    when the policy fails. It returns plain values and numeric arrays, which the recording keeps for inspection; they
    enter no success rate and no metric. Do not note times of the clock: the recording would not be reproducible.
    """

    card: PolicyCard

    def reset(self, instruction: str) -> None: ...

    def act(self, observation: Observation) -> Action | Sequence[Action]: ...


@dataclass(frozen=True, kw_only=True)
class PolicyRef:
    """A reference to a policy. Parse a text once with ``parse`` and pass the reference on."""

    kind: Literal["registered", "importable", "remote"]
    text: str
    """What recordings, manifests and messages show: it never holds credentials."""
    variant: str = ""
    """What ends ``text`` behind a plus sign (``VARIANT``); empty for the policy as it is."""
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

    @property
    def name(self) -> str:
        """The text without a variant: what a registry or an import knows."""
        return self.text.removesuffix(f"+{self.variant}") if self.variant else self.text

    def with_variant(self, variant: str) -> Self:
        """Return the reference to the same policy in a variant."""
        return replace(self, text=f"{self.name}+{variant}", variant=variant)

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read ``state-machine``, ``module:Class`` (a function that returns a policy will do),
        ``ws://[USER:PASSWORD@]HOST:PORT``, or the address of a dialect as EXPECTED has it; a variant may follow.
        Whether a registered name or a profile exists is checked when it is looked up.

        Raises ConfigError for a malformed ``module:Class`` or address; the message shows no password.
        """
        if (variant := VARIANT.search(text)) is not None:
            return cls.parse(text[: variant.start()]).with_variant(variant[1])
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

        def wrong(why: str) -> ConfigError:
            return ConfigError(f"policy {shown!r}: {why}")

        scheme = next((name for name in get_args(Scheme) if name == given), None)
        if given == "wss":
            raise wrong(f"expected {EXPECTED['ws']}; for an encrypted connection, use a tunnel such as ssh -L")
        if scheme is None:
            others = f"; other schemes: {', '.join(SCHEMES[1:])}{did_you_mean(given, SCHEMES)}"
            raise wrong(f"expected {EXPECTED['ws']}{others}")
        try:
            parts = urlsplit(text)
            host, port = parts.hostname, parts.port
            pairs = parse_qsl(parts.query, keep_blank_values=True, strict_parsing=bool(parts.query))
        except ValueError as error:
            raise wrong(f"expected {EXPECTED[scheme]}: {error}") from None
        more = scheme == "ws" and (parts.path not in ("", "/") or parts.query)
        if not host or not port or parts.fragment or more:
            raise wrong(f"expected {EXPECTED[scheme]}")
        credentials = ""
        if parts.username is not None:
            if scheme != "ws":
                raise wrong(f"a key never stands in the address; put it into {API_KEY}")
            if not parts.username or parts.password is None:
                raise wrong("expected USER:PASSWORD before the @")
            credentials = f"{unquote(parts.username)}:{unquote(parts.password)}"
        try:
            options = _options(scheme, pairs)
        except ConfigError as error:
            raise wrong(str(error)) from None
        path = "" if parts.path == "/" else parts.path
        place = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        query = f"?{urlencode(options)}" if options else ""
        return cls(
            kind="remote",
            text=f"{scheme}://{place}{path}{query}",
            scheme=scheme,
            host=host,
            port=port,
            path=path or "/",
            options=options,
            credentials=credentials,
        )


def _options(scheme: str, pairs: list[tuple[str, str]]) -> tuple[tuple[str, str], ...]:
    """Return the options in the order of OPTIONS, so that one request has one text."""
    valid = OPTIONS[scheme]
    for name, value in pairs:
        if name not in valid:
            raise ConfigError(f"no option named {name!r}{did_you_mean(name, valid)}; valid: {', '.join(valid)}")
        if name == "exterior" and value not in ("0", "1"):
            raise ConfigError(f"exterior: expected 0 or 1, the number of the first camera, got {value!r}")
        if name == "horizon" and not (value.isascii() and value.isdigit() and 1 <= int(value[:9]) <= MAX_CHUNK):
            raise ConfigError(f"horizon: expected 1 to {MAX_CHUNK} actions, got {value!r}")
        if not value:
            raise ConfigError(f"{name}: expected a value, got none")
    chosen = dict(pairs)
    if len(chosen) != len(pairs):
        raise ConfigError("expected each option once")
    return tuple((name, chosen[name]) for name in valid if name in chosen)
