"""Whether a policy's answers depend on its inputs: the messages with one input changed, and what they change."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from carecontact.errors import ContractError
from carecontact.interface.observation import CameraView, Observation
from carecontact.interface.policy import PolicyCard
from carecontact.interface.robot import Session
from carecontact.serving import vla_eval
from carecontact.serving.conversation import readable
from carecontact.serving.dialect import WRIST, profile_of
from carecontact.serving.packing import is_array, is_list, is_map
from carecontact.serving.sent_message import dialect_of, rebuilt_message, unpacked_message

# Shows the content of a sent or received message in words and as pictures.

U8 = npt.NDArray[np.uint8]
F64 = npt.NDArray[np.float64]

SHOWN_CHARS = 80
DIALECTS = ("openpi", "roboarena", "vla-eval")


def leaves(value: object, *, prefix: str = "") -> dict[str, object]:
    """Return name -> value of every entry that is no map; keys of nested maps are joined with dots."""
    if not is_map(value):
        return {prefix: value}
    found: dict[str, object] = {}
    for key, inner in value.items():
        found |= leaves(inner, prefix=f"{prefix}.{key}" if prefix else str(key))
    return found


def decoded(frame: bytes | str, scheme: str) -> dict[str, object]:
    """Return the leaves of a frame; none if it cannot be decoded.

    Args:
        scheme: scheme of the policy's address; ``ws`` for a policy without an address.
    """
    if isinstance(frame, str):
        return {}
    try:
        return leaves(unpacked_message(frame, scheme if scheme in DIALECTS else ""))
    except ContractError:
        return {}


def chunk_of(frame: bytes | str, scheme: str) -> F64 | None:
    """Return the numbers (steps, columns) of a dialect's answer, unchanged; None if it has no such array."""
    found = decoded(frame, scheme)
    array = next((found[name] for name in ("actions", "payload.actions", "") if name in found), None)
    if not is_array(array) or array.dtype.kind not in "fiu" or array.ndim not in (1, 2) or not array.size:
        return None
    with np.errstate(invalid="ignore"):
        return np.atleast_2d(array).astype(np.float64)


def pictures(sent: dict[str, object]) -> dict[str, U8]:
    """Return key -> picture (H, W, 3) for every picture among the leaves of a message."""
    return {
        key: value
        for key, value in sent.items()
        if is_array(value) and value.dtype == np.uint8 and value.ndim == 3 and value.shape[2] == 3
    }


def camera_names(card: PolicyCard) -> dict[str, str]:
    """Return key of a picture -> name of our camera."""
    dialect = dialect_of(card.arguments)
    if dialect == "vla-eval":
        return {f"payload.images.{vla_eval.EXTERIOR}": "exterior", f"payload.images.{vla_eval.WRIST}": "wrist"}
    if dialect:
        return {**{key: name for name, key in profile_of(card.arguments).exterior_keys.items()}, WRIST: "wrist"}
    return {f"observation.cameras.{name}.rgb": name for name in card.cameras}


def described(value: object) -> str:
    """Describe one leaf in a few words: kind, shape and range, or the text."""
    if is_array(value):
        if not value.size or value.dtype.kind not in "fiu":
            return f"{value.dtype.name} {value.shape}"
        known = value[np.isfinite(value)]
        span = f"{known.min():.4g} to {known.max():.4g}" if known.size else "no number"
        return f"{value.dtype.name} {value.shape}, {span}"
    if is_list(value):
        value = [int(v) if isinstance(v, bool | np.bool_) else v for v in value]
    return readable(repr(value)[:SHOWN_CHARS] + ("..." if len(repr(value)) > SHOWN_CHARS else ""))


def listed(found: dict[str, object]) -> list[str]:
    """Return one aligned line for each leaf."""
    names = {key: readable(key[:SHOWN_CHARS]) for key in found}
    width = max(map(len, names.values()), default=0)
    return [f"{names[key]:{width}}  {described(value)}" for key, value in found.items()]


# The pieces of what a policy is shown, and how each is blanked.

