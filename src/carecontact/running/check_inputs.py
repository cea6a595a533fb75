"""Whether a policy's answers depend on its inputs: each is blanked in turn, and the answers are compared with those to
the unchanged request."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import numpy as np

from carecontact.interface.observation import F64, CameraView, Observation
from carecontact.interface.policy import PolicyCard
from carecontact.interface.robot import Session
from carecontact.running.check_messages import camera_names, leaves
from carecontact.serving.sent_message import dialect_of, rebuilt_message, unpacked_message

GREY = 127
INSTRUCTION = "do nothing"
"""Replaces the task's instruction: another text and not an empty one, which some servers refuse."""
MOVING_RAD_S = 0.2
OPENING = 1.0
"""Replaces the gripper's reading, which is always closed here: it is the opposite value."""
SHUFFLES = 999
SEEN_P = 0.05
"""An effect counts as seen below this probability, which is also the share of inputs without effect that are mistaken
for inputs with one."""
NEIGHBOURS = 3
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

Ask = Callable[[Observation], F64 | None]
"""Observation -> (steps, columns) of the answer, or None if the policy refused this observation."""
Verdict = Literal["used", "unused", "unclear"]


@dataclass(frozen=True, kw_only=True)
class Input:
    """One piece of an observation."""

    name: str
    """Keys under which the piece is sent."""
    is_gripper: bool = False
    needed: bool = False
    """Whether it is suspicious if a policy does not use the piece. Many do not use the tool's pose, for example."""
    blank: Callable[[Observation], Observation]
    """Returns the observation with this piece blanked; the result is a valid observation within the robot's limits."""


def inputs_of(observation: Observation, card: PolicyCard, session: Session, *, sent: bytes) -> list[Input]:
    """Return every piece that a policy with this card is sent. ``sent``: the message that carried the observation."""
    dialect = dialect_of(card.arguments)

    def message(seen: Observation) -> dict[str, object]:
        again = rebuilt_message(seen, card.arguments, card.cameras, sent=sent)
        return leaves(unpacked_message(again, dialect))

    whole, found, cameras = message(observation), list[Input](), camera_names(card).values()
    for candidate in _candidates(card, session, joints_needed=bool(dialect)):
        blanked = message(candidate.blank(observation))
        changed = [key for key, value in whole.items() if not _equal(value, blanked.get(key))]
        if changed:
            what = f"camera {candidate.name}" if candidate.name in cameras else candidate.name
            shown = changed[0] if len(changed) == 1 else changed[0].rpartition(".")[0]
            found.append(replace(candidate, name=f"{shown} ({what})"))
    return found


def _candidates(card: PolicyCard, session: Session, *, joints_needed: bool) -> Iterator[Input]:
    def blanked(name: str, make: Callable[[Observation], Any]) -> Callable[[Observation], Observation]:
        return lambda seen: replace(seen, **{name: make(seen)})

    def without(camera: str) -> Callable[[Observation], Any]:
        return lambda seen: {**seen.cameras, camera: _empty(seen.cameras[camera])}

    middle = (np.array(session.joint_low_rad) + np.array(session.joint_high_rad)) / 2
    box = np.array([session.action_bounds.workspace_low_m, session.action_bounds.workspace_high_m])
    for camera in card.cameras if card.modalities else ():
        yield Input(name=camera, needed=True, blank=blanked("cameras", without(camera)))
    yield Input(name="instruction", needed=True, blank=blanked("instruction", lambda seen: INSTRUCTION))
    yield Input(name="joint angles", needed=joints_needed, blank=blanked("joint_position", lambda seen: middle))
    opened = blanked("gripper_position", lambda seen: np.full(1, OPENING))
    yield Input(name="gripper", is_gripper=True, blank=opened)
    placed = blanked("pose_tcp_in_base", lambda seen: np.r_[box.mean(0), seen.pose_tcp_in_base[3:]])
    yield Input(name="pose of the tool", blank=placed)
    moving = blanked("joint_velocity", lambda seen: np.full_like(seen.joint_velocity, MOVING_RAD_S))
    yield Input(name="joint velocities", blank=moving)


