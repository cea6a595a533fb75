"""What the deltas of an answer mean: questions that show wrong axes, a wrong order, absolute poses, and pictures that
are turned in another way than the policy knows them.

A question moves the tool in the observation and looks how the answer follows. A policy that brings the tool somewhere
answers the opposite of the movement, along the axes in which it means its numbers. Where a number stands at a limit,
the tool is moved further, beyond the policy's goal, so that at least its sign changes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np
import numpy.typing as npt

from carecontact.interface.deltas import DeltaConvention
from carecontact.interface.geometry import (
    matrix_from_euler_xyz,
    matrix_from_quat,
    matrix_from_vector,
    quat_from_matrix,
    vector_from_matrix,
)
from carecontact.interface.observation import F64, Observation
from carecontact.running.check_answers import TURN_RAD, CheckFinding
from carecontact.serving.cartesian import ORIENTATIONS

Ask = Callable[[Observation], F64 | None]
"""Observation -> numbers (steps, 6) of the executed actions, or None if the policy refused."""

STEPS = ((0.03, 0.3, 0.9), (0.2, 0.8, 1.6))
"""How far the tool is moved [m] and turned [rad] in a question: the second and the third only where a number does not
change at the one before. No goal in the robot's reach is further away than the last."""
LIMIT = 0.1
"""A number that does not change stands at a limit if it is larger than this share of its bound."""
NOISE = 5.0
"""A response counts if it is so many times as large as repeats differ. Of 300 simulated policies with random answers
that follow nothing, one got a warning (4 of them at a factor of 4), and none of 900 that follow went unseen."""
SMALLEST_M, SMALLEST_RAD = 0.0003, 0.002
"""Least change of an action that counts."""
WEAK = 0.1
"""Columns of a response that are smaller than this share of its largest do not count."""
FITS, MISFITS = 0.8, 0.5
"""Axes fit if the response points along them by at least the first share, and are wrong below the second."""
TOWARD = 0.6
"""Cosine of the angle between the way of the answer and the way to the named region above which it leads there."""
ALIKE = 0.2
"""Cosines that differ by less do not tell two orientations of pictures apart."""
NEAREST_M = 0.05
"""Horizontal distance of the region below which no direction is looked at."""
METRES = 0.06
"""Translations below this number look like metres, where 1 is not a metre."""
AT_TOOL_M, AT_TOOL_RAD = 0.1, 0.35
"""Numbers that give the tool's own place or orientation within these look like an absolute pose."""
FAR_FROM_NO_TURN_RAD = 2.0
"""A delta turns by less, so that only a larger rotation can look like an absolute orientation."""
AXES = "xyz"


def path_of(numbers: F64, pose: F64, convention: DeltaConvention) -> F64:
    """Return the positions (steps + 1, 3) [m] in base of a tool at a pose (7,) that follows numbers (steps, 6)."""
    places = [pose[:3]]
    for row in numbers:
        pose = convention.target(convention.clipped(row), measured=pose, last=pose)
        places.append(pose[:3])
    return np.array(places)


def absolute(row: F64, tool: F64, sent_m: F64 | None) -> str:
    """Return how the numbers (6,) of an action give the tool's own pose (7,), in words; empty if they do not.

    Args:
        sent_m: (3,) the tool's place as the policy is sent it, if that is in another frame than base [m].
    """
    places = {"in base": tool[:3]} | ({} if sent_m is None else {"in the state that is sent": sent_m})
    for frame, place in places.items():
        if np.linalg.norm(row[:3] - place) < AT_TOOL_M:
            shown = (" ".join(f"{value:.2f}" for value in values) for values in (row[:3], place))
            return "the first translation is {}, and the tool is at {} m ".format(*shown) + frame
    if np.linalg.norm(row[3:]) > FAR_FROM_NO_TURN_RAD:
        now = matrix_from_quat(tool[3:])
        for turn in (matrix_from_vector(row[3:]), matrix_from_euler_xyz(row[3:])):
            if np.linalg.norm(vector_from_matrix(turn.T @ now)) < AT_TOOL_RAD:
                shown = " ".join(f"{value:.2f}" for value in row[3:])
                return f"the first rotation is {shown}, which is the tool's own orientation in base [rad]"
    return ""