GREY = 127
INSTRUCTION = "do nothing"
"""Replaces the task's instruction: another text and not an empty one, which some servers refuse."""
MOVING_RAD_S = 0.2
OPENING = 1.0
"""Replaces the gripper's reading, which is always closed here: it is the opposite value."""


@dataclass(frozen=True, kw_only=True)
class Input:
    """One piece of an observation."""

    name: str
    """Keys under which the piece is sent."""
    is_gripper: bool = False
    needed: bool
    """Whether it is suspicious if a policy does not use the piece. Many do not use the tool's pose, for example."""
    blank: Callable[[Observation], Observation]
    """Returns the observation with this piece blanked; the result is a valid observation within the robot's limits."""


def inputs_of(observation: Observation, card: PolicyCard, session: Session, *, sent: bytes) -> list[Input]:
    """Return every piece that a policy with this card is sent.

    Args:
        sent: the message that carried the observation.
    """
    dialect = dialect_of(card.arguments)

    def message(seen: Observation) -> dict[str, object]:
        again = rebuilt_message(seen, card.arguments, card.cameras, sent=sent)
        return leaves(unpacked_message(again, dialect))

    whole, found = message(observation), list[Input]()
    cameras = camera_names(card)
    for candidate in _candidates(card, session, joints_needed=bool(dialect)):
        blanked = message(candidate.blank(observation))
        changed = [key for key, value in whole.items() if not _equal(value, blanked.get(key))]
        if not changed:
            continue
        what = f"camera {candidate.name}" if candidate.name in cameras.values() else candidate.name
        shown = changed[0] if len(changed) == 1 else changed[0].rpartition(".")[0]
        found.append(replace(candidate, name=f"{shown} ({what})"))
    return found


def _candidates(card: PolicyCard, session: Session, *, joints_needed: bool) -> Iterator[Input]:
    low, high = np.array(session.joint_low_rad), np.array(session.joint_high_rad)
    box = np.array([session.action_bounds.workspace_low_m, session.action_bounds.workspace_high_m])
    if card.modalities:
        for camera in card.cameras:
            yield Input(name=camera, needed=True, blank=lambda seen, camera=camera: _without_view(seen, camera))
    yield Input(name="instruction", needed=True, blank=lambda seen: replace(seen, instruction=INSTRUCTION))
    yield Input(
        name="joint angles", needed=joints_needed, blank=lambda seen: replace(seen, joint_position=(low + high) / 2)
    )
    yield Input(
        name="gripper", needed=False, is_gripper=True,
        blank=lambda seen: replace(seen, gripper_position=np.full(1, OPENING)),
    )  # fmt: skip
    yield Input(
        name="pose of the tool", needed=False,
        blank=lambda seen: replace(seen, pose_tcp_in_base=np.r_[box.mean(0), seen.pose_tcp_in_base[3:]]),
    )  # fmt: skip
    yield Input(
        name="joint velocities", needed=False,
        blank=lambda seen: replace(seen, joint_velocity=np.full_like(seen.joint_velocity, MOVING_RAD_S)),
    )  # fmt: skip


def _without_view(seen: Observation, camera: str) -> Observation:
    return replace(seen, cameras={**seen.cameras, camera: _empty(seen.cameras[camera])})


def _empty(view: CameraView) -> CameraView:
    """Return a view with a grey picture, no depth, and nothing that was found in it."""
    return replace(
        view,
        rgb=None if view.rgb is None else np.full_like(view.rgb, GREY),
        depth=None if view.depth is None else np.full_like(view.depth, np.nan),
        points=None if view.points is None else view.points[:0],
        point_colors=None if view.point_colors is None else view.point_colors[:0],
        masks=None if view.masks is None else {name: np.zeros_like(mask) for name, mask in view.masks.items()},
        landmarks=None if view.landmarks is None else np.full_like(view.landmarks, np.nan),
        landmarks_in_base=None if view.landmarks_in_base is None else np.full_like(view.landmarks_in_base, np.nan),
    )


