"""Reads the state of a soft region from ``MjData.plugin_state``. The layout is that of ``c/region.h``."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.errors import SceneError
from carecontact.kernel import library

Array = npt.NDArray[np.float64]

HEAD, RING_ROWS, CELL_SIZE = 3, 64, 4
HELD_SIZE, POINTS_EACH = 4, 4
ROW = np.dtype(
    [
        ("force_n", "f8", 3), ("normal_n", "f8"), ("centroid_m", "f8", 3), ("depth_m", "f8"), ("pressure_pa", "f8"),
        ("area_m2", "f8"), ("points", "f8"), ("sweeps", "f8"), ("left_m", "f8"), ("stored_j", "f8"),
        ("kinetic_j", "f8"), ("damped_j", "f8"), ("rubbed_j", "f8"), ("beside_force_n", "f8", (2, 3)),
        ("beside_normal_n", "f8", 2),
    ]
)  # fmt: skip
"""One physics step: the force on the person in world coordinates, the sum of the forces along the tools' normals, the
centre of pressure in world coordinates, the largest indentation, the largest pressure, the area in contact, the number
of contact points, the number of sweeps of the solver, and the largest change in the last sweep. If the region keeps a
ledger of energy, the row also has the energy at the end of the step, and the energy that dampers and friction dissipate
during it. Last comes what of both sums of force is not the tip's, but of the robot's hand and then of its links
(``region.add_region``)."""

_ROW_SIZE = ROW.itemsize // 8


@dataclass(frozen=True, kw_only=True)
class Cells:
    """Sums over time for each declared cell, since the state was last reset. Each array has the shape (C,)."""

    press_ns: Array
    """normal force times time"""
    shear_ns: Array
    """size of the friction force times time"""
    slip_m3: Array
    """slipped distance times area"""
    touch_m2s: Array
    """area in contact times time"""


class Readings:
    """Reads the state of one region of one compiled model."""

    def __init__(self, model: mujoco.MjModel, name: str) -> None:
        self.instance = int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_PLUGIN, name))
        if self.instance < 0:
            raise SceneError(f"the model has no soft region {name}")
        self.name = name
        vertices = model.numeric(f"{name}/vertices").data.reshape(-1, 13)
        triangles = model.numeric(f"{name}/triangles").data.reshape(-1, 5)
        self.bone = int(np.flatnonzero(model.body_plugin == self.instance)[0])
        self.places = vertices[:, :3].copy()
        """(N, 3) vertices at rest, in the bone's frame [m]"""
        self.frames = vertices[:, 3:12].reshape(-1, 3, 3).copy()
        """(N, 3, 3) frame of each vertex; its rows are the inward normal and two tangents"""
        self.areas = vertices[:, 12].copy()
        first, size = int(model.plugin_stateadr[self.instance]), int(model.plugin_statenum[self.instance])
        n, cells = len(vertices), int(triangles[:, 4].max(initial=-1)) + 1
        at = np.cumsum([first + HEAD, 3 * n, 3 * n, HELD_SIZE * POINTS_EACH * len(triangles), CELL_SIZE * cells])
        self._u, self._rate = slice(at[0], at[1]), slice(at[1], at[2])
        self._cells = slice(at[3], at[4])
        self.steps_at = first
        """Index in ``plugin_state`` of the number of steps."""
        self.rows_at = int(at[4]) + np.arange(RING_ROWS * _ROW_SIZE).reshape(RING_ROWS, _ROW_SIZE)
        """(RING_ROWS, numbers in a row) index in ``plugin_state`` of the ring buffer's rows"""
        if size != at[4] - first + RING_ROWS * _ROW_SIZE:
            raise SceneError(f"the state of {name} has {size} numbers, which is not what its mesh needs")
        self._ring = Rings((self,))

    def last(self, data: mujoco.MjData, count: int) -> npt.NDArray[np.void]:
        """Return (count,) rows of the last physics steps, the oldest first, with the fields of ROW.

        Raises SceneError if ``count`` is more than the ring buffer holds or than there were steps.
        """
        return self._ring.last(data, count)[:, 0]

    def now(self, data: mujoco.MjData) -> npt.NDArray[np.void]:
        """Return the row () of the last forward pass, with the fields of ROW."""
        out = np.zeros(1, ROW)
        library.load().carecontact_tissue_row(
            ctypes.c_void_p(data._address), ctypes.c_int(self.instance), ctypes.c_void_p(out.ctypes.data)
        )
        return out[0]

    def displacement(self, data: mujoco.MjData) -> Array:
        """Return (N, 3) the displacement of each vertex along the rows of its frame: inward, and two tangents [m]."""
        return data.plugin_state[self._u].reshape(-1, 3)

    def rate(self, data: mujoco.MjData) -> Array:
        """Return (N, 3) the rate of ``displacement`` [m/s]."""
        return data.plugin_state[self._rate].reshape(-1, 3)

    def set_motion(self, data: mujoco.MjData, displacement: Array, rate: Array) -> None:
        """Set the displacement and rate of the vertices, both (N, 3) or broadcast to it; the next step goes on from
        them."""
        self.displacement(data)[:], self.rate(data)[:] = displacement, rate
        data.plugin_state[self.steps_at + 1] = 1.0

    def vertices(self, data: mujoco.MjData) -> Array:
        """Return (N, 3) the positions of the vertices in the bone's frame [m]."""
        return self.places + np.einsum("ij,ijk->ik", self.displacement(data), self.frames)

    def cells(self, data: mujoco.MjData) -> Cells:
        sums = data.plugin_state[self._cells].reshape(-1, CELL_SIZE).T.copy()
        return Cells(press_ns=sums[0], shear_ns=sums[1], slip_m3=sums[2], touch_m2s=sums[3])

    def generalised_force(self, model: mujoco.MjModel, data: mujoco.MjData) -> Array:
        """Return (nv,) the force that the region added to ``qfrc_passive`` in the last forward pass [N or N m]."""
        out = np.zeros(model.nv)
        library.load().carecontact_tissue_force(
            ctypes.c_void_p(data._address), ctypes.c_int(self.instance), ctypes.c_void_p(out.ctypes.data)
        )
        return out


class Rings:
    """Reads the last steps of several regions of one model at once, which all make a step together."""

    def __init__(self, regions: Sequence[Readings]) -> None:
        self._names = ", ".join(region.name for region in regions)
        self._made = regions[0].steps_at if regions else None
        # (RING_ROWS, R, numbers in a row)
        self._rows = np.stack([region.rows_at for region in regions], 1) if regions else np.zeros((1, 0, 0), np.int64)

    def last(self, data: mujoco.MjData, count: int) -> npt.NDArray[np.void]:
        """Return (count, R) rows of the last physics steps, the oldest first, with the fields of ROW.

        Raises SceneError if ``count`` is more than the ring buffers hold or than there were steps.
        """
        if self._made is None:
            return np.zeros((count, 0), ROW)
        state = data.plugin_state
        made = int(state[self._made])
        if not 0 < count <= min(RING_ROWS, made):
            raise SceneError(f"count {count}: expected 1 to {min(RING_ROWS, made)}, the steps that {self._names} keep")
        steps = np.arange(made - count, made) % RING_ROWS
        return state.take(self._rows.take(steps, 0)).view(ROW)[..., 0]
