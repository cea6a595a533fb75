"""Check 1: one press, its force measured by four paths that share no arithmetic."""

from __future__ import annotations

from typing import Any

import numpy as np

from carecontact.errors import SceneError
from carecontact.interface.regions import REGIONS
from carecontact.lab.validation.result import Array, CheckResult, Figure, Measure, measured
from carecontact.lab.validation.rig import AnchorForce, bed_reaction, moment_on_bone, tip_force, touches_hard_parts
from carecontact.lab.validation.subject import Subject, move_to, surface_point
from carecontact.recording.schema import SEGMENTS
from carecontact.sim.simulation import Samples, Simulation

TITLE = "Force balance by independent paths"
RANGE_M = (0.003, 0.008)
LEVELS_M, QUICK_LEVELS_M = (0.0033, 0.0046, 0.0059, 0.0072), (0.0035, 0.0070)
"""Depths at which the tool stops and the forces are read."""
SPEED_M_S = 0.004
"""Speed between two levels; at a level the tool rests."""
REST_M_S, LONGEST_REST_S, READ_S = 2e-5, 6.0, 0.06
"""The tool counts as at rest below this speed; the longest wait for it; and the time of reading. The elbow creeps on
after the tool has stopped: at 1e-4 m/s, its deceleration was 0.015 N in the joint torques of an arm high above the
abdomen."""
STIFFNESS = (1000.0, 20.0)
"""Translational [N/m] and rotational [N m/rad] stiffness: a stiffer robot needs less lead of the target over the
tool."""
GRAVITY_M_S2 = 9.81
LEVER_MM = 1.0
"""An error of 1 % of the force, as of the other lines, at a lever of 100 mm, which is about that of the middle of the
forearm about the elbow."""
LONGEST_PRESS_S = 10.0
PATHS, MOMENTS = ("contact", "anchors", "joint torques", "bed"), ("moment", "anchors' moment")


def run(subject: Subject, *, quick: bool) -> CheckResult:
    measures: list[Measure] = []
    curves: dict[str, Array] = {}
    for region in subject.regions(quick=quick):
        rows, weight = press_in_levels(subject.hovering(region), region, QUICK_LEVELS_M if quick else LEVELS_M)
        wanted_weight = subject.scene(region).body.mass_kg * GRAVITY_M_S2
        size, deep = np.linalg.norm(rows["contact"], axis=1), rows["indentation"]
        gap = {path: 100 * (np.linalg.norm(rows[path] - rows["contact"], axis=1) / size) for path in PATHS[1:]}
        held = 100 * (np.linalg.norm(rows["held"], axis=1) / size).max()
        lever = 1000 * (np.linalg.norm(rows["moment"] - rows["anchors' moment"], axis=1) / size).max()
        outside = (deep < RANGE_M[0]) | (deep > RANGE_M[1]) | (rows["hard"] > 0)
        before, moment = 100 * abs(weight / wanted_weight - 1), "moment on the bone against the anchors' moment"
        measures += [
            measured(f"{region}: contact against anchors", gap["anchors"].max(), "%", at_most=1.0),
            measured(f"{region}: contact against robot joint torques", gap["joint torques"].max(), "%", at_most=2.0),
            measured(f"{region}: held by skin too far from the tool to move", held, "%"),
            measured(f"{region}: {moment}, over the force", lever, "mm", at_most=LEVER_MM),
            measured(f"{region}: bed reaction against weight and press", gap["bed"].max(), "%", at_most=1.0),
            measured(f"{region}: bed against weight before the press", before, "%", at_most=1.0),
            measured(f"{region}: tool speed at the readings", 1000 * rows["speed"].max(), "mm/s", below=0.1),
            measured(f"{region}: readings out of range or on hard parts", outside.sum(), at_most=0.0),
            measured(f"{region}: largest force", size.max(), "N"),
        ]
        curves[f"{region}/indentation"] = deep
        curves |= {f"{region}/{path}": np.linalg.norm(rows[path], axis=1) for path in PATHS}
        curves |= {f"{region}/gap {path}": gap[path] for path in PATHS[1:]}
    return CheckResult(check="force-balance", title=TITLE, measures=tuple(measures), curves=curves)


