"""The skin as a video shows it: finer round the region, dented where the shell beneath it is dented, evenly shaded."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from carecontact.kernel.readings import Readings
from carecontact.regions import REGIONS
from carecontact.sim.true_skin import skin_in_world
from carecontact.world.human.breathing import move_skin
from carecontact.world.human.refine import refined
from carecontact.world.human.skin import add_skin
from carecontact.world.scene import Scene, build_spec, controlled

F64 = npt.NDArray[np.float64]

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

    def shape(self, data: mujoco.MjData, made: mujoco.MjvScene) -> tuple[F64, F64]:
        """Dent and shade the skin of a prepared scene, in place; returns vertices and normals (V, 3) in the world."""
        drawn = np.asarray(made.skinvert).reshape(-1, 3)[: self._count]
        vertices, normals = self._dented(data, drawn.astype(np.float64))
        drawn[:] = vertices
        np.asarray(made.skinnormal).reshape(-1, 3)[: self._count] = normals
        return vertices, normals

    def placed(self, data: mujoco.MjData) -> tuple[F64, F64]:
        """Return vertices and normals (V, 3) in the world, without a prepared scene."""
        return self._dented(data, skin_in_world(self._model, data))

    def _dented(self, data: mujoco.MjData, vertices: F64) -> tuple[F64, F64]:
        for felt, follow in self._follow.values():
            moved = (felt.vertices(data) - felt.places) @ data.xmat[felt.bone].reshape(3, 3).T
            if np.abs(moved).max() > MOVED_M:
                vertices += follow @ moved
        self._keep_out(data, vertices)
        return vertices, self._normals(vertices)

    def _keep_out(self, data: mujoco.MjData, vertices: F64) -> None:
        middle, turn = data.geom_xpos[self._tip], data.geom_xmat[self._tip].reshape(3, 3)
        near = np.flatnonzero((np.abs(vertices - middle) < self._half.max()).all(1))
        local = (vertices[near] - middle) @ turn / self._half
        size = np.linalg.norm(local, axis=1)
        inside = (size < 1) & (size > 0.3)
        out = local[inside] / size[inside, None] * self._half
        vertices[near[inside]] = middle + out @ turn.T

    def _normals(self, vertices: F64) -> F64:
        """Area-weighted, one for each place of the body, so that no seam shows."""
        a, b, c = (vertices[self.faces[:, k]] for k in range(3))
        total = self._corners @ np.cross(b - a, c - a)
        total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)
        return total[self._place]


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
