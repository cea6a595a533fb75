"""The interface of a policy: its card and its two methods."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import NoReturn, Protocol, cast, runtime_checkable

from carecontact.contract.action import ACTION_SPACES, Action
from carecontact.contract.control import CARTESIAN_IMPEDANCE, CONTROLS
from carecontact.contract.observation import MODALITIES, Observation
from carecontact.errors import ContractError

CAMERAS = ("overhead", "bedside", "exterior", "wrist")
OUT_OF_BOUNDS = ("error", "clip")
MAX_NAME = 200
"""Characters of a card's name and language backend: they stand in headers, tables and file names."""
MAX_ARGUMENTS, MAX_ARGUMENT = 64, 2000
"""Number of arguments or variables of a policy, and characters of one value: they stand in every recording."""


@dataclass(frozen=True, kw_only=True)
class PolicyCard:
    """What a policy requests. Only what it names is rendered."""

    name: str
    action_space: str = "cartesian_pose"
    """Name from ACTION_SPACES."""
    control: str = CARTESIAN_IMPEDANCE
    """Name from CONTROLS: the controller that executes the actions. Joint spaces need one of the joint controllers."""
    modalities: tuple[str, ...] = ()
    """Names from MODALITIES. At every ``act`` call, the policy receives each of them for each of its cameras; without
    any, it receives what is known of each camera by calibration: where it stands and how it projects."""
    cameras: tuple[str, ...] = ("overhead",)
    control_hz: float = 10.0
    """Rate at which the actions of a chunk are executed: 1-50 Hz."""
    language_backend: str = "none"
    """``none``, ``rules-v1``, ``replay:<hash>:<model>`` or ``live:<model>``; travels with every result. The model of
    completions that a person wrote is ``authored``."""
    out_of_bounds: str = "error"
    """What a target position outside the workspace does: ``error`` ends the trial as a failure of the policy's process;
    ``clip`` moves the position onto the border of the workspace, and every score counts how often."""
    arguments: Mapping[str, str] = field(default_factory=dict[str, str], hash=False)
    """Arguments of --policy-arg: name -> text. The benchmark fills this field in; a policy leaves it empty."""
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
        fitting = controls_for(self.action_space)
        if self.control not in fitting:
            _wrong("control", f"one of {', '.join(fitting)}, with the action space {self.action_space}", self.control)
        if self.out_of_bounds not in OUT_OF_BOUNDS:
            _wrong("out_of_bounds", f"one of {', '.join(OUT_OF_BOUNDS)}", self.out_of_bounds)
        for kind, valid in (("modalities", MODALITIES), ("cameras", CAMERAS)):
            names = given[kind]
            expected = f"a tuple of names out of {', '.join(valid)}"
            if not isinstance(names, tuple | list):
                _wrong(kind, expected, names)
            for name in cast(Sequence[object], names):
                if name not in valid:
                    _wrong(kind, expected, name)
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
        entries |= {name: list(entries[name]) for name in ("modalities", "cameras", "environment")}
        entries["arguments"] = dict(self.arguments)
        later: dict[str, object] = {"arguments": {}, "environment": [], "out_of_bounds": "error"}
        later["control"] = CARTESIAN_IMPEDANCE
        return {name: value for name, value in entries.items() if name not in later or value != later[name]}


def controls_for(action_space: str) -> list[str]:
    """Return the controllers that can execute the actions of a space."""
    in_joints = ACTION_SPACES[action_space].in_joints
    return [name for name, control in CONTROLS.usable().items() if (control.joint is not None) == in_joints]


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
