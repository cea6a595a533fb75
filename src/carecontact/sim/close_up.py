"""A picture of the contact: a free camera beside the tool, with the skin dented where the shell is."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.interface.geometry import quat_from_matrix
from carecontact.interface.regions import REGIONS
from carecontact.sim.rendering import SceneRenderer
from carecontact.tissue.plugin import Readings
from carecontact.world.scene import Scene

REACH_M = 0.016
"""Skin vertices nearer than this to a vertex of the shell follow it."""
NEIGHBOURS_M = 2 * REACH_M
"""The four vertices of the shell beneath a skin vertex that follows it are nearer."""
VISIBLE_M = 5e-4
DISTANCE_M, ELEVATION_DEG = 0.22, -20.0
"""Of the camera from where it looks; the picture then shows 0.3 m of the skin, a region of a limb."""
ABOVE_TIP_M = 0.02


@dataclass(frozen=True, kw_only=True)
class CloseUp:
    image: npt.NDArray[np.uint8]
    """(H, W, 3)"""
    pose_camera_in_world: npt.NDArray[np.float64]
    """(7,) position [m] and quat_wxyz of the camera: x to the right, y down, z along its line of sight."""
    focal_px: float
    """Focal length; the optical axis meets the picture in its middle."""


def render_close_up(
    renderer: SceneRenderer, scene: Scene, data: mujoco.MjData, *, region: str, shift: npt.NDArray[np.float64]
) -> CloseUp:
    """A picture of the exterior camera's size, of the tool's tip. For people to look at, never for a policy.

    Args:
        shift: (V, 3) of the skin's vertices in this state (``skin_shift``) [m].
    """
    look_at = data.site(scene.robot.tcp_site).xpos + [0, 0, ABOVE_TIP_M]
    azimuth_deg = REGIONS[region].close_up_azimuth_deg
    view = {"distance_m": DISTANCE_M, "azimuth_deg": azimuth_deg, "elevation_deg": ELEVATION_DEG}
    dented = partial(dent, scene, shift=shift)
    image = renderer.free_view(data, look_at=look_at, size_of="exterior", edit=dented, **view)
    # MuJoCo's free camera: azimuth about the vertical from the x axis, elevation above the horizon.
    azimuth, elevation = np.radians([azimuth_deg, ELEVATION_DEG])
    forward = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    turn = np.stack([right, np.cross(forward, right), forward], axis=1)
    half = np.radians(float(scene.model.vis.global_.fovy)) / 2
    return CloseUp(
        image=image,
        pose_camera_in_world=np.concatenate([look_at - DISTANCE_M * forward, quat_from_matrix(turn)]),
        focal_px=float(image.shape[0] / 2 / np.tan(half)),
    )


def dent(scene: Scene, made: mujoco.MjvScene, shift: npt.NDArray[np.float64]) -> None:
    """Move the drawn skin's vertices by ``shift`` (V, 3) [m], in place."""
    model = scene.model
    faces = np.asarray(model.skin_face).reshape(-1, 3)
    drawn = np.asarray(made.skinvert).reshape(-1, 3)[: model.nskinvert]
    drawn += shift.astype(drawn.dtype)
    # Elsewhere the interpolated normals are smoother than those of the split triangles.
    touched = np.linalg.norm(shift, axis=1) > VISIBLE_M
    _renew_normals(drawn, np.asarray(made.skinnormal).reshape(-1, 3)[: model.nskinvert], faces, touched)


def skin_shift(scene: Scene, data: mujoco.MjData) -> npt.NDArray[np.float64]:
    """(V, 3) by how much the shells of the soft regions move each vertex of the skin, in the world [m]."""
    model = scene.model
    bind = np.asarray(model.skin_vert).reshape(-1, 3)[: model.nskinvert]
    total = np.zeros((len(bind), 3))
    for name, region in scene.regions.items():
        felt = Readings(model, name)
        moved = (felt.vertices(data) - felt.places) @ data.xmat[felt.bone].reshape(3, 3).T
        if np.abs(moved).max() < 2e-4:
            continue
        # The rest of the shell is at rest, and so is the skin whose neighbours are: most of both.
        points = region.shell.vertices
        near = np.flatnonzero(_within(bind, points[moved.any(1)], NEIGHBOURS_M))
        if not near.size:
            continue
        round_ = _within(points, bind[near], NEIGHBOURS_M)
        points, moved = points[round_], moved[round_]
        order, d = nearest(bind[near], points)
        weight = 1 / (d + 0.002) ** 2
        weight /= weight.sum(1, keepdims=True)
        fade = np.clip((REACH_M - d[:, 0]) / (REACH_M / 2), 0, 1)
        total[near] += np.einsum("ij,ijk->ik", weight, moved[order]) * fade[:, None]
    return total


def nearest(places: npt.NDArray[Any], points: npt.NDArray[Any]) -> tuple[npt.NDArray[np.int64], npt.NDArray[Any]]:
    """(n, 4) the points nearest to each place (all where there are fewer), nearest first, and their distances."""
    x, y, z = (places[:, None, k] - points[None, :, k] for k in range(3))
    square = x * x + y * y + z * z
    some = np.argpartition(square, min(3, len(points) - 1), axis=1)[:, :4]
    order = np.take_along_axis(some, np.argsort(np.take_along_axis(square, some, 1), axis=1), 1)
    return order, np.sqrt(np.take_along_axis(square, order, 1))


def _within(places: npt.NDArray[Any], others: npt.NDArray[Any], margin_m: float) -> npt.NDArray[np.bool_]:
    """(n,) which places (n, 3) lie in the box round others (m, 3) with a margin."""
    return ((places > others.min(0) - margin_m) & (places < others.max(0) + margin_m)).all(1)


def _renew_normals(
    vertices: npt.NDArray[np.float32],
    normals: npt.NDArray[np.float32],
    faces: npt.NDArray[np.int32],
    touched: npt.NDArray[np.bool_],
) -> None:
    """Area-weighted vertex normals of what moved, in place: without them a dent would not be shaded."""
    mine = faces[touched[faces].any(1)]
    corner = vertices[mine].astype(np.float64)
    face = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    total = np.zeros((len(vertices), 3))
    for k in range(3):
        np.add.at(total, mine[:, k], face)
    index = np.flatnonzero(touched)
    size = np.linalg.norm(total[index], axis=1, keepdims=True)
    normals[index] = np.where(size > 0, total[index] / np.maximum(size, 1e-12), normals[index])
