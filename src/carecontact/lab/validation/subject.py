"""The person under test, scripted motions of the tool, and the scores of a scripted contact."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Protocol as Interface

import numpy as np

from carecontact.errors import SceneError
from carecontact.interface.geometry import Triangles, matrix_from_quat
from carecontact.interface.regions import REGIONS, Tube
from carecontact.lab.validation.result import Array
from carecontact.protocol.person import Tissue
from carecontact.protocol.protocol import Protocol, TrialSpec
from carecontact.recording.provenance import DECLARED
from carecontact.recording.schema import SEGMENTS, Header, Recording
from carecontact.scoring.contact import find_contact
from carecontact.scoring.metrics.force import force_stability, peak_force
from carecontact.scoring.progress import measure_episodes
from carecontact.sim.simulation import Samples, Simulation
from carecontact.world.scene import Scene, build_scene

DOWN = np.array([0.0, 1.0, 0.0, 0.0])
"""quat_wxyz in the robot's base of a tool whose z points to the floor."""
ABOVE_M = 0.5
"""Height above a region's site that is higher than any of the region's skin."""
COMFORT_ARM_DEG = 52.5
"""Angle of the comfort arm: the middle of the protocol's range."""
HOVER_M = 0.020
"""Height of the tool's tip over the skin from which the scripted contacts begin."""
TOUCHED_M = 0.0002
"""Indentation above which the tissue counts as touched."""


def skin_points(simulation: Simulation, region: str) -> Array:
    """Return the vertices (n, 3) [m] of the region's skin in the world now."""
    felt, data = simulation.tissue[region], simulation.data
    return data.xpos[felt.bone] + felt.vertices(data) @ data.xmat[felt.bone].reshape(3, 3).T


def scripted_along_m(scene: Scene, region: str) -> float:
    """Return the place of scripted contacts along the region's axis, from its middle [m]: on every body's limb the same
    place, or the region's middle if that lies nearer to the next joint."""
    row = REGIONS[region]
    if not (isinstance(row.shape, Tube) and row.shape.beside_trunk):
        return row.scripted_along_m
    whole = float(np.linalg.norm(scene.body.axis_vector(row.segment)))
    return max(0.0, row.scripted_along_m - (whole - float(scene.frames[region].size_m[0])) / 2)


def surface_point(simulation: Simulation, region: str, offset: tuple[float, float] = (0.0, 0.0)) -> Array:
    """Return the place (3,) of the skin at the region's place of contact plus a horizontal ``offset`` (along, across)
    [m]. Raises SceneError if the region's shell does not reach there."""
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
    """A contact as a policy might make it: down into the region, back and forth along its axis, and up. The commands
    are the same every time, so that only the person differs between two runs."""

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


def perform(simulation: Simulation, region: str, motion: Motion) -> tuple[list[Samples], Array]:
    """Run a motion that begins above the region; the target follows the skin's slope along the stroke.

    Returns the samples, and the largest inward displacement (p, R) [m] of each region's shell after every target
    period."""
    along, _ = axes(simulation, region)
    reach = max(motion.half_stroke_m, 0.01)
    middle, low, high = (surface_point(simulation, region, (offset, 0.0)) for offset in (0.0, -reach, reach))
    slope = float(high[2] - low[2]) / (2 * reach)
    samples: list[Samples] = []
    indentation: list[Array] = []
    period_s, dt = simulation.protocol.physics.target_period_s, simulation.model.opt.timestep

    def go(distance: float, seconds: float, *, lift: float = 0.0) -> None:
        goal = middle + distance * along + [0, 0, distance * slope - motion.overtravel_m + lift]
        simulation.set_goal(np.r_[in_base(simulation, goal), DOWN], seconds)
        for _ in range(round(seconds / period_s)):
            samples.extend(simulation.advance(round(period_s / dt)))
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
    return samples, np.array(indentation)


