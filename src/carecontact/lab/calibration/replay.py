"""Replays measured trials on the tissue bench, with the same indenter, place, direction, speed, depth and touch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from carecontact.human.body import Body
from carecontact.lab.calibration.curve import GRID, Curve, despiked
from carecontact.lab.calibration.trial import Array, Condition
from carecontact.protocol.person import Tissue
from carecontact.sim.bench import APPROACH_M, Bench, Indenter, Press, touch_depth
from carecontact.world.scene import region_shell

DEPTH_CLASS = 0.06
"""Trials of one condition share a replay if their deepest points differ by less than this share."""
REACH = 1.0001
"""A replay counts as reaching depths up to this share of its deepest point."""
TURN_TOLERANCE_M = 5e-5
"""Largest error of the depth past its own touch at which a replay turns round."""
TIME_STEP_S = 0.002
"""Physics step of the bench, which is that of the scene. Half of it changes forces by less than 0.4 % of the peak, and
the work lost by at most 2.5 %."""


@dataclass(frozen=True, kw_only=True)
class Group:
    condition: Condition
    members: tuple[int, ...]
    """Indices of curves"""
    path_s: Array
    """(p,) time and"""
    path_m: Array
    """(p,) depth past touch of the member of median depth: the path that the indenter takes in the replay"""
    deepest_m: float
    """Deepest point of that path."""
    touch_force_n: float
    unloads: bool


@dataclass(frozen=True, kw_only=True)
class Replayed:
    """One simulated press on its group's grid of depths; nan where the group has no loading or unloading."""

    press: Press
    loading_n: Array
    unloading_n: Array


def group_curves(curves: Sequence[Curve]) -> tuple[Group, ...]:
    """Group trials of the same condition and of nearly the same depth and duration, in a fixed order."""
    keyed: dict[tuple[Condition, bool, int], list[int]] = {}
    for index, curve in enumerate(curves):
        held = curve.trial.time_s[curve.trial.phase == 1]
        hold = round(10 * float(np.ptp(held))) if len(held) else 0
        keyed.setdefault((curve.trial.condition, curve.trial.unloads, hold), []).append(index)
    groups = []
    for (condition, unloads, _), members in keyed.items():
        order = sorted(members, key=lambda k: curves[k].deepest_m)
        while order:
            limit = curves[order[0]].deepest_m * (1 + DEPTH_CLASS)
            inside = [k for k in order if curves[k].deepest_m <= limit]
            order = order[len(inside) :]
            middle = curves[inside[len(inside) // 2]]
            group = Group(
                condition=condition,
                members=tuple(sorted(inside)),
                path_s=middle.path_s,
                path_m=middle.path_m,
                deepest_m=float(middle.path_m.max()),
                touch_force_n=float(np.mean([curves[k].touch_force_n for k in inside])),
                unloads=unloads,
            )
            groups.append(group)
    return tuple(groups)


class Replay:
    """Replays all groups on benches that are compiled once, one for each indenter."""

    def __init__(self, *, body: Body, region: str, tissue: Tissue, groups: Sequence[Group]) -> None:
        self.groups, self.tissue, self.body, self.region = tuple(groups), tissue, body, region
        shell = region_shell(body, region, tissue)
        self.benches: dict[tuple[str, float | None], Bench] = {}
        for group in groups:
            shape, size_m = key = _indenter_key(group.condition)
            indenter = Indenter(shape=shape, size_m=size_m)  # type: ignore[arg-type]
            if key not in self.benches:
                self.benches[key] = Bench(
                    body=body, region=region, tissue=tissue, shell=shell, indenter=indenter, dt_s=TIME_STEP_S
                )
        self.forget()

    def bench_of(self, group: Group) -> Bench:
        return self.benches[_indenter_key(group.condition)]

    def forget(self) -> None:
        """Let the next run begin as in a new Replay, so that its result does not depend on earlier runs."""
        self._zero = [0.0] * len(self.groups)

    def run(self, tissue: Tissue, only: Sequence[int] | None = None) -> list[Replayed | None]:
        """Simulate one press for each group under this law; None for groups that are not in ``only``."""
        for bench in self.benches.values():
            bench.set_law(tissue)
        wanted = range(len(self.groups)) if only is None else only
        return [self._run(k) if k in wanted else None for k in range(len(self.groups))]

    def _run(self, number: int) -> Replayed:
        group, bench = self.groups[number], self.bench_of(self.groups[number])
        c = group.condition
        # Touch depends on the law, and the turning point on touch: start from the last result, and repeat if it has
        # moved.
        stride = max(1, round(np.ptp(group.path_s) / 300 / bench.model.opt.timestep))
        at = {"along_m": c.along_m, "across_m": c.across_m, "tilt_deg": c.tilt_deg}
        for _ in range(6):
            guess = self._zero[number]
            press = bench.follow(*_from_outside(group.path_s, group.path_m + guess), stride=stride, **at)
            turn = int(press.indentation_m.argmax())
            depth, force = press.indentation_m, despiked(press.force_n)
            self._zero[number] = touch_depth(depth[: turn + 1], force[: turn + 1], group.touch_force_n)
            if abs(self._zero[number] - guess) < TURN_TOLERANCE_M:
                break
        zero = self._zero[number]
        grid = GRID * group.deepest_m
        loading, unloading = np.interp(grid, depth[: turn + 1] - zero, force[: turn + 1]), np.full(len(GRID), np.nan)
        if group.unloads:
            unloading = np.interp(grid, (depth[turn:] - zero)[::-1], force[turn:][::-1])
        return Replayed(press=press, loading_n=loading, unloading_n=unloading)


def on_trial(replayed: Replayed, group: Group, curve: Curve) -> tuple[Array, Array]:
    """Return simulated loading and unloading forces on one trial's own grid; nan deeper than the replay reached."""
    grid = np.where(curve.grid_m <= group.deepest_m * REACH, curve.grid_m, np.nan)
    depth = GRID * group.deepest_m
    return np.interp(grid, depth, replayed.loading_n), np.interp(grid, depth, replayed.unloading_n)


def _from_outside(time: Array, depth: Array) -> tuple[Array, Array]:
    """Return the path from a little outside the skin, at the speed of first touch, without a wait before touch."""
    inside = int(np.argmax(depth > 0.0))
    slow = max(inside, 5)
    speed = max((depth[slow] - depth[slow - 5]) / (time[slow] - time[slow - 5]), 1e-4)
    lead = (depth[inside] + APPROACH_M) / speed
    return np.r_[time[inside] - lead, time[inside:]], np.r_[-APPROACH_M, depth[inside:]]


def _indenter_key(condition: Condition) -> tuple[str, float | None]:
    return condition.indenter_shape, condition.indenter_size_m
