"""What cameras see of a breath that the person draws: how far the visible skin moves, and what the depth image shows.

The breath is driven by simulated time. Everything is compared between its beginning and the end of breathing in, at
every vertex of the abdomen's soft region and over the plates of the chest.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.contract.geometry import matrix_from_quat
from carecontact.contract.rays import Triangles
from carecontact.kernel.life import PARTS, Doings, Life
from carecontact.sim.rendering import SceneRenderer
from carecontact.sim.simulation import Simulation
from carecontact.sim.true_skin import skin_in_world
from carecontact.validation.result import Array, Measure
from carecontact.validation.subject import COMFORT_ARM_DEG, Subject
from carecontact.world.human.breathing import breath_body
from carecontact.world.human.plates import PLATES, plate_body

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


@dataclass(frozen=True, kw_only=True)
class Look:
    """What is seen at one moment."""

    skin: Array
    """(V, 3) visible skin in the world [m]"""
    depth: Array
    """(H, W) [m]"""


@dataclass(frozen=True, kw_only=True)
class Seen:
    """What is seen of one breath, part by part."""

    skin_m: dict[str, Array]
    """Part -> (n,) how far each vertex of the visible skin moved along the slide."""
    inner: dict[str, Flags]
    """Part -> (n,) whether the vertex is in the part's inner area."""
    depth_off_m: dict[str, Array]
    """Part -> (k,) how much nearer each place of the depth image came, minus what its pixel's ray would meet of skin
    that moves by the declared size."""


def measures(living: Subject, doings: Doings) -> Iterator[Measure]:
    """Yield what is seen of a breath against its declared size.

    Over the rim of the chest's plates, where the movement fades, no size is declared: there the limit does not decide.
    """
    found = breathe(living, doings)
    for part, size in zip(PARTS, doings.breath_m, strict=True):
        name = f"{part}, {doings.breath_hz:g} Hz, {1000 * size:g} mm"
        off, inner, depth = abs(found.skin_m[part] - size), found.inner[part], abs(found.depth_off_m[part])
        yield Measure(name=f"{name}: visible skin of the inner area against the declared size", unit="mm",
                      value=1000 * float(off[inner].max()), limit=SIZE_LIMIT_MM)  # fmt: skip
        yield Measure(name=f"{name}: visible skin of the whole area against the declared size", unit="mm",
                      value=1000 * float(off.max()), limit=SIZE_LIMIT_MM, decides=part == REGION)  # fmt: skip
        yield Measure(name=f"{name}: share of the area within {SIZE_LIMIT_MM:g} mm", unit="%",
                      value=100 * float((1000 * off <= SIZE_LIMIT_MM).mean()))  # fmt: skip
        yield Measure(name=f"{name}: depth image, median place against the declared size", unit="mm",
                      value=1000 * float(np.median(depth)) if depth.size else np.nan, limit=SIZE_LIMIT_MM)  # fmt: skip
        yield Measure(name=f"{name}: depth image, worst place against the declared size", unit="mm",
                      value=1000 * float(depth.max(initial=0.0)))  # fmt: skip
        yield Measure(name=f"{name}: places of the depth image", value=depth.size, limit=10, side="at least")