class MakeScene(Interface):
    """``build_scene``, or a function that a test puts in its place to plant a defect."""

    def __call__(self, protocol: Protocol, *, target: str | None, skin: bool) -> Scene: ...


class Subject:
    """The person under test, whose scenes are built and settled once. Every simulation that it returns has a model of
    its own, which a check may change."""

    def __init__(self, protocol: Protocol, *, make_scene: MakeScene = build_scene) -> None:
        self.protocol, self.make_scene = protocol, make_scene
        self._scenes: dict[str, Scene] = {}
        self._rest: dict[str, Array] = {}
        self._hover: dict[str, Array] = {}

    def scene(self, region: str) -> Scene:
        """Return the compiled world in which ``region`` is the target; callers must not change it."""
        if region not in self._scenes:
            self._scenes[region] = self.make_scene(self.protocol, target=region, skin=False)
        return self._scenes[region]

    def at_rest(self, region: str) -> Simulation:
        """Return a simulation of the settled person with the robot parked, at t = 0. Raises SettleError if the person
        does not come to rest."""
        if region not in self._rest:
            simulation = self._simulation(region)
            simulation.settle(COMFORT_ARM_DEG)
            self._rest[region] = simulation.integration_state()
        return self._restored(region, self._rest[region])

    def hovering(self, region: str) -> Simulation:
        """Return a simulation of the settled person at t = 0, with the tool at rest HOVER_M over the region's middle
        and pointing down. Raises SceneError if MuJoCo warned on the way there."""
        if region not in self._hover:
            simulation = self.at_rest(region)
            top = surface_point(simulation, region)
            for height, seconds in ((0.10, 3.0), (HOVER_M, 0.8), (HOVER_M, 0.6)):
                move_to(simulation, top + [0, 0, height], seconds=seconds)
            refuse_warnings(simulation, f"while the tool moved over the {region}")
            self._hover[region] = simulation.integration_state()
        return self._restored(region, self._hover[region])

    def regions(self, *, quick: bool = False) -> tuple[str, ...]:
        """Return the soft regions, the only ones that can be pressed and compared; with ``quick``, only the first."""
        return self.protocol.soft_regions[: 1 if quick else None]

    def tissue(self, region: str) -> Tissue:
        """Return the tissue of this body: the protocol's row, adjusted on a body of another build."""
        return self.scene(region).regions[region].tissue

    def with_dt(self, dt_s: float) -> Subject:
        return self.variant(physics=self.protocol.physics.model_copy(update={"dt_s": dt_s}))

    def with_tissue(self, region: str, tissue: Tissue) -> Subject:
        person = self.protocol.person
        return self.variant(person=person.model_copy(update={"tissue": {**person.tissue, region: tissue}}))

    def variant(self, **update: object) -> Subject:
        """Return the person of a changed protocol, built by the same function."""
        return Subject(self.protocol.model_copy(update=update), make_scene=self.make_scene)

    def _simulation(self, region: str) -> Simulation:
        scene = self.scene(region)
        return Simulation(replace(scene, model=copy.copy(scene.model)))

    def _restored(self, region: str, state: Array) -> Simulation:
        simulation = self._simulation(region)
        simulation.restore(state, comfort_arm_deg=COMFORT_ARM_DEG)
        return simulation


def refuse_warnings(simulation: Simulation, when: str) -> None:
    if warnings := simulation.solver_warnings():
        raise SceneError(f"MuJoCo warned {when}: {', '.join(warnings)}")


@dataclass(frozen=True, kw_only=True)
class Scores:
    """The scorer's C1, C5 and stroke of a scripted contact, so that the checks judge the numbers that are reported."""

    c1_n: float
    c1_filtered_n: float
    c5_n: float
    stroke_m: float
    beyond_measured: float
    """Share of the time in the tissue that was spent deeper than the reference measurements."""


