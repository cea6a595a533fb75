"""What an action is for the scorer: its gate, how a trial is judged by it, and what is asked of an extension's row."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from traceback import extract_tb
from typing import Any, ClassVar, Generic, Literal, TypeVar

import numpy as np

from carecontact.errors import CarecontactError, ConfigError
from carecontact.protocol.gates import ACTIONS, Action, Section
from carecontact.registry import Registry
from carecontact.scoring.commanded import CommandedContact
from carecontact.scoring.contact import F64, Contact, Mask, runs, steps
from carecontact.scoring.progress import Episode
from carecontact.scoring.result import TrialScore


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """What a trial achieved, in the quantities that the gates limit."""

    held_steps: int
    """Longest stretch of physics steps that count toward a hold (``Behaviour.holding``)."""
    best: Episode | None
    """The episode that the score reports. For an action whose gate uses episodes, it decides whether the gate is
    met."""
    wrist_m: float
    """Largest displacement of the wrist while the neighbourhood (``Contact.neighbourhood``) is touched [m]."""
    wrist_any_m: float
    """Largest displacement of the wrist over the whole trial [m]."""


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """Which parts of an action's gate an attempt meets. A part that the action does not require is True."""

    time_met: bool
    """The contact lasted long enough."""
    progress_met: bool
    """The contact had the required effect, for example a displacement or a stroke."""
    band_met: bool = True
    """Force and motion were in the ranges that the gate requires: not too light, too hard or too far."""


@dataclass(frozen=True, kw_only=True)
class GatePart:
    """One of the requirements of a gate, in words, with what was reached."""

    name: str
    needed: str
    reached: str
    met: bool

    @classmethod
    def least(cls, name: str, needed: str, reached: str, met: bool) -> GatePart:
        return cls(name=name, needed=f"at least {needed}", reached=reached, met=met)

    @classmethod
    def most(cls, name: str, needed: str, reached: str, met: bool) -> GatePart:
        return cls(name=name, needed=f"at most {needed}", reached=reached, met=met)


@dataclass(frozen=True, kw_only=True)
class Gate(Judgement):
    """The result of a trial under its gate."""

    success: bool
    longest_on_s: float
    """Longest stretch that counts toward a hold."""
    best: Episode | None
    wrist_m: float
    wrist_any_m: float
    conduct: tuple[GatePart, ...] = ()
    """What the protocol requires of a trial of any action, all met by a success (``scoring.metrics.success``)."""

    @property
    def action_met(self) -> bool:
        """Whether every part of the action's own gate is met."""
        return self.time_met and self.progress_met and self.band_met

    @property
    def conduct_met(self) -> bool:
        return all(part.met for part in self.conduct)

    def time_part(self, name: str, duration_s: float, *, note: str = "") -> GatePart:
        """Return the requirement of a contact without a break; ``note`` follows what was reached."""
        return GatePart(
            name=name, needed=f"{duration_s:g} s", reached=f"{self.longest_on_s:.2f} s{note}", met=self.time_met
        )


@contextmanager
def blamed_on(what: str, trial_id: str) -> Generator[None]:
    """Turn a foreign error inside the block into a ConfigError of one line that names ``what`` and the trial."""
    try:
        yield
    except CarecontactError:
        raise
    except Exception as error:  # a stranger's code may raise anything
        place = extract_tb(error.__traceback__)[-1]
        why = f"{type(error).__name__}: {' '.join(str(error).split())}".rstrip(": ")
        raise ConfigError(
            f"{what} failed in trial {trial_id}: {why} ({Path(place.filename).name}, line {place.lineno})"
        ) from error


def shown(answer: object) -> str:
    """Return the beginning of an answer's repr, in one line."""
    return " ".join(repr(answer).split())[:60]


G = TypeVar("G", bound=Section)


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """A field of a gate whose value was a choice of the benchmark: every trial is scored again with other values of
    it."""

    name: str
    """Key in ``TrialScore.gate_sweep``; it begins with the action, as in ``push_force_n``."""
    field: str
    """Name of the field in the gate's schema."""
    values: tuple[float, ...]
    title: str
    """Title of the figure in the report."""
    unit: str
    """Unit in which the figure shows the values."""
    factor: float = 1.0
    """Factor from the field's unit to the shown one."""