def press_in_levels(simulation: Simulation, region: str, levels_m: tuple[float, ...]) -> tuple[dict[str, Array], float]:
    """Press down at the region's middle and stop at each level of indentation.

    Returns one row per level, n of them, and the bed's upward force before [N]. Rows: indentation (n,) [m], speed (n,)
    of the tool [m/s], held (n, 3) force at the edge of the skin that moves [N], hard (n,) how often the tool met
    something rigid, moment (n, 3) on the bone about its origin and anchors' moment (n, 3) [N m], and for
    each of PATHS the force that the robot exerts on the person (n, 3) [N], with its value before the press subtracted.
    Raises SceneError if a level is not reached.
    """
    column = SEGMENTS.index(REGIONS[region].segment)
    index = simulation.protocol.regions.index(region)
    anchors = AnchorForce(simulation, region)
    period = simulation.protocol.physics.target_period_s
    simulation.set_stiffness(*STIFFNESS)
    top = surface_point(simulation, region)
    height, tangent, last = float(top[2]) + 0.002, 0.0, (0.0, 0.0)
    move_to(simulation, np.array([*top[:2], height]), seconds=0.6)

    def go(speed: float) -> Samples:
        nonlocal height
        # A spring lies between target and tool, so that the target leads by what the tissue's stiffness requires.
        height -= speed * period * (1.0 + tangent / STIFFNESS[0])
        return move_to(simulation, np.array([*top[:2], height]), seconds=period)[-1]

    def read() -> tuple[Array, Array, float, int]:
        """Return the forces (4, 3) [N] by path, the moments (2, 3) [N m] on the bone and of the anchors, the tool's
        largest speed [m/s] and the number of contacts with hard parts, once the tool rests.

        They are read at every step of whole target periods, within which the posture torque lets the tip swing."""
        for _ in range(round(LONGEST_REST_S / period)):
            if go(0.0).tcp_speed.max() < REST_M_S:
                break
        forces, moments, speed, hard = [], [], 0.0, 0
        for _ in range(round(READ_S / simulation.model.opt.timestep)):
            samples = simulation.advance(1)[-1]
            forces.append([samples.force[-1, column], anchors(), tip_force(simulation), -bed_reaction(simulation)])
            moments.append([moment_on_bone(simulation, region), anchors.wrench()[1]])
            speed = max(speed, float(samples.tcp_speed.max()))
            hard += touches_hard_parts(simulation)
        return np.mean(forces, axis=0), np.mean(moments, axis=0), speed, hard

    before = read()[0]
    rows: list[dict[str, Any]] = []
    for level in levels_m:
        began = simulation.time_s
        while (depth := float(simulation.indentation()[index])) < level:
            if simulation.time_s > began + LONGEST_PRESS_S:
                raise SceneError(f"{region}: the press came {1000 * depth:.1f} mm deep, {1000 * level:.1f} mm wanted")
            force = float(np.linalg.norm(go(SPEED_M_S).force[-1, column]))
            if depth - last[0] > 2e-4:
                tangent = float(np.clip((force - last[1]) / (depth - last[0]), 0.0, 8000.0))
                last = (depth, force)
        forces, moments, speed, hard = read()
        depth, paths = float(simulation.indentation()[index]), zip(PATHS, forces - before, strict=True)
        row = {"indentation": depth, "speed": speed, "held": anchors.wrench(moving=False)[0], "hard": hard}
        rows.append({**row, **dict(paths), **dict(zip(MOMENTS, moments, strict=True))})
    arrays = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return arrays, -float(before[PATHS.index("bed"), 2])


def draw(result: CheckResult, figure: Figure) -> None:
    regions = result.regions("indentation")
    figure.set_size_inches(2.4 * len(regions) + 0.6, 3.6)
    axes = figure.subplots(2, len(regions), squeeze=False, sharex="col", sharey="row", height_ratios=[3, 2])
    markers = {"contact": "o", "anchors": "s", "joint torques": "^", "bed": "D"}
    for region, (above, below) in zip(regions, axes.T, strict=True):
        depth = 1000 * result.curves[f"{region}/indentation"]
        for number, (path, marker) in enumerate(markers.items()):
            above.plot(depth, result.curves[f"{region}/{path}"], marker, ms=9 - 2 * number, mfc="none", label=path)
            if path != "contact":
                gap, colour = np.maximum(result.curves[f"{region}/gap {path}"], 1e-4), above.lines[-1].get_color()
                below.plot(depth, gap, marker + "-", ms=4, mfc="none", color=colour)
        for limit, style in ((1.0, "--"), (2.0, ":")):
            below.axhline(limit, color="0.4", lw=0.8, ls=style)
        below.set(xlabel="deepest anchor [mm]", yscale="log")
        above.set_ylim(0, None)
        above.set_title(region.replace("_", " "))
    axes[0, 0].set_ylabel("force [N]")
    axes[1, 0].set_ylabel("off contact [%]\n(lines: 1 %; torques 2 %)")
    axes[0, 0].legend()