def scores_of(simulation: Simulation, region: str, samples: list[Samples], indentation_m: Array) -> Scores:
    """Return the scores of a performance: all NaN if the region was not touched; the filtered peak is NaN if the time
    step is too long for the filter. Raises SceneError if MuJoCo warned on the way."""
    dt, cutoff = simulation.model.opt.timestep, simulation.protocol.contact.peak_filter_hz
    refuse_warnings(simulation, f"in a scripted contact at a time step of {1000 * dt:g} ms")
    contact = find_contact(recording_of(simulation, region, samples))
    spread = force_stability(contact)
    if spread is None or contact.reported != contact.target:
        return Scores(**dict.fromkeys((field.name for field in fields(Scores)), np.nan))
    # The scorer's filter needs a sample rate of more than twice its cutoff.
    peak = peak_force(contact) if 2 * cutoff * dt < 1 else None
    depth = indentation_m[:, simulation.protocol.regions.index(region)]
    measured = simulation.scene.regions[region].tissue.measured_depth_m
    return Scores(
        c1_n=float(contact.force_in_window.max()),
        c1_filtered_n=np.nan if peak is None else peak["c1_peak_filtered_n"],
        c5_n=spread,
        stroke_m=sum(episode.stroke_m for episode in measure_episodes(contact)),
        beyond_measured=float((depth > measured).sum() / max(1, (depth > TOUCHED_M).sum())),
    )


def motion_scores(subject: Subject, region: str, motion: Motion) -> Scores:
    simulation = subject.hovering(region)
    return scores_of(simulation, region, *perform(simulation, region, motion))


def _with_task_on(protocol: Protocol, region: str) -> Protocol:
    """Return the protocol with a task on the region, because the scorer finds a trial's region by its task."""
    if any(task.region == region for task in protocol.tasks):
        return protocol
    task = protocol.tasks[0].model_copy(update={"id": "scripted", "region": region})
    contact = protocol.contact
    near = {region: list(REGIONS[region].neighbourhood), **contact.neighbourhood}
    return protocol.model_copy(
        update={"tasks": [*protocol.tasks, task], "contact": contact.model_copy(update={"neighbourhood": near})}
    )


def recording_of(simulation: Simulation, region: str, samples: Sequence[Samples]) -> Recording:
    """Return a recording of a scripted contact, with as much as the scorer reads."""
    protocol = _with_task_on(simulation.protocol, region)
    task_id = next(task.id for task in protocol.tasks if task.region == region)
    spec = TrialSpec(protocol=protocol, task_id=task_id, seed=0, policy="scripted")
    header = Header(
        spec=spec, ended="done", failure=None, card=None, embodiment="", comfort_arm_deg=None, segments=list(SEGMENTS),
        regions=list(protocol.regions), human_joints=simulation.joint_names,
        pose_base_in_world=simulation.pose_base_in_world.tolist(), identity=DECLARED, versions={}, sha256={},
        solver_warnings=[],
    )  # fmt: skip
    arrays = {f"scorer/{name}": np.concatenate([getattr(s, of) for s in samples]) for name, of in STREAMS.items()}
    still = {
        "scorer/human_joint_range": simulation.joint_range,
        "scorer/human_joint_settled": samples[0].human_joint[0],
        "scorer/region_size_m": simulation.scene.region_size_m,
    }
    return Recording.trusted(header, arrays | still)


STREAMS = {
    "time_s": "time_s",
    "force_human_from_robot_in_world": "force",
    "normal_force": "normal",
    "human_joint_position": "human_joint",
    "tcp_speed": "tcp_speed",
    "tcp_rotation_speed": "tcp_rotation_speed",
    "pose_tcp_in_world": "tcp_pose",
    "region_pose_in_world": "region_pose",
}
"""The scorer's streams that a scripted contact has -> their names in ``Samples``."""


def force_norm(samples: Sequence[Samples], region_segment: str) -> np.ndarray:
    """Return the magnitude (n,) [N] of the robot's force on one segment at every step."""
    column = SEGMENTS.index(region_segment)
    return np.linalg.norm(np.concatenate([s.force[:, column] for s in samples]), axis=1)