def look_at_deltas(numbers: F64, convention: DeltaConvention) -> Iterator[CheckFinding]:
    """Yield warnings about the numbers (steps, 6) of an answer as they came."""
    largest, bounds = np.abs(numbers).max(axis=0), convention.bounds
    for part, name in zip((slice(3), slice(3, 6)), ("translation", "rotation"), strict=True):
        if (largest[part] > 1.2 * bounds[part]).any():
            share = (np.abs(numbers[:, part]) > bounds[part]).any(axis=1).mean()
            text = (
                f"{share:.0%} of the steps have a {name} beyond {bounds[part][0]:g}, up to {largest[part].max():.3g}, "
                f"which is moved onto this bound: {convention.description}"
            )
            if name == "rotation" and largest[part].max() > TURN_RAD:
                text += " The numbers look like degrees; send them as the convention has them."
            yield CheckFinding("warning", "deltas", text)
    if convention.unit[0] < 1 and 0 < largest[:3].max() < METRES:
        most, mm = largest[:3].max(), 1000 * convention.unit[0] * largest[:3].max()
        text = (
            f"translations of at most {most:.3g}, which are {mm:.2g} mm here: if metres are meant, the profile is wrong"
        )
        yield CheckFinding("hint", "deltas", text)


@dataclass(frozen=True)
class Meaning:
    """One way in which the numbers of a translation or of a rotation may be meant."""

    mistakes: tuple[str, ...]
    """What differs from the declared meaning; empty for the declared one."""
    matrix: F64
    """(3, 3) from a vector in base to the numbers, up to scale."""


def meanings(tool: F64, convention: DeltaConvention) -> list[Meaning]:
    """Return the declared meaning of numbers, then mistakes, the fewest first. ``tool``: its pose (7,)."""
    to_tool, other = matrix_from_quat(tool[3:]).T, "tool" if convention.frame == "base" else "base"
    frames = {convention.frame: np.eye(3), other: to_tool} if other == "tool" else {"tool": to_tool, "base": np.eye(3)}
    found: list[Meaning] = []
    for (frame, turn), order, signs in product(frames.items(), permutations(range(3)), product((1, -1), repeat=3)):
        flipped = [axis for axis, sign in zip(AXES, signs, strict=True) if sign < 0]
        said = [f"the axes of the {frame}"] if frame != convention.frame else []
        said += [f"the order {' '.join(AXES[k] for k in order)}"] if order != (0, 1, 2) else []
        said += ["the opposite sign"] if len(flipped) == 3 else [f"the opposite sign of {axis}" for axis in flipped]
        found.append(Meaning(tuple(said), np.array(signs)[:, None] * turn[list(order)]))
    return sorted(found, key=lambda one: (len(one.mistakes), one.mistakes))


def fit(response: F64, matrix: F64) -> float:
    """Return how well a response (3, 3), one column for each axis along which the tool was moved, is the opposite of
    the movement in a meaning: 1 for exactly. Each column that counts has the same weight."""
    sizes = np.linalg.norm(response, axis=0)
    counts = sizes > WEAK * sizes.max()
    return float(-((response * matrix).sum(axis=0)[counts] / sizes[counts]).mean()) if counts.any() else 0.0


@dataclass(frozen=True, kw_only=True)
class Response:
    """How an answer follows the tool that is moved by ``step`` along each axis of the base, to both sides."""

    step: float
    columns: F64
    """(3, 3) share of the movement that an action answers, a column for each axis; 0 where it does not exceed
    chance."""
    limited: npt.NDArray[np.bool_]
    """(3,) numbers that stand at a limit wherever the tool is."""