in_mm = partial(Sweep, unit="mm", factor=1000.0)
in_percent = partial(Sweep, unit="%", factor=100.0)


class Behaviour(Action, Generic[G]):
    """One action: the schema of its gate, how a trial is judged by it, and the words for a trial that fails.

    ``gate`` as an argument is the protocol's table for this action. Methods are pure functions of their arguments.
    """

    gate: type[G]
    """Schema of the table ``[gates.<action>]`` in a protocol."""
    sweeps: ClassVar[tuple[Sweep, ...]] = ()
    needs: ClassVar[frozenset[Literal["episodes", "wrist"]]] = frozenset()
    """Measures that ``judge`` uses. The sweep over contact floors computes them again for every floor."""
    moves_the_person: ClassVar[bool] = False
    """Whether the action is meant to move a limb. Results pool the joint-limit margin C2 over such actions alone: it
    says little where nothing was meant to move."""

    by_tool: ClassVar[bool] = False
    """Whether only contact of the robot's tool counts (``Contact.of_tool``). A trial that fails where hand and links
    applied most of the contact impulse has then the failure mode ``not_by_tool``."""
    sets: ClassVar[Mapping[str, Behaviour[Any]]] = {}
    """``gates.set`` of a protocol -> the Behaviour that scores the action under that set in place of this one."""
    harder: ClassVar[Section | None] = None
    """Stricter values of the gate, which no trial has to meet; ``harder_band@2`` reports which trials would meet
    them."""

    def __init_subclass__(cls) -> None:
        """Raises ConfigError for a sweep of a field that the gate does not have."""
        super().__init_subclass__()
        fields: dict[str, Any] = cls.gate.model_fields if hasattr(cls, "gate") else {}
        for sweep in cls.sweeps if fields else ():
            if sweep.field not in fields:
                known = ", ".join(fields)
                raise ConfigError(f"{cls.__name__}.sweeps: the gate has no field {sweep.field!r}; valid: {known}")

    def under(self, gates: str) -> Behaviour[Any]:
        """Return the Behaviour that scores the action under this ``gates.set``."""
        return self.sets.get(gates, self)

    def gate_in(self, gates: str) -> type[Section]:
        return self.under(gates).gate

    @abstractmethod
    def judge(self, contact: Contact, gate: G, attempt: Attempt) -> Judgement: ...

    def holding(self, contact: Contact, gate: G) -> Mask:
        """(T,) physics steps that count toward a hold; by default, those in which the named region's segment or one of
        its neighbours is touched."""
        return contact.neighbourhood_on

    def passes(self, gate: G, episode: Episode) -> bool:
        """Whether one contact episode alone meets the gate; False for an action whose gate does not use episodes."""
        return False

    def reached(self, contact: Contact, gate: G, result: Gate) -> float:
        """Return how much of the gate the trial has reached so far, from 0 to 1, for the rewards of a learner: it rises
        as the trial comes nearer, also before a part is met. By default, the share of the parts that are met."""
        return (result.time_met + result.progress_met + result.band_met) / 3

    def lost(self, contact: Contact, gate: G, result: Gate) -> bool:
        """Whether a trial that did not last long enough held the target for a good part of the time and let it go."""
        return False

    def requested(self, gate: G, asked: CommandedContact) -> str | None:
        """Return what the policy's commands requested, if a tool that followed them would have passed, else None. A
        trial that falls short of progress is then blamed on execution, otherwise on planning."""
        return None

    @abstractmethod
    def shortfall(self, contact: Contact, gate: G, result: Gate) -> str:
        """Return what the trial lacked, with the figures of the gate: words that continue the sentence "The commanded
        path came to the region, but"."""

    def parts(self, contact: Contact, gate: G, result: Gate) -> list[GatePart]:
        """Return the requirements of the gate one by one, for the page of a trial; none by default. Where there are
        any, they are all met exactly if ``judge`` finds every part of the gate met."""
        return []

    def progress(self, score: TrialScore) -> str:
        """Return the figures that the gate judges, for a row of the report."""
        return f"touched for {score.longest_on_s:.2f} s"


