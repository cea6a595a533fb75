"""What the deltas of an answer do: arrows in the pictures that are sent, and questions that show wrong axes, a wrong
order of the rotation, and pictures that are turned in another way than the policy knows them.

A question moves the tool in the observation and looks how the answer follows. A policy that brings the tool somewhere
answers the opposite of the movement, along the axes in which it means its numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw

from carecontact.interface.deltas import DeltaConvention
from carecontact.interface.geometry import matrix_from_quat, matrix_from_vector, pixels, quat_from_matrix
from carecontact.interface.observation import CameraView, Observation
from carecontact.running.check_answers import CheckFinding
from carecontact.serving.cartesian import ORIENTATIONS

F64 = npt.NDArray[np.float64]
Ask = Callable[[Observation], F64 | None]
"""Observation -> numbers (steps, 6) of the executed actions, or None if the policy refused."""

ARROW_M = 0.1
COLOURS = ((230, 30, 30), (20, 160, 40), (40, 80, 235))
PATH = (200, 0, 200)
"""Colours of +x, +y and +z of an answer, and of the way that the whole answer gives."""
LEGEND = "red, green, blue: +x, +y, +z of an answer, 100 mm; violet: where this answer goes"
STEP_M, STEP_RAD = 0.03, 0.2
"""How far the tool is moved and turned in a question."""
NOISE = 4.0
"""A response counts if it is so many times as large as repeats differ. Of 300 simulated policies with random answers
that follow nothing, one got a warning (5 of them at a factor of 3), and none of those that follow went unseen."""
SMALLEST = 0.01
"""Least share of a movement that an action must answer to count."""
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
AXES = "xyz"


def path_of(numbers: F64, pose: F64, convention: DeltaConvention) -> F64:
    """Return the positions (steps + 1, 3) [m] in base of a tool at a pose (7,) that follows numbers (steps, 6)."""
    places = [pose[:3]]
    for row in numbers:
        pose = convention.target(convention.clipped(row), measured=pose, last=pose)
        places.append(pose[:3])
    return np.array(places)


def drawn(observation: Observation, numbers: F64, convention: DeltaConvention) -> Observation:
    """Return the observation with arrows in every colour picture, so that the way to the policy turns, cuts and resizes
    them as it does the pictures."""
    pose = observation.pose_tcp_in_base
    lines: list[tuple[F64, tuple[int, int, int]]] = [(path_of(numbers, pose, convention), PATH)]
    for axis, colour in enumerate(COLOURS):
        unit = np.zeros(6)
        unit[axis] = ARROW_M / convention.unit[0]
        tip = convention.target(unit, measured=pose, last=pose)[:3]
        lines.append((np.array([pose[:3], tip]), colour))
    return replace(observation, cameras={name: _with(view, lines) for name, view in observation.cameras.items()})


def _with(view: CameraView, lines: Sequence[tuple[F64, tuple[int, int, int]]]) -> CameraView:
    if view.rgb is None:
        return view
    picture, width = Image.fromarray(view.rgb), max(2, view.rgb.shape[1] // 160)
    draw = ImageDraw.Draw(picture)
    camera = view.pose_camera_in_base
    for points, colour in lines:
        if (((points - camera[:3, 3]) @ camera[:3, 2]) < width * 1e-3).any():
            continue  # Behind the camera.
        place = [tuple(uv) for uv in pixels(points, view.intrinsics, camera).tolist()]
        draw.line(place, fill=colour, width=width)
        (u, v), end = place[-1], 2 * width
        draw.ellipse((u - end, v - end, u + end, v + end), fill=colour)
    return replace(view, rgb=np.asarray(picture))


def look_at_deltas(numbers: F64, convention: DeltaConvention, tool: F64) -> Iterator[CheckFinding]:
    """Yield warnings about the numbers (steps, 6) of an answer as they came; ``tool``: its pose (7,)."""
    largest, bounds = np.abs(numbers).max(axis=0), convention.bounds
    where = ("translation", "rotation")
    for part, name in zip((slice(3), slice(3, 6)), where, strict=True):
        if (largest[part] > 1.2 * bounds[part]).any():
            share = (np.abs(numbers[:, part]) > bounds[part]).any(axis=1).mean()
            text = (
                f"{share:.0%} of the steps have a {name} beyond {bounds[part][0]:g}, up to {largest[part].max():.3g}, "
                f"which is moved onto this bound: {convention.description}"
            )
            if name == "translation" and np.linalg.norm(numbers[:, :3] - tool[:3], axis=1).max() < STEP_M:
                text += " The numbers look like absolute positions of the tool."
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

    name: str
    matrix: F64
    """(3, 3) from a vector in base to the numbers, up to scale."""


def meanings(tool: F64, convention: DeltaConvention) -> list[Meaning]:
    """Return the declared meaning first, then the mistakes that are looked for. ``tool``: its pose (7,)."""
    to_tool, other = matrix_from_quat(tool[3:]).T, "tool" if convention.frame == "base" else "base"
    frames = {convention.frame: np.eye(3), other: to_tool} if other == "tool" else {"tool": to_tool, "base": np.eye(3)}
    found: list[Meaning] = []
    for (frame, turn), order, sign in product(frames.items(), permutations(range(3)), (1, -1)):
        said = [f"the axes of the {frame}"] if frame != convention.frame else []
        said += [f"the order {' '.join(AXES[k] for k in order)}"] if order != (0, 1, 2) else []
        said += ["the opposite sign"] if sign < 0 else []
        found.append(Meaning(" and ".join(said), sign * turn[list(order)]))
    # The fewer mistakes, the more likely.
    return sorted(found, key=lambda one: (one.name != "", one.name.count(" and "), one.name))


def fit(response: F64, matrix: F64) -> float:
    """Return how well a response (3, 3), one column for each axis along which the tool was moved, is the opposite of
    the movement in a meaning: 1 for exactly, weighted by the size of the columns."""
    sizes = np.linalg.norm(response, axis=0)
    return float(-(response * matrix).sum() / sizes.sum()) if sizes.any() else 0.0


class Questions:
    """Asks what the tool's place, its orientation and the orientation of the pictures do to the answer."""

    def __init__(self, ask: Ask, observation: Observation, convention: DeltaConvention, plain: Sequence[F64]) -> None:
        """``plain``: answers (steps, 6) to the unchanged observation."""
        self._ask, self._observation, self._convention = ask, observation, convention
        self._plain = [self._mean(numbers) for numbers in plain]
        self._spread = np.std(self._plain, axis=0) if self._plain else np.zeros(6)
        self._times = 1 if not self._spread.any() else 4
        self.calls = (12 + len(ORIENTATIONS) - 1) * self._times
        """How many calls ``run`` makes at most."""

    def run(self, *, region_m: F64 | None, orientation: str) -> Iterator[CheckFinding]:
        """Yield what is found.

        Args:
            region_m: (3,) middle of the region that the instruction names, in base; None: pictures are not asked about.
            orientation: name in ORIENTATIONS in which the pictures are sent.
        """
        for part, name in enumerate(("translation", "rotation")):
            response = self._response(part)
            if response is None:
                text = f"the policy, or the check of its {name}, refuses an observation of a tool that is elsewhere"
                yield CheckFinding("hint", "axes", f"{text}: nothing is seen")
            else:
                yield self._axes(name, response)
        if region_m is not None and any(view.rgb is not None for view in self._observation.cameras.values()):
            yield from self._pictures(region_m, orientation)

    def _mean(self, numbers: F64) -> F64:
        """(6,) mean translation [m] and rotation [rad] of an action."""
        return numbers.mean(axis=0) * np.repeat(self._convention.unit, 3)

    def _answer(self, observation: Observation) -> F64 | None:
        """Mean (6,) of the repeats."""
        given = [self._ask(observation) for _ in range(self._times)]
        known = [self._mean(numbers) for numbers in given if numbers is not None and len(numbers)]
        return np.mean(known, axis=0) if known else None

    def _response(self, part: int) -> F64 | None:
        """(3, 3) share of a movement along each axis of the base that an action answers; columns that are no larger
        than chance are 0. None if the policy refused."""
        columns, step, chosen = [], (STEP_M, STEP_RAD)[part], slice(3 * part, 3 * part + 3)
        for axis in np.eye(3):
            ends = [self._answer(self._moved(part, sign * step * axis)) for sign in (1, -1)]
            if ends[0] is None or ends[1] is None:
                return None
            share = (ends[0] - ends[1])[chosen] / (2 * step)
            noise = NOISE * float(np.linalg.norm(self._spread[chosen])) / (step * np.sqrt(2 * self._times))
            columns.append(share if np.linalg.norm(share) > max(SMALLEST, noise) else np.zeros(3))
        return np.array(columns).T

    def _moved(self, part: int, by: F64) -> Observation:
        pose = self._observation.pose_tcp_in_base.copy()
        if part == 0:
            pose[:3] += by
        else:
            pose[3:] = quat_from_matrix(matrix_from_vector(by) @ matrix_from_quat(pose[3:]))
        return replace(self._observation, pose_tcp_in_base=pose)

    def _axes(self, name: str, response: F64) -> CheckFinding:
        known = meanings(self._observation.pose_tcp_in_base, self._convention)
        fits = [fit(response, one.matrix) for one in known]
        best = int(np.argmax(np.round(fits, 2)))
        moved = "turned" if name == "rotation" else "moved"
        if not response.any():
            text = (
                f"the {name} does not follow the tool where it is {moved} in the observation, so nothing is seen of it"
            )
            return CheckFinding("hint", "axes", text)
        share = f"{np.linalg.norm(response, axis=0).max():.0%} of it in an action"
        if fits[0] >= FITS:
            return CheckFinding(
                "ok", "axes", f"the {name} brings back a tool that is {moved} in the observation, {share}"
            )
        text = f"where the tool is {moved} in the observation, the {name} of the answer does not bring it back"
        if fits[best] >= FITS and fits[0] < MISFITS:
            text += f" in the declared axes (fit {fits[0]:.2f}), but would if it were meant in {known[best].name}"
            text += f" ({fits[best]:.2f}); declared: {self._convention.description}"
            return CheckFinding("warning", "axes", text)
        return CheckFinding("hint", "axes", f"{text} (fit {fits[0]:.2f}), nor would it in other axes, order or sign")

    def _pictures(self, region_m: F64, orientation: str) -> Iterator[CheckFinding]:
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
        if max(cosines.values()) - min(cosines.values()) < ALIKE:
            text = "the answer leads the same way however the pictures are turned: nothing is seen of their orientation"
            yield CheckFinding("hint", "orientation", text)
        elif sent > max(TOWARD, cosines[best] - ALIKE):
            yield CheckFinding("ok", "orientation", f"the answer leads to the named region (cosine {sent:.2f})")
        elif cosines[best] > TOWARD:
            alike = [name for name, cosine in cosines.items() if cosine > max(TOWARD, cosines[best] - ALIKE)]
            text = (
                f"the answer does not lead to the named region as directly (cosine {sent:.2f}) as with pictures "
                f"{' or '.join(alike)} ({cosines[best]:.2f}); they are sent {orientation}. If the policy knows them "
                f"so, add orientation={best} to the address"
            )
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
