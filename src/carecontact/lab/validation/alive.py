"""Checks a person who breathes and moves the arm: what cameras see of a breath, the force that a tool measures
meanwhile, how far the arm moves, and whether a second run is the same. Breath and movement have known sizes, whatever
the protocol states."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.human.breathing import breath_body
from carecontact.human.hulls import PLATES, plate_body
from carecontact.human.mesh import normals_and_areas
from carecontact.human.skeleton import body_name
from carecontact.interface.geometry import Triangles, matrix_from_quat
from carecontact.interface.regions import REGIONS
from carecontact.lab.validation.result import Array, CheckResult, Figure, Measure, measured
from carecontact.lab.validation.subject import COMFORT_ARM_DEG, Subject, force_norm, move_to, surface_point
from carecontact.protocol.person import Alive, Breathing, Repositioning
from carecontact.sim.rendering import SceneRenderer
from carecontact.sim.simulation import Samples, Simulation
from carecontact.sim.state import skin_in_world
from carecontact.tissue.life import JOINTS, PARTS, Life, MotionScript, Move, breath
from carecontact.world.draws import LIFT_RAD

Indices = npt.NDArray[np.int_]
Flags = npt.NDArray[np.bool_]

REGION, CAMERA = "abdomen", "overhead"
SIZE_LIMIT_MM = 1.0
WINDOW = 2
"""Number of pixels on each side of the central one over which the depth image is read."""
OVER_PLATE_M, INNER_PLATE_M = 0.03, 0.04
"""Skin that faces forward belongs to the chest if it is as near as that to a vertex of a chest plate, and to its inner
area if it is, seen from above, as near as that to the middle of one."""
LOOKS = 60
"""Number of places of a part at which the depth image is read."""
SEEN_M = 0.003
"""A place counts if the image shows no more than this distance before or behind it: other skin, or the robot, may be in
the way."""
STEEPEST = 0.5
"""Least cosine between the skin and the ray of a pixel that is read: a pixel covers some 3 mm, along which steeper skin
changes its depth by as much as a breath moves it."""


Look = tuple[Array, Array]
"""Visible skin in the world (V, 3) [m], and depth image (H, W) [m]."""


def breath_measures(living: Subject, script: MotionScript) -> Iterator[Measure]:
    """Yield what is seen of a breath against its declared size.

    Over the rim of the chest's plates, where the movement fades, no size is declared: there the limit does not decide.
    """
    found = breathe(living, script)
    for part, size in zip(PARTS, script.breath_m, strict=True):
        skin_m, inner, depth_off_m = found[part]
        off, depth = 1000 * abs(skin_m - size), 1000 * abs(depth_off_m)
        name, against = f"{part}, {script.breath_hz:g} Hz, {1000 * size:g} mm", "against the declared size"
        area, limit = f"{name}: visible skin of the", SIZE_LIMIT_MM
        median = np.median(depth) if depth.size else np.nan
        yield measured(f"{area} inner area {against}", off[inner].max(), "mm", at_most=limit)
        yield measured(f"{area} whole area {against}", off.max(), "mm", at_most=limit, decides=part == REGION)
        yield measured(f"{name}: share of the area within {limit:g} mm", 100 * (off <= limit).mean(), "%")
        yield measured(f"{name}: depth image, median place {against}", median, "mm", at_most=limit)
        yield measured(f"{name}: depth image, worst place {against}", depth.max(initial=0.0), "mm")
        yield measured(f"{name}: places of the depth image", depth.size, at_least=10)


def breathe(living: Subject, script: MotionScript) -> dict[str, tuple[Array, Flags, Array]]:
    """Let the person breathe in once, in simulated time, and look before and after.

    Returns for each part how far each vertex of the visible skin moved along the slide (n,) [m], whether it is in the
    part's inner area (n,), and how much nearer each place of the depth image came (k,) [m], minus what its pixel's ray
    would meet of skin that moves by the declared size.
    """
    scene = living.make_scene(living.protocol, target=REGION, skin=True)
    simulation = Simulation(scene)
    simulation.restore(living.at_rest(REGION).integration_state(), comfort_arm_deg=COMFORT_ARM_DEG)
    Life(simulation.model).wake(simulation.data, script)
    areas = {"abdomen": _over_shell(simulation), "chest": _over_plates(simulation)}
    found = {}
    with SceneRenderer(scene.model, protocol=living.protocol) as renderer:

        def look() -> Look:
            mujoco.mj_forward(scene.model, simulation.data)
            depth = renderer.depth(simulation.data, CAMERA).astype(np.float64)
            return skin_in_world(scene.model, simulation.data), depth

        before = look()
        simulation.advance(round(script.inspiration_share / script.breath_hz / scene.model.opt.timestep))
        after = look()
        for part, size in zip(PARTS, script.breath_m, strict=True):
            vertices, inner = areas[part]
            outward = simulation.data.joint(breath_body(part)).xaxis
            places = vertices[inner][:: max(1, int(inner.sum()) // LOOKS)]
            off = _depth_off(simulation, renderer, before, after, places, size * outward)
            found[part] = (after[0] - before[0])[vertices] @ outward, inner, off
    return found


def _over_shell(simulation: Simulation) -> tuple[Indices, Flags]:
    """Return the vertices (n,) of the skin over the whole soft region, and which (n,) are over its fine part."""
    shell = simulation.scene.regions[REGION].shell
    skin = np.asarray(simulation.model.skin_vert, np.float64).reshape(-1, 3)
    nearest = np.array([int(np.linalg.norm(skin - at, axis=1).argmin()) for at in shell.vertices])
    vertices = np.unique(nearest)
    return vertices, np.isin(vertices, nearest[shell.fine])


def _over_plates(simulation: Simulation) -> tuple[Indices, Flags]:
    """Return the vertices (n,) of the skin over the front of the chest's plates, and which are over one's middle."""
    model, data = simulation.model, simulation.data
    front = simulation.data.joint(breath_body("chest")).xaxis
    bodies = [model.body(plate_body(plate.name)).id for plate in PLATES if plate.breathes]
    geoms = np.flatnonzero(np.isin(model.geom_bodyid, bodies)).tolist()
    hulls = np.concatenate([_world_vertices(model, data, geom) for geom in geoms])
    skin = skin_in_world(model, data)
    normals = normals_and_areas(skin, np.asarray(model.skin_face))[0]
    ahead = np.flatnonzero(normals @ front > STEEPEST)
    vertices = ahead[[bool(np.linalg.norm(hulls - at, axis=1).min() < OVER_PLATE_M) for at in skin[ahead]]]
    away = np.linalg.norm(skin[vertices][:, None, :2] - data.xipos[bodies][None, :, :2], axis=2)
    return vertices, away.min(1) < INNER_PLATE_M


def _world_vertices(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> Array:
    mesh = int(model.geom_dataid[geom])
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    local = np.asarray(model.mesh_vert[first : first + count], np.float64)
    return data.geom_xpos[geom] + local @ data.geom_xmat[geom].reshape(3, 3).T


def _depth_off(
    simulation: Simulation, renderer: SceneRenderer, before: Look, after: Look, vertices: Indices, moved: Array
) -> Array:
    """Return (k,) how much nearer the visible places came, minus what the rays of their pixels meet of skin that moved
    as a whole by ``moved`` (3,)."""
    (skin, depth), (_, depth_after) = before, after
    faces = np.asarray(simulation.model.skin_face)
    base = simulation.pose_base_in_world
    camera, matrix = renderer.pose_camera_in_base(simulation.data, CAMERA), renderer.intrinsics(CAMERA)
    turn = matrix_from_quat(base[3:]) @ camera[:3, :3]
    eye = base[:3] + matrix_from_quat(base[3:]) @ camera[:3, 3]
    local = (skin[vertices] - eye) @ turn
    pixels = np.rint(local[:, :2] / local[:, 2:] * matrix[[0, 1], [0, 1]] + matrix[:2, 2]).astype(int)
    rows = []
    normals = normals_and_areas(skin, faces)[0][vertices]
    surface = Triangles(skin[faces])
    for (u, v), point, normal in zip(pixels, local, normals, strict=True):
        if not (WINDOW <= v < depth.shape[0] - WINDOW and WINDOW <= u < depth.shape[1] - WINDOW):
            continue
        ray = turn @ np.array([(u - matrix[0, 2]) / matrix[0, 0], (v - matrix[1, 2]) / matrix[1, 1], 1.0])
        length = float(np.linalg.norm(ray))
        if -(normal @ ray) / length < STEEPEST or abs(depth[v, u] - point[2]) > SEEN_M:
            continue
        # Skin that moves outward is nearer along a ray by as much as the ray's origin seems to move inward.
        hits = surface.first_hits(np.stack([eye, eye - moved]), np.stack([ray, ray]) / length)
        window = slice(v - WINDOW, v + WINDOW + 1), slice(u - WINDOW, u + WINDOW + 1)
        rows.append(float(np.median(depth[window] - depth_after[window])) - float(hits[0] - hits[1]) / length)
    return np.array(rows)


TITLE = "A person who moves by itself"
BREATHS_HZ, BREATH_HZ, IN_SHARE, BREATH_M = (0.2, 0.33), 0.33, 0.455, (0.015, 0.005)
"""Rates [1/s], part of a breath that is breathing in, and size [m] of a breath: the slowest, fastest and largest breath
of the shipped protocols' levels, of which an ordinary part is breathing in. The second rate is that of the short form,
of the movements of the arm and of the repeated runs."""
BREATHES = MotionScript(breath_hz=BREATH_HZ, inspiration_share=IN_SHARE, breath_m=BREATH_M)
FORCE_LIMIT_PERCENT, WAY_LIMIT_MM = 10.0, 8.0
DEEP_M = 0.006
"""Depth of the fixed tool below the skin at the end of breathing out."""
HEIGHTS, QUICK_HEIGHTS = 7, 3
"""Number of heights at which a breath is held, at equal distances from breathed out to breathed in; the second number
is that of the short form."""
STILL_S = 0.6
FROZEN = 1e6
"""Armature of the robot's joints that keeps the robot in its place [kg m^2]."""
WAY_M, MOVE_S, ONSET_S, LET_GO_S = 0.06, 1.0, 1.5, 1.0
"""The movement of the arm: how far the wrist moves, how long that takes, when it begins, and for how long the check
goes on after its end."""
TENSES_S, ASIDE_RAD = 0.1, 0.1
"""How long before a movement its muscles tense, and the angle by which an external torque has turned the shoulder until
then."""
GUIDE_NM_RAD, GUIDE_NMS_RAD = 100.0, 10.0
"""Stiffness and damping of that torque."""
CUT_S, GO_ON_S = 2.0, 1.0
"""When a run is interrupted, in the middle of a breath and of a movement, and for how long it then goes on."""


