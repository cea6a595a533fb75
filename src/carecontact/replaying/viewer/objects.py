"""The objects that Rerun shows: the robot's links, the furniture, and the meshes of the skin."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.replaying.film.skin import FilmSkin
from carecontact.world.furniture import FURNITURE_GROUP
from carecontact.world.robot import VISUAL_GROUP

F64 = npt.NDArray[np.float64]


STILL_M = 3e-4
"""A part of the skin is sent again once one of its vertices has moved this far since it was sent last."""


@dataclass(frozen=True, kw_only=True)
class Solid:
    """A drawn geom, in the frame of its body."""

    name: str
    body: str
    """Name of the body; empty: the world."""
    archetype: Any
    """Archetype of Rerun."""


def solids(model: mujoco.MjModel, rerun: Any) -> Iterator[Solid]:
    """Geoms of the robot and of the furniture. ``rerun``: the module."""
    for geom in range(model.ngeom):
        if model.geom_group[geom] not in (VISUAL_GROUP, FURNITURE_GROUP) or model.geom_rgba[geom, 3] == 0:
            continue
        made = _archetype(model, geom, rerun)
        if made is not None:
            body = model.body(model.geom_bodyid[geom]).name
            yield Solid(
                name=model.geom(geom).name or f"geom{geom}", body="" if body == "world" else body, archetype=made
            )


def _archetype(model: mujoco.MjModel, geom: int, rerun: Any) -> Any:
    kind, size, kinds = model.geom_type[geom], model.geom_size[geom], mujoco.mjtGeom
    position, quat = model.geom_pos[geom], np.roll(model.geom_quat[geom], -1)
    colour = np.round(255 * model.geom_rgba[geom]).astype(np.uint8)
    if kind == kinds.mjGEOM_MESH:
        mesh = model.mesh(model.geom_dataid[geom])
        first, count = int(mesh.vertadr[0]), int(mesh.vertnum[0])
        start, faces = int(mesh.faceadr[0]), int(mesh.facenum[0])
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
        vertices = model.mesh_vert[first : first + count] @ turn.reshape(3, 3).T + position
        return rerun.Mesh3D(
            vertex_positions=vertices, triangle_indices=model.mesh_face[start : start + faces],
            vertex_normals=mesh_normals(vertices, model.mesh_face[start : start + faces]), albedo_factor=colour,
        )  # fmt: skip
    at = {"centers": [position], "quaternions": [rerun.Quaternion(xyzw=quat)], "colors": [colour], "fill_mode": "solid"}
    if kind == kinds.mjGEOM_BOX:
        return rerun.Boxes3D(half_sizes=[size], **at)
    if kind == kinds.mjGEOM_ELLIPSOID:
        return rerun.Ellipsoids3D(half_sizes=[size], **at)
    if kind == kinds.mjGEOM_CYLINDER:
        return rerun.Cylinders3D(lengths=[2 * size[1]], radii=[size[0]], **at)
    return None


def mesh_normals(vertices: F64, faces: npt.NDArray[np.integer]) -> npt.NDArray[np.float32]:
    """(V, 3) area-weighted normals."""
    corner = vertices[faces]
    face = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    total = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(total, faces[:, k], face)
    return (total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)).astype(np.float32)


def skin_colours(model: mujoco.MjModel) -> npt.NDArray[np.uint8]:
    """(V, 3) of the skin's texture at its vertices."""
    texture = model.texture("human_skin")
    width, height, start = int(texture.width[0]), int(texture.height[0]), int(texture.adr[0])
    image = np.asarray(model.tex_data[start : start + 3 * width * height]).reshape(height, width, 3)
    place = np.asarray(model.skin_texcoord).reshape(-1, 2)[: model.nskinvert]
    column = np.clip((place[:, 0] * width).astype(int), 0, width - 1)
    row = np.clip((place[:, 1] * height).astype(int), 0, height - 1)
    return image[row, column]


@dataclass(kw_only=True)
class SkinPart:
    """Some triangles of the skin, which are sent when they have moved."""

    path: str
    vertices: npt.NDArray[np.int64]
    """(n,) of the skin"""
    faces: npt.NDArray[np.int64]
    """(m, 3) of ``vertices``"""
    colours: npt.NDArray[np.uint8]
    """(n, 3)"""
    sent: F64 | None = None

    def changed(self, rerun: Any, vertices: F64, normals: F64) -> Iterator[Any]:
        """The mesh, whole the first time and later without what stays; nothing while it is still."""
        mine = vertices[self.vertices]
        if self.sent is not None and np.abs(mine - self.sent).max() < STILL_M:
            return
        moved = {
            "vertex_positions": mine.astype(np.float32),
            "vertex_normals": normals[self.vertices].astype(np.float32),
        }
        if self.sent is None:
            yield rerun.Mesh3D(**moved, triangle_indices=self.faces, vertex_colors=self.colours)
        else:
            yield rerun.Mesh3D.from_fields(**moved)
        self.sent = mine


def skin_parts(skin: FilmSkin, colours: npt.NDArray[np.uint8]) -> list[SkinPart]:
    """Return the skin in two kinds of parts: those over soft tissue, which can be dented, and the rest."""
    dented = skin.dentable[skin.faces].any(1)
    parts = []
    for name, faces in (("dented", skin.faces[dented]), ("rest", skin.faces[~dented])):
        if len(faces):
            vertices, index = np.unique(faces, return_inverse=True)
            path = f"world/person/skin/{name}"
            parts.append(SkinPart(path=path, vertices=vertices, faces=index.reshape(-1, 3), colours=colours[vertices]))
    return parts