def breathe(living: Subject, doings: Doings) -> Seen:
    """Let the person breathe in once, in simulated time, and look before and after."""
    scene = living.make_scene(living.protocol, target=REGION, skin=True)
    simulation = Simulation(scene)
    simulation.restore(living.at_rest(REGION).integration_state(), comfort_arm_deg=COMFORT_ARM_DEG)
    Life(simulation.model).wake(simulation.data, doings)
    areas = {"abdomen": _over_shell(simulation), "chest": _over_plates(simulation)}
    skin_m, inner, off = {}, {}, {}
    with SceneRenderer(scene.model, protocol=living.protocol) as renderer:

        def look() -> Look:
            mujoco.mj_forward(scene.model, simulation.data)
            return Look(skin=skin_in_world(scene.model, simulation.data),
                        depth=renderer.depth(simulation.data, CAMERA).astype(np.float64))  # fmt: skip

        before = look()
        simulation.advance(round(doings.inspiration_share / doings.breath_hz / scene.model.opt.timestep))
        after = look()
        for part, size in zip(PARTS, doings.breath_m, strict=True):
            vertices, inner[part] = areas[part]
            outward = simulation.data.joint(breath_body(part)).xaxis
            skin_m[part] = (after.skin - before.skin)[vertices] @ outward
            places = vertices[inner[part]][:: max(1, int(inner[part].sum()) // LOOKS)]
            off[part] = _depth_off(simulation, renderer, before, after, places, size * outward)
    return Seen(skin_m=skin_m, inner=inner, depth_off_m=off)


def _over_shell(simulation: Simulation) -> tuple[Indices, Flags]:
    """Return the vertices (n,) of the skin over the whole soft region, and which (n,) are over its fine part."""
    shell = simulation.scene.regions[REGION].shell
    skin = np.asarray(simulation.model.skin_vert, np.float64).reshape(-1, 3)
    nearest = np.array([int(np.linalg.norm(skin - at, axis=1).argmin()) for at in shell.vertices])
    vertices = np.unique(nearest)
    return vertices, np.isin(vertices, nearest[shell.fine])


def _over_plates(simulation: Simulation) -> tuple[Indices, Flags]:
    """Return the vertices (n,) of the skin over the front of the chest's plates, and which (n,) are over the middle of
    one."""
    model, data = simulation.model, simulation.data
    front = simulation.data.joint(breath_body("chest")).xaxis
    bodies = [model.body(plate_body(plate.name)).id for plate in PLATES if plate.breathes]
    hulls = np.concatenate([_world_vertices(model, data, g) for g in range(model.ngeom)
                            if model.geom_bodyid[g] in bodies])  # fmt: skip
    skin = skin_in_world(model, data)
    normals = _normals(skin, np.asarray(model.skin_face))
    ahead = np.flatnonzero(normals @ front > STEEPEST)
    vertices = ahead[
        [bool(np.linalg.norm(hulls - at, axis=1).min() < OVER_PLATE_M) for at in skin[ahead]]
    ]  # fmt: skip
    away = np.linalg.norm(skin[vertices][:, None, :2] - data.xipos[bodies][None, :, :2], axis=2)
    return vertices, away.min(1) < INNER_PLATE_M


def _world_vertices(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> Array:
    mesh = int(model.geom_dataid[geom])
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    local = np.asarray(model.mesh_vert[first : first + count], np.float64)
    return data.geom_xpos[geom] + local @ data.geom_xmat[geom].reshape(3, 3).T


def _normals(vertices: Array, faces: Indices) -> Array:
    """Return the outward unit normals (V, 3) of a surface."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    out = np.zeros_like(vertices)
    for corner in faces.T:
        np.add.at(out, corner, np.cross(b - a, c - a))
    return out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-12)


def _depth_off(
    simulation: Simulation, renderer: SceneRenderer, before: Look, after: Look, vertices: Indices, moved: Array
) -> Array:
    """Return (k,) how much nearer the visible places came, minus what the rays of their pixels meet of skin that moved
    as a whole by ``moved`` (3,)."""
    faces = np.asarray(simulation.model.skin_face)
    base = simulation.pose_base_in_world
    camera, matrix = renderer.pose_camera_in_base(simulation.data, CAMERA), renderer.intrinsics(CAMERA)
    turn = matrix_from_quat(base[3:]) @ camera[:3, :3]
    eye = base[:3] + matrix_from_quat(base[3:]) @ camera[:3, 3]
    local = (before.skin[vertices] - eye) @ turn
    pixels = np.rint(local[:, :2] / local[:, 2:] * matrix[[0, 1], [0, 1]] + matrix[:2, 2]).astype(int)
    rows = []
    normals = _normals(before.skin, faces)[vertices]
    surface = Triangles(before.skin[faces])
    for (u, v), point, normal in zip(pixels, local, normals, strict=True):
        if not (WINDOW <= v < before.depth.shape[0] - WINDOW and WINDOW <= u < before.depth.shape[1] - WINDOW):
            continue
        ray = turn @ np.array([(u - matrix[0, 2]) / matrix[0, 0], (v - matrix[1, 2]) / matrix[1, 1], 1.0])
        length = float(np.linalg.norm(ray))
        if -(normal @ ray) / length < STEEPEST or abs(before.depth[v, u] - point[2]) > SEEN_M:
            continue
        # Skin that moves outward is nearer along a ray by as much as the ray's origin seems to move inward.
        hits = surface.first_hits(np.stack([eye, eye - moved]), np.stack([ray, ray]) / length)
        window = slice(v - WINDOW, v + WINDOW + 1), slice(u - WINDOW, u + WINDOW + 1)
        rows.append(float(np.median(before.depth[window] - after.depth[window])) - float(hits[0] - hits[1]) / length)
    return np.array(rows)