def run(subject: Subject, *, quick: bool) -> CheckResult:
    living = alive(subject)
    measures: list[Measure] = []
    curves: dict[str, Array] = {}
    for hz in (BREATH_HZ,) if quick else BREATHS_HZ:
        script = replace(BREATHES, breath_hz=hz)
        measures += breath_measures(living, script)
        time, felt, expected = fixed_tool(living, script, heights=QUICK_HEIGHTS if quick else HEIGHTS)
        swing, wanted = np.ptp(felt), np.ptp(expected)
        # Held breaths are reached by breathing in.
        off, inward = 100 * abs(felt - expected) / wanted, time <= IN_SHARE / hz
        name, limit = f"fixed tool, {hz:g} Hz", FORCE_LIMIT_PERCENT
        largest = f"{name}: largest deviation of the force from that of held breaths, of its swing"
        swings = f"{name}: deviation of the swing of the force from that of held breaths"
        out = f"{name}: the same while breathing out, where friction has turned round"
        measures += [
            measured(largest, off[inward].max(), "%", at_most=limit),
            measured(out, off[~inward].max(), "%"),
            measured(swings, 100 * abs(swing / wanted - 1), "%", at_most=limit),
            measured(f"{name}: swing of the force", swing, "N", at_least=0.5),
        ]
        curves[f"{hz:g} Hz"] = np.stack([time, felt, expected])
    measures += [*arm(living), *repeatability(living)]
    return CheckResult(check="alive", title=TITLE, measures=tuple(measures), curves=curves)


