"""The stage of a video: the grid of pictures, the dented skin, camera and light."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
from PIL import ImageDraw
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from carecontact.errors import DependencyError
from carecontact.human.breathing import move_skin
from carecontact.human.mesh import refined
from carecontact.human.skin import add_skin
from carecontact.interface.regions import REGIONS
from carecontact.pictures import FINENESS, coverage, fine
from carecontact.replay.shadow import MAP_PX, Eye, Lamp, edges, metres_of_lamp, shade, widened
from carecontact.sim.opengl import import_opengl
from carecontact.sim.state import skin_in_world
from carecontact.tissue.plugin import Readings
from carecontact.world.scene import Scene, build_spec, controlled

F64 = npt.NDArray[np.float64]

LINE_M = 0.010
"""Distance between two lines, along the region and across it, as seen from the region's outward side."""
FACING = 0.15
"""Triangles whose normal has a smaller part along the outward axis have no lines."""
NEAR_M = 0.008
"""Skin farther from the region's shell has no lines."""
TOLERANCE_M = 0.0025
"""A line is drawn where nothing lies farther in front of it."""
LINE_COLOUR, DARKNESS = (60, 30, 22), 0.42
"""A line's colour, and the share of it in a pixel that the line covers."""


class SkinGrid:
    """Lines as pairs of points on edges of the skin's triangles, found once in the bind pose."""

    def __init__(self, scene: Scene, region: str) -> None:
        """``region``: a soft one. The scene is a film's (``film.skin.film_scene``)."""
        model, frame = scene.model, scene.frames[region]
        bind = np.asarray(model.skin_vert, np.float64).reshape(-1, 3)[: model.nskinvert]
        faces = np.asarray(model.skin_face).reshape(-1, 3)
        local = (bind - frame.origin) @ frame.axes
        a, b, c = (local[faces[:, k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        upward = normal[:, 2] > FACING * np.linalg.norm(normal, axis=1)
        near = KDTree(scene.regions[region].shell.vertices).query(bind, distance_upper_bound=NEAR_M)[0] < NEAR_M
        inside = np.abs(local[:, 0]) < frame.size_m[0] / 2
        faces = faces[upward & (near & inside)[faces].all(1)]
        pairs, shares = zip(*(_crossings(local[:, axis] / LINE_M, faces) for axis in (0, 1)), strict=True)
        self._pairs, self._shares = np.concatenate(pairs), np.concatenate(shares)

    def draw(self, picture: npt.NDArray[np.uint8], depth: npt.NDArray[np.float32], vertices: F64, eye: Eye) -> None:
        """Darken the lines in a picture, in place. ``depth``: (H, W) [m]; ``vertices``: (V, 3) of the skin."""
        ends = vertices[self._pairs]
        points = ends[..., 0, :] + self._shares[..., None] * (ends[..., 1, :] - ends[..., 0, :])
        pixels, distance = eye.pixels(points.reshape(-1, 3))
        width, height = eye.size
        column, row = (np.round(pixels[:, k]).astype(int) for k in (0, 1))
        seen = (column >= 0) & (column < width) & (row >= 0) & (row < height) & (distance > 0)
        seen[seen] = distance[seen] < depth[row[seen], column[seen]] + TOLERANCE_M
        both = seen.reshape(-1, 2).all(1)
        lines = fine(pixels.reshape(-1, 2, 2)[both]).reshape(-1, 4).tolist()

        def draw(canvas: ImageDraw.ImageDraw) -> None:
            for ends in lines:
                canvas.line(ends, 255, FINENESS)

        mask = coverage((height, width), draw)
        on = mask > 0
        share = mask[on][:, None].astype(np.float32) * (DARKNESS / 255)
        picture[on] = (picture[on] * (1 - share) + np.array(LINE_COLOUR) * share).astype(np.uint8)


def _crossings(value: F64, faces: npt.NDArray[np.int32]) -> tuple[npt.NDArray[np.int64], F64]:
    """Where whole numbers of a value cross triangles: (L, 2, 2) vertices of the two edges, (L, 2) where on them."""
    low, high = np.ceil(value[faces].min(1)), np.floor(value[faces].max(1))
    pairs, shares = [], []
    for level in range(int(low.min()), int(high.max()) + 1):
        mine = faces[(low <= level) & (level <= high)]
        edges = np.stack([mine, np.roll(mine, -1, axis=1)], -1)
        at = value[edges]
        crossed = (at[..., 0] < level) != (at[..., 1] < level)
        two = crossed.sum(1) == 2
        edges, at = edges[two][crossed[two]], at[two][crossed[two]]
        pairs.append(edges.reshape(-1, 2, 2))
        shares.append(((level - at[:, 0]) / (at[:, 1] - at[:, 0])).reshape(-1, 2))
    return np.concatenate(pairs).astype(np.int64), np.concatenate(shares)


def eye_of(made: mujoco.MjvScene, size: tuple[int, int]) -> Eye:
    """Return the camera that MuJoCo will draw a prepared scene with: the mean of its two eyes."""
    left, right = made.camera[0], made.camera[1]
    position = (np.array(left.pos) + np.array(right.pos)) / 2
    forward, up = np.array(left.forward, np.float64), np.array(left.up, np.float64)
    focal = size[1] / 2 * left.frustum_near / ((left.frustum_top - left.frustum_bottom) / 2)
    return Eye(
        position=position.astype(np.float64), axes=np.stack([np.cross(forward, up), -up, forward]),
        focal_px=float(focal), size=size,
    )  # fmt: skip


SPLITS = 2
"""How many times each triangle of the skin round the region is split into four: edges of about 3 mm."""
REACH_M = 0.016
"""Skin vertices nearer than this to a vertex of the shell follow it; from half of it on, less and less."""
NEIGHBOURS = 8
"""Vertices of the shell that a vertex of the skin follows, with Gaussian weights."""
MOVED_M = 5e-5
"""If no vertex of a shell has moved farther than this, the skin over it stays as it is."""
GAP_M = 3e-4
"""A vertex of the skin inside the tool is drawn this far outside it: smoothing makes dents shallower."""


def film_scene(scene: Scene, region: str) -> Scene:
    """Return the same world with a finer skin round a region; its states fit those of ``scene``."""
    body, protocol = scene.body, scene.protocol
    spec, _, hinges, regions, frames = build_spec(protocol, target=None, skin=False)
    segments = {REGIONS[region].segment, *REGIONS[region].neighbourhood}
    add_skin(spec, refined(body, *sorted(segments), times=SPLITS))
    if protocol.person.alive.breathing is not None:
        move_skin(spec, body)
    made = replace(scene, model=spec.compile(), spec=spec, hinges=tuple(hinges), regions=regions, frames=frames)
    return made if scene.control.joint is None else controlled(made, scene.control)


class FilmSkin:
    """Moves the drawn skin of one compiled world; for people to look at, never for a policy."""

    def __init__(self, scene: Scene) -> None:
        model = self._model = scene.model
        self._count = model.nskinvert
        bind = np.asarray(model.skin_vert, np.float64).reshape(-1, 3)[: self._count]
        self.faces = np.asarray(model.skin_face).reshape(-1, 3)
        self._follow = {
            name: (Readings(model, name), _following(bind, region.shell.vertices))
            for name, region in scene.regions.items()
        }
        self.dentable = np.zeros(self._count, bool)
        """(V,) vertices that follow a shell"""
        for _, follow in self._follow.values():
            self.dentable |= np.diff(follow.indptr) > 0
        # Corners that were split along a seam of the texture are one place of the body.
        _, self._place = np.unique(np.round(bind, 7), axis=0, return_inverse=True)
        self._place = self._place.ravel()
        corners = self._place[self.faces].T.ravel()
        faces = np.tile(np.arange(len(self.faces)), 3)
        self._corners = csr_array(
            (np.ones(len(faces)), (corners, faces)), shape=(self._place.max() + 1, len(self.faces))
        )
        tip = scene.robot.tip
        self._tip, self._half = model.geom(tip.geom).id, np.array(tip.half_m) + GAP_M

    def shape(self, data: mujoco.MjData, made: mujoco.MjvScene) -> F64:
        """Dent and shade the skin of a prepared scene, in place; returns its vertices (V, 3) in the world."""
        drawn = np.asarray(made.skinvert).reshape(-1, 3)[: self._count]
        vertices, normals = self._dented(data, drawn.astype(np.float64))
        drawn[:] = vertices
        np.asarray(made.skinnormal).reshape(-1, 3)[: self._count] = normals
        return vertices

    def placed(self, data: mujoco.MjData) -> tuple[F64, F64]:
        """Return vertices and normals (V, 3) in the world, without a prepared scene."""
        return self._dented(data, skin_in_world(self._model, data))

    def _dented(self, data: mujoco.MjData, vertices: F64) -> tuple[F64, F64]:
        for felt, follow in self._follow.values():
            moved = (felt.vertices(data) - felt.places) @ data.xmat[felt.bone].reshape(3, 3).T
            if np.abs(moved).max() > MOVED_M:
                vertices += follow @ moved
        self._keep_out(data, vertices)
        # Area-weighted normals, one for each place of the body, so that no seam shows.
        a, b, c = (vertices[self.faces[:, k]] for k in range(3))
        normals = self._corners @ np.cross(b - a, c - a)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        return vertices, normals[self._place]

    def _keep_out(self, data: mujoco.MjData, vertices: F64) -> None:
        middle, turn = data.geom_xpos[self._tip], data.geom_xmat[self._tip].reshape(3, 3)
        near = np.flatnonzero((np.abs(vertices - middle) < self._half.max()).all(1))
        local = (vertices[near] - middle) @ turn / self._half
        size = np.linalg.norm(local, axis=1)
        inside = (size < 1) & (size > 0.3)
        out = local[inside] / size[inside, None] * self._half
        vertices[near[inside]] = middle + out @ turn.T


def _following(skin: F64, shell: F64) -> csr_array:
    """(V, N) how much each vertex of the skin moves with each of the shell, both in the mesh frame at rest."""
    tree = KDTree(shell)
    width = float(np.median(tree.query(shell, k=2)[0][:, 1]))
    found: Any = tree.query(skin, k=NEIGHBOURS, distance_upper_bound=2 * REACH_M)
    distance, index = found
    near = np.flatnonzero(distance[:, 0] < REACH_M)
    distance, index = distance[near], index[near]
    weight = np.where(np.isfinite(distance), np.exp(-(((distance - distance[:, :1]) / width) ** 2)), 0.0)
    weight /= weight.sum(1, keepdims=True)
    weight *= np.clip((REACH_M - distance[:, :1]) / (REACH_M / 2), 0, 1)
    there = weight > 1e-6
    rows = np.repeat(near[:, None], NEIGHBOURS, axis=1)[there]
    return csr_array((weight[there], (rows, index[there])), shape=(len(skin), len(shell)))


Picture = npt.NDArray[np.uint8]

SAMPLES = 4
"""Samples of each pixel (multisampling). Without them, facets narrower than a pixel become dotted lines."""
KEY_DIRECTION = (-0.40, -0.62, -0.68)
"""Direction in which the lamp shines that casts shadows."""
FILL_DIRECTION = (0.55, 0.65, -0.5)
SHOULDER_DEG = 15.0
"""Level angle between the camera's direction and that of a lamp that turns with it."""
KEY, FILL, AMBIENT, HEADLIGHT = 0.58, 0.20, 0.30, 0.14
"""Strengths."""
KEY_AZIMUTH_DEG = float(np.degrees(np.arctan2(KEY_DIRECTION[1], KEY_DIRECTION[0])))


@dataclass(frozen=True, kw_only=True)
class View:
    """The place of a film's camera at one moment."""

    look_at: F64
    """(3,) [m]"""
    distance_m: float
    azimuth_deg: float
    elevation_deg: float
    radius_m: float
    """Radius round ``look_at`` within which shadows are drawn; 0 draws none."""
    camera: str | None = None
    """Name of a camera of the protocol, which is used instead of the numbers above."""
    fovy_deg: float = 40.0
    light_turns: bool = False
    """Whether the shadow-casting lamp shines over the camera's shoulder, wherever the camera stands, instead of from
    its place in the room."""


class Stage:
    """One OpenGL context for pictures of one size at most. Use it as a context manager."""

    def __init__(self, model: mujoco.MjModel, skin: FilmSkin, *, width: int, height: int) -> None:
        """Take the model and skin of a film (``film_scene``). Raises DependencyError where nothing can be rendered."""
        self._model = model
        self._skin = skin
        quality, far = model.vis.quality, model.vis.global_
        quality.offsamples = SAMPLES
        far.offwidth, far.offheight = max(width, MAP_PX), max(height, MAP_PX)
        model.vis.map.zfar = 8.0
        try:
            self._context: Any = import_opengl()(far.offwidth, far.offheight)
            self._context.make_current()
            self._mjr = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        except (RuntimeError, AttributeError, mujoco.FatalError) as error:
            raise DependencyError(f"cannot render a picture of {width} x {height}: {error}") from None
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._mjr)
        self._option = mujoco.MjvOption()
        self._made = mujoco.MjvScene(model, maxgeom=4 * model.ngeom + 2000)
        for flag in (mujoco.mjtRndFlag.mjRND_REFLECTION, mujoco.mjtRndFlag.mjRND_SHADOW):
            self._made.flags[flag] = False
        self._mjr.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR.value

    def __enter__(self) -> Stage:
        return self

    def __exit__(self, *_: object) -> None:
        self._context.make_current()
        self._mjr.free()
        self._context.free()

    def picture(
        self, data: mujoco.MjData, view: View, size: tuple[int, int], *, grid: SkinGrid | None = None
    ) -> Picture:
        """(height, width, 3) of the world at ``data``, whose kinematics are current; ``size``: (width, height)."""
        self._context.make_current()
        made, camera = self._made, mujoco.MjvCamera()
        if view.camera is not None:
            camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, self._model.camera(view.camera).id
        else:
            camera.type, camera.lookat, camera.distance = mujoco.mjtCamera.mjCAMERA_FREE, view.look_at, view.distance_m
            camera.azimuth, camera.elevation = view.azimuth_deg, view.elevation_deg
            self._model.vis.global_.fovy = view.fovy_deg
        mujoco.mjv_updateScene(
            self._model, data, self._option, mujoco.MjvPerturb(), camera, mujoco.mjtCatBit.mjCAT_ALL.value, made
        )
        vertices = self._skin.shape(data, made)
        key, fill = self._light(view)
        out, depth = self._render(size)
        eye = eye_of(made, size)
        planes, extent = self._model.vis.map, self._model.stat.extent
        near, far = planes.znear * extent, planes.zfar * extent
        # MuJoCo stores reversed depth: 1 at the near plane, 0 at the far plane.
        metres = (near * far / (depth * np.float32(far - near) + near)).astype(np.float32)
        if view.radius_m > 0:
            lamp = Lamp.of(view.look_at, key, view.radius_m)
            lamp.aim(made.camera)
            made.nlight = 0
            height_m = metres_of_lamp(self._render((MAP_PX, MAP_PX))[1])

            def key_share(normal: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
                from_key, from_fill, from_head = (
                    strength * np.maximum(-(normal @ way.astype(np.float32)), 0)
                    for strength, way in ((KEY, key), (FILL, fill), (HEADLIGHT, eye.axes[2]))
                )
                return (from_key / (AMBIENT + from_key + from_fill + from_head)).astype(np.float32)

            shade(out, metres, widened(widened(edges(depth))), eye, lamp, height_m, key_share)
        if grid is not None:
            grid.draw(out, metres, vertices, eye)
        return out

    def _render(self, size: tuple[int, int]) -> tuple[Picture, npt.NDArray[np.float32]]:
        """Draw the prepared scene: (height, width, 3), and (height, width) of MuJoCo's depth buffer."""
        rect, out = mujoco.MjrRect(0, 0, *size), np.empty((size[1], size[0], 3), np.uint8)
        depth = np.empty((size[1], size[0]), np.float32)
        mujoco.mjr_render(rect, self._made, self._mjr)
        mujoco.mjr_readPixels(out, depth, rect, self._mjr)
        return np.ascontiguousarray(out[::-1]), depth[::-1]

    def skin_changed(self) -> None:
        """Take over the skin's texture from the model, after a change of it."""
        self._context.make_current()
        mujoco.mjr_uploadTexture(self._model, self._mjr, self._model.texture("human_skin").id)

    def _light(self, view: View) -> tuple[F64, F64]:
        """Set the lights; returns the directions (3,) of the lamp that casts shadows and of the other one."""
        made = self._made
        turn_deg = view.azimuth_deg + SHOULDER_DEG - KEY_AZIMUTH_DEG if view.light_turns else 0.0
        key, fill = (turned(np.array(way) / np.linalg.norm(way), turn_deg) for way in (KEY_DIRECTION, FILL_DIRECTION))
        made.nlight = 3
        for lamp, direction, diffuse in zip(made.lights, (None, key, fill), (HEADLIGHT, KEY, FILL), strict=False):
            lamp.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
            if direction is not None:
                lamp.dir = direction
            lamp.headlight, lamp.castshadow, lamp.texid = int(direction is None), 0, -1
            lamp.ambient[:] = AMBIENT if direction is None else 0.0
            lamp.diffuse[:] = diffuse
            lamp.specular[:] = 0.0 if direction is None else 0.25 * diffuse
            lamp.attenuation[:] = (1, 0, 0)
        return key, fill


def turned(direction: F64, turn_deg: float) -> F64:
    """(3,) a direction after a turn about the vertical."""
    sine, cosine = np.sin(np.radians(turn_deg)), np.cos(np.radians(turn_deg))
    x, y, z = direction
    return np.array([cosine * x - sine * y, sine * x + cosine * y, z])
