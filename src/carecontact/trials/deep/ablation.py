"""Which inputs a policy uses: each is blanked in turn, and the answers are compared with those to the unchanged
request."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from carecontact.contract.observation import Observation
from carecontact.trials.deep.effects import SEEN_P, differ_p
from carecontact.trials.deep.inputs import Input

F64 = npt.NDArray[np.float64]
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