def _equal(a: object, b: object) -> bool:
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return a.shape == b.shape and a.tobytes() == b.tobytes()
    return a is b or bool(a == b)


# Whether a blanked input changes a policy's answers by more than repeats of one request differ.

SHUFFLES = 999
SEEN_P = 0.05
"""An effect counts as seen below this probability, which is also the share of inputs without effect that are mistaken
for inputs with one."""
NEIGHBOURS = 3


def differ_p(plain: F64, blanked: F64, rng: np.random.Generator) -> float:
    """Return the probability of a difference at least as large as this one if the input has no effect.

    This is a permutation test, which assumes only that calls with and without the input were made in random order. It
    combines three statistics: the squared difference of the means over all numbers of the answer, for an effect on many
    of them; the largest difference of a mean, for an effect on one; and how often the nearest answers are of the same
    kind, for answers with several modes.

    Args:
        plain: (n, D) numbers of the answers to one request.
        blanked: (m, D) numbers of the answers to the same request with one input blanked.
    """
    values = np.concatenate([plain, blanked])
    spread = values.std(axis=0)
    values = values[:, spread > 0] / spread[spread > 0]
    if not values.size:
        return 1.0
    n, total = len(plain), len(values)
    labels = np.zeros((SHUFFLES + 1, total))
    labels[0, :n] = 1
    labels[1:] = rng.permuted(np.tile(labels[0], (SHUFFLES, 1)), axis=1)
    means = labels @ values / n - (1 - labels) @ values / (total - n)
    far = ((values[:, None] - values[None]) ** 2).sum(-1)
    np.fill_diagonal(far, np.inf)
    near = np.argsort(far, axis=1, kind="stable")[:, :NEIGHBOURS]
    same = (labels[:, near] == labels[:, :, None]).sum((1, 2))
    ranks = [_share_at_least(statistic) for statistic in ((means**2).sum(1), np.abs(means).max(1), same.astype(float))]
    best = np.min(ranks, axis=0)
    return float((best <= best[0] + 1e-12).mean())


def _share_at_least(statistic: F64) -> F64:
    """Return, for each shuffle (shuffles,), the share of all shuffles with a statistic at least as large."""
    rounded = np.round(statistic, 9)
    return (len(rounded) - np.searchsorted(np.sort(rounded), rounded, side="left")) / len(rounded)


# Which inputs a policy uses: each is blanked in turn, and the answers are compared with those to the unchanged request.

Ask = Callable[[Observation], F64 | None]
"""Observation -> (steps, columns) of the answer, or None if the policy refused this observation."""

ALIKE = 4
"""If so many answers to one request are equal to the last bit, the policy counts as deterministic."""
LOOKS = (12, 24, 48)
"""Numbers of calls with each input blanked, and of as many without, after which the answers are compared. Only inputs
that have shown no effect are tested further; after the last number, an input without effect is reported."""
BUDGET_S = 120.0
"""Time [s] that all of this may take at the speed of the first calls; a comparison that would exceed it is left out."""
FEWEST = 4
"""Least number of repeats of the first request, however slow the policy is."""
SEED = 20

Verdict = Literal["used", "unused", "unclear"]


@dataclass(frozen=True, kw_only=True)
class Effect:
    """The result for one input."""

    input: Input
    verdict: Verdict
    """``unclear``: no effect was seen in too few calls."""
    calls: int
    """Number of calls with the input blanked."""
    refused: bool = False
    """Whether the policy refused the blanked input, which shows that it uses it."""
    moved: float = 0.0
    """Change of the mean answer, as the root mean square over its numbers."""
    spread: float = 0.0
    """Standard deviation between repeats of one request, by the same root mean square; 0 if all repeats are equal."""
    answers: tuple[F64, ...] = ()


