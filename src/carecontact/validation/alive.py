"""A person who moves by itself: the breath that cameras see and a tool feels, the way of the arm, the same run again.

The person of the protocol is given a breath and a movement of the arm of known sizes, whatever the protocol asks for.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from carecontact.contract.embodiment import PANDA
from carecontact.contract.protocol import Alive, Breathing, Repositioning
from carecontact.kernel.life import JOINTS, PARTS, Doings, Life, Move, breath
from carecontact.regions import REGIONS
from carecontact.sim.rendering import SceneRenderer
from carecontact.sim.simulation import Samples, Simulation
from carecontact.sim.true_skin import skin_in_world
from carecontact.validation.moves import move_to, surface_point
from carecontact.validation.result import Array, CheckResult, Measure
from carecontact.validation.scores import force_norm
from carecontact.validation.subject import COMFORT_ARM_DEG, Subject
from carecontact.world.human.breathing import breath_body
from carecontact.world.human.skeleton import body_name
from carecontact.world.life import LIFT_RAD

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TITLE = "A person who moves by itself"
REGION, CAMERA = "abdomen", "overhead"
BREATH_HZ, IN_SHARE, BREATH_M = 0.33, 0.455, (0.015, 0.005)
"""The quickest and largest breath of the shipped levels, with an ordinary share of breathing in."""
BREATHES = Doings(breath_hz=BREATH_HZ, inspiration_share=IN_SHARE, breath_m=BREATH_M)
SIZE_LIMIT_MM, FORCE_LIMIT_PERCENT, WAY_LIMIT_MM = 1.0, 10.0, 8.0
DEEP_M = 0.006
"""How far under the skin of a breath out the fixed tool is."""
HEIGHTS, QUICK_HEIGHTS = 7, 3
"""Breaths that are held, evenly between the two ends."""
STILL_S = 0.6
FROZEN = 1e6
"""Armature of the joints of a robot that nothing moves [kg m^2]."""
WAY_M, MOVE_S, ONSET_S, LET_GO_S = 0.06, 1.0, 1.5, 1.0
"""Of the movement of the arm, and how long it is looked at after it has ended."""
TENSES_S, PUSH_NM = 0.1, 3.0
"""How long before a movement its muscles tense; torque that turns the shoulder until then."""
CUT_S, GO_ON_S = 2.0, 1.0
"""Where a run is interrupted, in mid-breath and in mid-movement, and how far it goes on."""
WINDOW = 2
"""Pixels to each side of that at which depth is read."""


def run(subject: Subject, *, quick: bool) -> CheckResult:
    living = alive(subject)
    time, felt, expected = fixed_tool(living, heights=QUICK_HEIGHTS if quick else HEIGHTS)
    swing, wanted = np.ptp(felt), np.ptp(expected)
    return CheckResult(
        check="alive", title=TITLE, curves={"fixed tool": np.stack([time, felt, expected])},
        measures=(
            *seen(living),
            Measure(name="fixed tool: largest deviation of the force from that of held breaths, of its swing",
                    value=float(100 * abs(felt - expected).max() / wanted), unit="%", limit=FORCE_LIMIT_PERCENT),
            Measure(name="fixed tool: deviation of the swing of the force from that of held breaths", unit="%",
                    value=float(100 * abs(swing / wanted - 1)), limit=FORCE_LIMIT_PERCENT),
            Measure(name="fixed tool: swing of the force", value=float(swing), unit="N", limit=0.5, side="at least"),
            *arm(living),
            *again(living),
        ),
    )  # fmt: skip


def alive(subject: Subject) -> Subject:
    """The same person, who can breathe and move the arm."""
    asked = Alive(breathing=Breathing(), repositioning=Repositioning())
    return subject.variant(person=subject.protocol.person.model_copy(update={"alive": asked}))


def seen(living: Subject) -> list[Measure]:
    """How far visible skin and depth image are from the declared breath, at its ends."""
    scene = living.make_scene(living.protocol, target=REGION, skin=True)
    simulation = Simulation(scene)
    simulation.restore(living.at_rest(REGION).integration_state(), comfort_arm_deg=COMFORT_ARM_DEG)
    shell = scene.regions[REGION].shell
    skin = np.asarray(scene.model.skin_vert, np.float64).reshape(-1, 3)
    over = [int(np.linalg.norm(skin - at, axis=1).argmin()) for at in shell.vertices[shell.fine][::10]]
    found: list[tuple[Array, Array]] = []
    with SceneRenderer(scene.model, protocol=living.protocol) as renderer:
        site = simulation.data.site(f"region_{REGION}").xpos.copy()
        at = simulation.robot.in_base(simulation.data, site, np.eye(3))[:3, 3]
        camera, matrix = renderer.pose_camera_in_base(simulation.data, CAMERA), renderer.intrinsics(CAMERA)
        x, y, z = camera[:3, :3].T @ (at - camera[:3, 3])
        u, v = round(x / z * matrix[0, 0] + matrix[0, 2]), round(y / z * matrix[1, 1] + matrix[1, 2])
        window = slice(v - WINDOW, v + WINDOW + 1), slice(u - WINDOW, u + WINDOW + 1)
        for size in (0.0, 1.0):
            for part, wide in zip(PARTS, BREATH_M, strict=True):
                simulation.data.joint(breath_body(part)).qpos[:] = size * wide
            mujoco.mj_forward(scene.model, simulation.data)
            found.append((skin_in_world(scene.model, simulation.data)[over],
                          renderer.depth(simulation.data, CAMERA)[window].astype(np.float64)))  # fmt: skip
    (skin_out, depth_out), (skin_in, depth_in) = found
    moved, nearer = np.linalg.norm(skin_in - skin_out, axis=1), float(np.median(depth_out - depth_in))
    return [
        Measure(name="breath: visible skin over the region against the declared size", unit="mm",
                value=float(1000 * abs(moved - BREATH_M[0]).max()), limit=SIZE_LIMIT_MM),
        Measure(name="breath: depth image over the region against the declared size", unit="mm",
                value=1000 * abs(nearer - BREATH_M[0]), limit=SIZE_LIMIT_MM),
    ]  # fmt: skip


def fixed_tool(living: Subject, *, heights: int) -> tuple[Array, Array, Array]:
    """Time [s], force of a tool that stays where it is through one breath [N], and what held breaths give there."""
    simulation = _pressed(living)
    begin = simulation.integration_state()
    held = []
    for height in np.linspace(0.0, 1.0, heights):
        simulation.restore(begin, comfort_arm_deg=COMFORT_ARM_DEG)
        _hold(simulation, float(height))
        held.append(_force(simulation.advance(round(STILL_S / simulation.model.opt.timestep)))[-1])
    simulation.restore(begin, comfort_arm_deg=COMFORT_ARM_DEG)
    Life(simulation.model).wake(simulation.data, BREATHES)
    steps = round(1 / BREATH_HZ / simulation.model.opt.timestep)
    force = _force(simulation.advance(steps))
    time = (1 + np.arange(steps)) * simulation.model.opt.timestep
    height = [breath(BREATHES, t)[0] for t in time]
    return time, force, np.interp(height, np.linspace(0.0, 1.0, heights), held)


def _pressed(living: Subject) -> Simulation:
    """The person at the end of a breath out, and a tool in the skin that nothing moves any more."""
    simulation = living.hovering(REGION)
    move_to(simulation, surface_point(simulation, REGION) - [0.0, 0.0, DEEP_M], seconds=STILL_S)
    move_to(simulation, surface_point(simulation, REGION) - [0.0, 0.0, DEEP_M], seconds=STILL_S)
    for joint in PANDA.joints:
        dof = int(simulation.model.joint(joint).dofadr[0])
        simulation.model.dof_armature[dof] = FROZEN
        simulation.data.qvel[dof] = 0.0
    return simulation


def _hold(simulation: Simulation, height: float) -> None:
    """Let the person breathe in to a height from 0, breathed out, to 1, and hold the breath there."""
    share = float(np.arccos(1 - 2 * height)) / np.pi
    life = Life(simulation.model)
    life.wake(simulation.data, BREATHES)
    simulation.advance(round(share * IN_SHARE / BREATH_HZ / simulation.model.opt.timestep))
    life.wake(simulation.data, Doings(inspiration_share=IN_SHARE, phase=share * IN_SHARE, breath_m=BREATH_M))


def _force(samples: list[Samples]) -> Array:
    return force_norm(samples, REGIONS[REGION].segment)


def arm(living: Subject) -> list[Measure]:
    """How far the wrist goes when the arm changes its place, also after it was pushed aside."""
    found: list[Measure] = []
    for name, push_nm in (("as it was laid", 0.0), ("after a push", PUSH_NM)):
        simulation = living.at_rest(REGION)
        turned = simulation.data.joint(f"human_{JOINTS[0]}")
        life, wrist = Life(simulation.model), simulation.data.body(body_name("right_hand"))
        way = _moves(simulation)
        life.wake(simulation.data, way)
        turned.qfrc_applied[:] = push_nm
        dt = simulation.model.opt.timestep
        simulation.advance(round((ONSET_S - TENSES_S) / dt))
        before = wrist.xpos.copy()
        turned.qfrc_applied[:] = 0.0
        simulation.advance(round((TENSES_S + MOVE_S + LET_GO_S) / dt))
        moved = float(np.hypot(*(wrist.xpos - before)[:2]))
        found.append(
            Measure(name=f"arm, {name}: way of the wrist against the wanted one", unit="mm",
                    value=1000 * abs(moved - WAY_M), limit=WAY_LIMIT_MM)
        )  # fmt: skip
    return found


def _moves(simulation: Simulation) -> Doings:
    shift = np.zeros(len(JOINTS))
    shift[0] = WAY_M / simulation.wrist_radius_m()
    move = Move(time_s=ONSET_S, duration_s=MOVE_S, lift_rad=LIFT_RAD, shift_rad=shift)
    return replace(BREATHES, moves=(move,))


def again(living: Subject) -> list[Measure]:
    """What differs in any bit in a second run, and in one that goes on from a state in its middle."""
    runs = [living.at_rest(REGION) for _ in range(3)]
    steps = [round(seconds / runs[0].model.opt.timestep) for seconds in (CUT_S, GO_ON_S)]
    for simulation in runs:
        Life(simulation.model).wake(simulation.data, _moves(simulation))
    first, second, third = runs
    mujoco.mj_step(first.model, first.data, nstep=steps[0])
    middle = first.integration_state()
    mujoco.mj_step(first.model, first.data, nstep=steps[1])
    mujoco.mj_step(second.model, second.data, nstep=sum(steps))
    mujoco.mj_setState(third.model, third.data, middle, int(mujoco.mjtState.mjSTATE_INTEGRATION))
    mujoco.mj_step(third.model, third.data, nstep=steps[1])
    wanted = first.integration_state()
    return [
        Measure(name=f"numbers of the state that differ in {name}", limit=0.0,
                value=float((other.integration_state() != wanted).sum()))
        for name, other in (("a second run", second), ("a run that was restored in its middle", third))
    ]  # fmt: skip


def draw(result: CheckResult, figure: Figure) -> None:
    figure.set_size_inches(4.0, 2.4)
    axes = figure.subplots()
    time, felt, expected = result.curves["fixed tool"]
    axes.plot(time, felt, label="breathing")
    axes.plot(time, expected, ":", label="held breaths")
    axes.set(xlabel="time [s]", ylabel="force [N]", title="a fixed tool on the belly through a breath")
    axes.legend()
