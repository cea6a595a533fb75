"""Scripted motions of the tool: the same command every time, so that only the person differs between two runs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carecontact.contract.geometry import matrix_from_quat
from carecontact.contract.rays import Triangles
from carecontact.regions import REGIONS, Tube
from carecontact.sim.simulation import Samples, Simulation
from carecontact.validation.result import Array
from carecontact.world.scene import Scene

DOWN = np.array([0.0, 1.0, 0.0, 0.0])
"""quat_wxyz in the robot's base of a tool whose z points to the floor."""


ABOVE_M = 0.5
"""Height above a region's site that is higher than any of the region's skin."""


def skin_points(simulation: Simulation, region: str) -> Array:
    """Return the vertices (n, 3) [m] of the region's skin in the world now."""
    felt, data = simulation.tissue[region], simulation.data
    return data.xpos[felt.bone] + felt.vertices(data) @ data.xmat[felt.bone].reshape(3, 3).T


def scripted_along_m(scene: Scene, region: str) -> float:
    """Return the place of scripted contacts along the region's axis, from its middle [m].

    It is the same place on every body's limb, or the region's middle if that lies nearer to the next joint.
    """
    row = REGIONS[region]
    if not (isinstance(row.shape, Tube) and row.shape.beside_trunk):
        return row.scripted_along_m
    whole = float(np.linalg.norm(scene.body.axis_vector(row.segment)))
    return max(0.0, row.scripted_along_m - (whole - float(scene.frames[region].size_m[0])) / 2)


def surface_point(simulation: Simulation, region: str, offset: tuple[float, float] = (0.0, 0.0)) -> Array:
    """Return the place (3,) of the skin at the region's place of contact plus a horizontal ``offset`` (along, across)
    [m].

    Raises SceneError if the region's shell does not reach there.
    """
    along, across = axes(simulation, region)
    corners = skin_points(simulation, region)[simulation.scene.regions[region].shell.triangles]
    middle = simulation.data.site(f"region_{region}").xpos
    forward = scripted_along_m(simulation.scene, region) + offset[0]
    above = middle + forward * along + offset[1] * across + [0, 0, ABOVE_M]
    down = np.array([0.0, 0.0, -1.0])
    return above + float(Triangles(corners).first_hits(above[None], down[None])[0]) * down


def axes(simulation: Simulation, region: str) -> tuple[Array, Array]:
    """Return horizontal unit vectors (3,) along the region's axis and across it."""
    along = simulation.data.site(f"region_{region}").xmat.reshape(3, 3)[:, 0].copy()
    along[2] = 0.0
    along /= np.linalg.norm(along)
    return along, np.cross([0.0, 0.0, 1.0], along)


def in_base(simulation: Simulation, position_in_world: Array) -> Array:
    base = simulation.pose_base_in_world
    return matrix_from_quat(base[3:]).T @ (np.asarray(position_in_world) - base[:3])


def move_to(simulation: Simulation, position_in_world: Array, *, seconds: float) -> list[Samples]:
    """Move the impedance's target, pointing down, to a point in the world, and simulate until it has arrived."""
    simulation.set_goal(np.r_[in_base(simulation, position_in_world), DOWN], seconds)
    return simulation.advance(round(seconds / simulation.model.opt.timestep))


@dataclass(frozen=True, kw_only=True)
class Motion:
    """A contact as a policy might make it: down into the region, back and forth along its axis, and up."""

    name: str
    overtravel_m: float
    """Depth of the target under the skin; the impedance gives the force."""
    half_stroke_m: float = 0.0
    strokes: int = 0
    speed_m_s: float = 0.10
    pause_s: float = 0.0
    """Rest at each end of a stroke."""
    hold_s: float = 0.4


PRESS = Motion(name="press", overtravel_m=0.025, hold_s=0.8)
SCRUB = Motion(name="scrub", overtravel_m=0.020, half_stroke_m=0.040, strokes=2)


@dataclass(frozen=True, kw_only=True)
class Performance:
    samples: list[Samples]
    indentation_m: Array
    """(p, R) largest inward displacement of each region's shell after every target period."""


def perform(simulation: Simulation, region: str, motion: Motion) -> Performance:
    """Run a motion that begins above the region; the target follows the skin's slope along the stroke."""
    along, _ = axes(simulation, region)
    reach = max(motion.half_stroke_m, 0.01)
    middle, low, high = (surface_point(simulation, region, (offset, 0.0)) for offset in (0.0, -reach, reach))
    slope = float(high[2] - low[2]) / (2 * reach)
    samples: list[Samples] = []
    indentation: list[Array] = []

    def go(distance: float, seconds: float, *, lift: float = 0.0) -> None:
        goal = middle + distance * along + [0, 0, distance * slope - motion.overtravel_m + lift]
        simulation.set_goal(np.r_[in_base(simulation, goal), DOWN], seconds)
        period = round(simulation.protocol.physics.target_period_s / simulation.model.opt.timestep)
        for _ in range(round(seconds / simulation.protocol.physics.target_period_s)):
            samples.extend(simulation.advance(period))
            indentation.append(simulation.indentation())

    go(0.0, 0.8)
    go(0.0, motion.hold_s)
    place = 0.0
    for stroke in range(motion.strokes):
        goal = motion.half_stroke_m * (1 if stroke % 2 == 0 else -1)
        go(goal, abs(goal - place) / motion.speed_m_s)
        if motion.pause_s:
            go(goal, motion.pause_s)
        place = goal
    if place:
        go(0.0, abs(place) / motion.speed_m_s)
    go(0.0, 0.6, lift=motion.overtravel_m + 0.02)
    return Performance(samples=samples, indentation_m=np.array(indentation))