class Behaviours(Registry["Behaviour[Any]"]):
    """An action that a process registers here can be named in its protocols too."""

    def register(self, name: str, row: Behaviour[Any], *, origin: object = None) -> Behaviour[Any]:
        super().register(name, row, origin=origin)
        if name not in ACTIONS:
            ACTIONS.register(name, row)
        return row


BEHAVIOURS = Behaviours(
    "action", row=Behaviour, expected="a Behaviour object", plural="behaviours", scan="carecontact.scoring.actions"
)
"""Action -> its behaviour. Other packages add rows through the entry-point group ``carecontact.behaviours``."""


def behaviour_of(action: str, gates: str) -> Behaviour[Any]:
    """Return the Behaviour that scores an action under a set of gates."""
    return BEHAVIOURS[action].under(gates)


def actions_that_move() -> frozenset[str]:
    """Return the registered actions that are meant to move a limb, without those that cannot be loaded."""
    return frozenset(action for action, row in BEHAVIOURS.usable().items() if row.moves_the_person)


def let_go(contact: Contact, holding: Mask, duration_s: float) -> bool:
    """Whether the target itself, not a neighbour, was held for ``duration_s`` and let go before the end; ``holding``
    (T,)."""
    target_held = holding & contact.on[:, contact.target]
    least = steps(duration_s, contact.dt_s)
    return any(stop - start >= least and stop < len(target_held) for start, stop in runs(target_held).tolist())


def mm(metres: float) -> str:
    """Whole millimetres with their unit."""
    return f"{metres * 1000:.0f} mm"


def reversals(n: int) -> str:
    """``1 reversal``, ``2 reversals``."""
    return f"{n} reversal{'' if n == 1 else 's'}"


def exact_mm(metres: float) -> str:
    """Millimetres with one decimal, so that a length just below a gate does not look like one that meets it."""
    return f"{metres * 1000:.1f} mm"


def hardest(contact: Contact) -> str:
    """Return ``largest force 7.3 N``, of the contact near the region."""
    return f"largest force {float(contact.neighbourhood_force.max(initial=0.0)):.1f} N"


def middle_force(force: F64) -> str:
    """``, median 7.3 N``; nothing for no sample."""
    return f", median {np.median(force):.1f} N" if len(force) else ""


ANSWERS: dict[str, tuple[tuple[Any, ...], str]] = {
    "holding": ((np.ndarray,), "an array of booleans, one for each physics step"),
    "judge": ((Judgement,), "a Judgement"),
    "lost": ((bool, np.bool_), "True or False"),
    "passes": ((bool, np.bool_), "True or False"),
    "reached": ((float, int, np.floating), "a number from 0 to 1"),
    "requested": ((str, type(None)), "a text or None"),
    "parts": ((list,), "a list of GatePart"),
    "shortfall": ((str,), "a text"),
}
"""Method of a Behaviour -> classes of its answer, and the same in words."""


def ask(contact: Contact, method: str, *arguments: object, action: str | None = None) -> Any:
    """Return what a method of an action's Behaviour answers. Raises ConfigError if it raises or answers wrongly."""
    action = action or contact.task.action
    trial_id = contact.recording.header.spec.trial_id
    behaviour = behaviour_of(action, contact.protocol.gates.set)
    title = f"{BEHAVIOURS.title(action)}: {method}"
    with blamed_on(title, trial_id):
        found: Any = getattr(behaviour, method)(*arguments)
    classes, expected = ANSWERS[method]
    if not isinstance(found, classes):
        raise ConfigError(f"{title} returned {shown(found)} in trial {trial_id}; expected {expected}")
    shape = contact.neighbourhood_on.shape
    if method == "holding" and (found.shape != shape or found.dtype != np.bool_):
        answer = f"{found.dtype} of shape {found.shape}"
        raise ConfigError(f"{title} returned {answer} in trial {trial_id}; expected {expected}, shape {shape}")
    return found