class Questions:
    """Asks what the tool's place, its orientation and the orientation of the pictures do to the answer."""

    def __init__(
        self,
        ask: Ask,
        observation: Observation,
        convention: DeltaConvention,
        plain: Sequence[F64],
        *,
        most_calls: float = np.inf,
    ) -> None:
        """
        Args:
            plain: answers (steps, 6) to the unchanged observation.
            most_calls: number of calls after which a tool is moved no further.
        """
        self._ask, self._observation, self._convention = ask, observation, convention
        self._plain = [self._mean(numbers) for numbers in plain]
        self._spread = np.std(self._plain, axis=0) if self._plain else np.zeros(6)
        self._times = 1 if not self._spread.any() else 4
        self.calls = (12 + len(ORIENTATIONS) - 1) * self._times
        """How many calls ``run`` makes if no number stands at a limit."""
        self._spare_calls = most_calls - self.calls

    def run(self, *, region_m: F64 | None, orientation: str) -> Iterator[CheckFinding]:
        known = ""
        for part, name in enumerate(("translation", "rotation")):
            responses = self._responses(part)
            if not responses:
                text = f"the policy, or the check of its {name}, refuses an observation of a tool that is elsewhere"
                found = CheckFinding("hint", "axes", f"{text}: nothing is seen")
            else:
                found = self._axes(name, responses)
            known = found.level if name == "translation" else known
            yield found
        if region_m is None or not any(view.rgb is not None for view in self._observation.cameras.values()):
            return
        if known == "warning":
            text = "not asked, since an answer along wrong axes leads elsewhere however the pictures are turned"
            yield CheckFinding("hint", "orientation", text)
        else:
            yield from self._pictures(region_m, orientation, sure=known == "ok")

    def _mean(self, numbers: F64) -> F64:
        """(6,) mean translation [m] and rotation [rad] of an action."""
        return numbers.mean(axis=0) * np.repeat(self._convention.unit, 3)

    def _answer(self, observation: Observation) -> F64 | None:
        given = [self._ask(observation) for _ in range(self._times)]
        known = [self._mean(numbers) for numbers in given if numbers is not None and len(numbers)]
        return np.mean(known, axis=0) if known else None

    def _responses(self, part: int) -> list[Response]:
        """Responses to a step and, where a number stands at a limit or no meaning fits, to the further ones."""
        found: list[Response] = []
        known = meanings(self._observation.pose_tcp_in_base, self._convention)
        for step in STEPS[part]:
            if found:
                self._spare_calls -= 6 * self._times
                if self._spare_calls < 0:
                    break
            response = self._response(part, step)
            if response is None:
                break
            found.append(response)
            unclear = response.columns.any() and max(fit(response.columns, one.matrix) for one in known) < FITS
            if not response.limited.any() and not unclear:
                break
        return found

    def _response(self, part: int, step: float) -> Response | None:
        chosen, least = slice(3 * part, 3 * part + 3), (SMALLEST_M, SMALLEST_RAD)[part]
        noise = NOISE * float(np.linalg.norm(self._spread[chosen])) / np.sqrt(2 * self._times)
        columns, seen = list[F64](), list[F64]()
        for axis in np.eye(3):
            ends = [self._answer(self._moved(part, sign * step * axis)) for sign in (1, -1)]
            if ends[0] is None or ends[1] is None:
                return None
            seen += [end[chosen] for end in ends if end is not None]
            change = (ends[0] - ends[1])[chosen] / 2
            columns.append(change / step if np.linalg.norm(change) > max(least, noise) else np.zeros(3))
        unit, bound = self._convention.unit[part], self._convention.most[part]
        still = np.ptp(seen, axis=0) < 2 * max(least, noise)
        limited = still & (np.abs(np.mean(seen, axis=0)) > LIMIT * unit * bound)
        return Response(step=step, columns=np.array(columns).T, limited=limited)

    def _moved(self, part: int, by: F64) -> Observation:
        pose = self._observation.pose_tcp_in_base.copy()
        if part == 0:
            pose[:3] += by
        else:
            pose[3:] = quat_from_matrix(matrix_from_vector(by) @ matrix_from_quat(pose[3:]))
        return replace(self._observation, pose_tcp_in_base=pose)

    def _axes(self, name: str, responses: Sequence[Response]) -> CheckFinding:
        known = meanings(self._observation.pose_tcp_in_base, self._convention)
        all_fits = [[fit(response.columns, one.matrix) for one in known] for response in responses]
        # What is seen of most numbers, by the shortest step; a response that fits nothing shows nothing.
        clear = [k for k, fits in enumerate(all_fits) if max(fits) >= FITS] or [0]
        chosen = min(clear, key=lambda k: int(responses[k].limited.sum()))
        response, fits = responses[chosen], all_fits[chosen]
        best = int(np.argmax(np.round(fits, 2)))
        turned = name == "rotation"
        far = f"{response.step:g} rad" if turned else f"{1000 * response.step:g} mm"
        moved = f"{'turned' if turned else 'moved'} in the observation"
        if not response.columns.any():
            text = f"the {name} hardly changes wherever the tool is {moved}: nothing can be learned of its axes"
            return CheckFinding("hint", "axes", text)
        still = [axis for axis, limited in zip(AXES, response.limited, strict=True) if limited]
        unseen = f"; {' and '.join(still)} of the answer never changes, so that nothing is seen of it" if still else ""
        if fits[0] >= FITS:
            share = f"{np.linalg.norm(response.columns, axis=0).max():.0%} of it in an action"
            share = share if chosen == 0 else f"by {far}; by less, a number stays at its limit"
            return CheckFinding("ok", "axes", f"the {name} brings back a tool that is {moved}, {share}{unseen}")
        text = f"where the tool is {moved}, the {name} of the answer does not bring it back"
        if fits[best] >= FITS and fits[0] < MISFITS:
            alike = [
                " and ".join(one.mistakes)
                for one, value in zip(known, fits, strict=True)
                if round(value, 2) == round(fits[best], 2) and len(one.mistakes) == len(known[best].mistakes)
            ]
            text += f" in the declared axes (fit {fits[0]:.2f}), but would if it were meant in {', or in '.join(alike)}"
            text += f" ({fits[best]:.2f}){unseen}; declared: {self._convention.description}"
            return CheckFinding("warning", "axes", text)
        return CheckFinding("hint", "axes", f"{text} (fit {fits[0]:.2f}), nor would it in other axes, order or sign")

    def _pictures(self, region_m: F64, orientation: str, *, sure: bool) -> Iterator[CheckFinding]:
        """``sure``: whether the translation was seen to have the declared axes."""
        way = (region_m - self._observation.pose_tcp_in_base[:3])[:2]
        if np.linalg.norm(way) < NEAREST_M:
            return
        cosines: dict[str, float] = {}
        for name, turn in ORIENTATIONS.items():
            cameras = {
                camera: view if view.rgb is None else replace(view, rgb=np.ascontiguousarray(turn(view.rgb)))
                for camera, view in self._observation.cameras.items()
            }
            cosine = self._toward(replace(self._observation, cameras=cameras), way)
            if cosine is None:
                return
            cosines[combined(name, orientation)] = cosine
        sent, best = cosines[orientation], max(cosines, key=lambda name: cosines[name])
        alike = [name for name, cosine in cosines.items() if cosine > max(TOWARD, cosines[best] - ALIKE)]
        others = " or ".join(name for name in alike if name != orientation)
        if max(cosines.values()) - min(cosines.values()) < ALIKE:
            text = "the answer leads the same way however the pictures are turned: nothing is seen of their orientation"
            yield CheckFinding("hint", "orientation", text)
        elif alike == [orientation]:
            yield CheckFinding("ok", "orientation", f"the answer leads to the named region (cosine {sent:.2f})")
        elif orientation in alike:
            text = (
                f"the answer leads to the named region (cosine {sent:.2f}), but also with pictures {others}: which of "
                "them the policy expects cannot be seen here; compare the sheet with a picture of its training data"
            )
            yield CheckFinding("hint", "orientation", text)
        elif alike:
            text = (
                f"the answer does not lead to the named region as directly (cosine {sent:.2f}) as with pictures "
                f"{others} ({cosines[best]:.2f}); they are sent {orientation}. If the policy was trained on such "
                f"pictures, add {' or '.join(f'orientation={name}' for name in alike)} to the address"
            )
            if not sure:
                text += "; the same is seen if an axis of the translation has the opposite sign"
            yield CheckFinding("warning", "orientation", text)
        else:
            text = f"the answer leads to the named region in no orientation of the pictures (cosine {sent:.2f} as sent)"
            yield CheckFinding("hint", "orientation", text)

    def _toward(self, observation: Observation, way: F64) -> float | None:
        """Cosine of the horizontal angle between an answer's way and the way to the region; 0 without a way."""
        given = [self._ask(observation) for _ in range(self._times)]
        ends = [
            (path_of(numbers, observation.pose_tcp_in_base, self._convention)[-1] - observation.pose_tcp_in_base[:3])[
                :2
            ]
            for numbers in given
            if numbers is not None and len(numbers)
        ]
        if not ends:
            return None
        end = np.mean(ends, axis=0)
        size = float(np.linalg.norm(end) * np.linalg.norm(way))
        return float(end @ way) / size if size > 1e-9 else 0.0


def combined(first: str, second: str) -> str:
    """Return the orientation of pictures that are turned in one way and then in another."""
    mark = np.arange(4, dtype=np.uint8).reshape(2, 2, 1)
    turned = ORIENTATIONS[second](ORIENTATIONS[first](mark))
    return next(name for name, turn in ORIENTATIONS.items() if (turn(mark) == turned).all())