def alive(subject: Subject) -> Subject:
    """Return the same person, who can breathe and move the arm."""
    asked = Alive(breathing=Breathing(), repositioning=Repositioning())
    return subject.variant(person=subject.protocol.person.model_copy(update={"alive": asked}))


def fixed_tool(living: Subject, script: MotionScript, *, heights: int) -> tuple[Array, Array, Array]:
    """Measure the force on a tool that stays in its place through one breath; ``heights`` is the number of heights at
    which a breath is held for comparison.

    Returns three arrays (n,): time [s], force [N], and the force that held breaths give at the same height [N].
    """
    simulation = _pressed(living)
    begin = simulation.integration_state()
    held = []
    for height in np.linspace(0.0, 1.0, heights):
        simulation.restore(begin, comfort_arm_deg=COMFORT_ARM_DEG)
        _hold(simulation, script, float(height))
        held.append(_force(simulation.advance(round(STILL_S / simulation.model.opt.timestep)))[-1])
    simulation.restore(begin, comfort_arm_deg=COMFORT_ARM_DEG)
    Life(simulation.model).wake(simulation.data, script)
    steps = round(1 / script.breath_hz / simulation.model.opt.timestep)
    force = _force(simulation.advance(steps))
    time = (1 + np.arange(steps)) * simulation.model.opt.timestep
    height = [breath(script, t)[0] for t in time]
    return time, force, np.interp(height, np.linspace(0.0, 1.0, heights), held)