def _empty(view: CameraView) -> CameraView:
    """Return a view with a grey picture, no depth, and nothing that was found in it."""
    fills = {"rgb": GREY, "depth": np.nan, "landmarks": np.nan, "landmarks_in_base": np.nan}
    shown = {field.name: getattr(view, field.name) for field in fields(view)}
    blank: dict[str, Any] = {n: np.full_like(shown[n], fill) for n, fill in fills.items() if shown[n] is not None}
    blank |= {name: shown[name][:0] for name in ("points", "point_colors") if shown[name] is not None}
    if view.masks is not None:
        blank["masks"] = {name: np.zeros_like(mask) for name, mask in view.masks.items()}
    return replace(view, **blank)


def _equal(a: object, b: object) -> bool:
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return a.shape == b.shape and a.tobytes() == b.tobytes()
    return a is b or bool(a == b)


def differ_p(plain: F64, blanked: F64, rng: np.random.Generator) -> float:
    """Return the probability of a difference at least as large as this one if the input has no effect. This is a
    permutation test, which assumes only that calls with and without the input were made in random order. It combines
    three statistics: the squared difference of the means over all numbers of the answer, for an effect on many of them;
    the largest difference of a mean, for an effect on one; and how often the nearest answers are of the same kind, for
    answers with several modes."""
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


@dataclass(frozen=True, kw_only=True)
class Effect:
    input: Input
    verdict: Verdict
    """``unclear``: no effect was seen in too few calls."""
    calls: int
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
        self._blanked: list[list[F64]] = [[] for _ in inputs]
        self._refused: set[int] = set()

    def run(self, on_plan: Callable[[int, float], None]) -> Iterator[Effect]:
        started = time.monotonic()
        for _ in range(ALIKE):
            self._call(-1)
        call_s = (time.monotonic() - started) / ALIKE
        if not all(np.array_equal(answer, self.plain[0]) for answer in self.plain[1:]):
            yield from self._by_chance(call_s, on_plan)
            return
        for i in range(len(self._inputs)):
            self._call(i)
            yield self._effect(i, "used" if self._answers_differ(i) else "unused")

    def _by_chance(self, call_s: float, on_plan: Callable[[int, float], None]) -> Iterator[Effect]:
        """Yield the effects where answers differ. Random order keeps a drift from looking like an effect."""
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
                self._call(int(which))
            seen = [i for i in unseen if self._answers_differ(i)]
            for i in seen:
                yield self._effect(i, "used")
            unseen = [i for i in unseen if i not in seen]
            if not unseen or done < look:
                break
        for i in unseen:
            yield self._effect(i, "unused" if done == LOOKS[-1] else "unclear")

    def _call(self, which: int) -> None:
        """Ask with one input blanked; -1: with none."""
        if which < 0:
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

    def _effect(self, i: int, verdict: Verdict) -> Effect:
        answers = tuple(self._blanked[i])
        if not answers:
            return Effect(input=self._inputs[i], verdict=verdict, calls=1, refused=True)
        plain, blanked = aligned(self.plain, answers)
        return Effect(
            input=self._inputs[i],
            verdict=verdict,
            calls=len(answers),
            refused=i in self._refused,
            moved=_rms(blanked.mean(0) - plain.mean(0)),
            spread=_rms(plain.std(0)),
            answers=answers,
        )


def aligned(plain: Sequence[F64], blanked: Sequence[F64]) -> tuple[F64, F64]:
    """Return all answers as arrays (n, D) and (m, D), cut to the shortest; the last column is the number of steps."""
    every = [*plain, *blanked]
    steps, columns = min(len(answer) for answer in every), min(answer.shape[1] for answer in every)
    rows = np.array([[*answer[:steps, :columns].ravel(), len(answer)] for answer in every])
    return rows[: len(plain)], rows[len(plain) :]


def _rms(values: F64) -> float:
    return float(np.sqrt((values[:-1] ** 2).mean()))