class Ablation:
    """Asks a policy with and without each of its inputs."""

    def __init__(self, ask: Ask, observation: Observation, inputs: Sequence[Input]) -> None:
        self._ask, self._observation, self._inputs = ask, observation, list(inputs)
        self._rng = np.random.default_rng(SEED)
        self.plain: list[F64] = []
        """Answers to the unchanged request."""
        self._blanked: dict[int, list[F64]] = {i: [] for i in range(len(inputs))}
        self._refused: set[int] = set()

    def run(self, on_plan: Callable[[int, float], None]) -> Iterator[Effect]:
        """Yield one effect for each input.

        Args:
            on_plan: called with the number of calls and the seconds that they will take, before many of them.

        Raises:
            PolicyError: the policy fails at the unchanged request.
        """
        started = time.monotonic()
        for _ in range(ALIKE):
            self._call(None)
        call_s = (time.monotonic() - started) / ALIKE
        if all(np.array_equal(answer, self.plain[0]) for answer in self.plain[1:]):
            for i in range(len(self._inputs)):
                self._call(i)
                yield self._effect(i, used=self._answers_differ(i), enough=True)
            return
        yield from self._by_chance(call_s, on_plan)

    def _by_chance(self, call_s: float, on_plan: Callable[[int, float], None]) -> Iterator[Effect]:
        """Yield the effects for a policy whose answers to one request differ.

        Calls are made in random order, so that neither a drift nor the order of the inputs can look like an effect.
        """
        self.plain.clear()
        unseen, spent_s, done = list(range(len(self._inputs))), 0.0, 0
        for look in LOOKS:
            a_repeat_s = call_s * (len(unseen) + 1)
            repeats = min(look - done, int((BUDGET_S - spent_s) / a_repeat_s))
            if done and repeats < look - done:
                break
            repeats = max(repeats, FEWEST)
            done, spent_s = done + repeats, spent_s + repeats * a_repeat_s
            on_plan(repeats * (len(unseen) + 1), repeats * a_repeat_s)
            for which in self._rng.permutation(np.repeat([-1, *unseen], repeats)):
                self._call(None if which < 0 else int(which))
            seen = [i for i in unseen if self._answers_differ(i)]
            for i in seen:
                yield self._effect(i, used=True, enough=True)
            unseen = [i for i in unseen if i not in seen]
            if not unseen or done < look:
                break
        for i in unseen:
            yield self._effect(i, used=False, enough=done == LOOKS[-1])

    def _call(self, which: int | None) -> None:
        if which is None:
            answer = self._ask(self._observation)
            assert answer is not None
            self.plain.append(answer)
        elif which not in self._refused:
            answer = self._ask(self._inputs[which].blank(self._observation))
            if answer is None:
                self._refused.add(which)
            else:
                self._blanked[which].append(answer)

    def _answers_differ(self, i: int) -> bool:
        if i in self._refused:
            return True
        plain, blanked = aligned(self.plain, self._blanked[i])
        if (plain == plain[0]).all():
            return not bool((blanked == plain[0]).all())
        return differ_p(plain, blanked, self._rng) <= SEEN_P / len(LOOKS)

    def _effect(self, i: int, *, used: bool, enough: bool) -> Effect:
        verdict: Verdict = "used" if used else "unused" if enough else "unclear"
        blanked = self._blanked[i]
        if not blanked:
            return Effect(input=self._inputs[i], verdict=verdict, calls=1, refused=True)
        plain, without = aligned(self.plain, blanked)
        return Effect(
            input=self._inputs[i], verdict=verdict, calls=len(blanked), refused=i in self._refused,
            moved=_rms(without.mean(0) - plain.mean(0)), spread=_rms(plain.std(0)), answers=tuple(blanked),
        )  # fmt: skip


def aligned(plain: Sequence[F64], blanked: Sequence[F64]) -> tuple[F64, F64]:
    """Return the numbers of all answers as arrays (n, D) and (m, D), cut to the shortest answer, with the number of
    steps as the last column.
    """
    every = [*plain, *blanked]
    steps, columns = min(len(answer) for answer in every), min(answer.shape[1] for answer in every)
    rows = np.array([[*answer[:steps, :columns].ravel(), len(answer)] for answer in every])
    return rows[: len(plain)], rows[len(plain) :]


def _rms(values: F64) -> float:
    return float(np.sqrt((values[:-1] ** 2).mean()))