def _pressed(living: Subject) -> Simulation:
    """Return the person at the end of breathing out, with a tool in the skin that stays in its place."""
    simulation = living.hovering(REGION)
    for _ in range(2):
        move_to(simulation, surface_point(simulation, REGION) - [0.0, 0.0, DEEP_M], seconds=STILL_S)
    for joint in simulation.robot.joints:
        dof = int(simulation.model.joint(joint).dofadr[0])
        simulation.model.dof_armature[dof] = FROZEN
        simulation.data.qvel[dof] = 0.0
    return simulation


def _hold(simulation: Simulation, script: MotionScript, height: float) -> None:
    """Let the person breathe in to a height, from 0 (breathed out) to 1 (breathed in), and hold the breath there."""
    share = float(np.arccos(1 - 2 * height)) / np.pi
    life = Life(simulation.model)
    life.wake(simulation.data, script)
    simulation.advance(round(share * IN_SHARE / script.breath_hz / simulation.model.opt.timestep))
    life.wake(simulation.data, MotionScript(inspiration_share=IN_SHARE, phase=share * IN_SHARE, breath_m=BREATH_M))


def _force(samples: list[Samples]) -> Array:
    return force_norm(samples, REGIONS[REGION].segment)


def arm(living: Subject) -> list[Measure]:
    """Return how far off the wanted distance the wrist moves, as the arm was laid down and after a push aside."""
    found: list[Measure] = []
    for name, aside_rad in (("as it was laid", 0.0), ("after a push", ASIDE_RAD)):
        simulation = living.at_rest(REGION)
        turned = simulation.data.joint(f"human_{JOINTS[0]}")
        wrist, asked = simulation.data.body(body_name("right_hand")), _moves(simulation)
        Life(simulation.model).wake(simulation.data, asked)
        dt, goal = simulation.model.opt.timestep, float(turned.qpos[0]) + aside_rad
        for _ in range(round((ONSET_S - TENSES_S) / dt) if aside_rad else 0):
            turned.qfrc_applied[:] = GUIDE_NM_RAD * (goal - turned.qpos) - GUIDE_NMS_RAD * turned.qvel
            simulation.advance(1)
        turned.qfrc_applied[:] = 0.0
        before = wrist.xpos.copy()
        simulation.advance(round((ONSET_S + MOVE_S + LET_GO_S - simulation.time_s) / dt))
        moved = float(np.hypot(*(wrist.xpos - before)[:2]))
        way = f"arm, {name}: way of the wrist against the wanted one"
        found.append(measured(way, 1000 * abs(moved - WAY_M), "mm", at_most=WAY_LIMIT_MM))
    return found


def _moves(simulation: Simulation) -> MotionScript:
    shift = np.zeros(len(JOINTS))
    shift[0] = WAY_M / simulation.wrist_radius_m()
    move = Move(time_s=ONSET_S, duration_s=MOVE_S, lift_rad=LIFT_RAD, shift_rad=shift)
    return replace(BREATHES, moves=(move,))


def repeatability(living: Subject) -> list[Measure]:
    """Return how many numbers of the final state differ in any bit in a second run, and in a run that continues from a
    state in its middle."""
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
    others = {"a second run": second, "a run that was restored in its middle": third}
    different = {name: (other.integration_state() != wanted).sum() for name, other in others.items()}
    return [measured(f"numbers of the state that differ in {name}", n, at_most=0.0) for name, n in different.items()]


def draw(result: CheckResult, figure: Figure) -> None:
    figure.set_size_inches(4.0, 2.4)
    axes = figure.subplots()
    for number, (name, (time, felt, expected)) in enumerate(result.curves.items()):
        axes.plot(time, felt, color=f"C{number}", label=f"breathing, {name}")
        axes.plot(time, expected, ":", color=f"C{number}", label="held breaths")
    axes.set(xlabel="time [s]", ylabel="force [N]", title="a fixed tool on the abdomen through a breath")
    axes.legend()
