"""What the plugin has to say of a region: its state in ``MjData.plugin_state``, laid out as ``c/region.h`` has it."""

from __future__ import annotations

import ctypes
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
        ("kinetic_j", "f8"), ("damped_j", "f8"), ("rubbed_j", "f8"),
    ]
)  # fmt: skip
"""One physics step: force on the person in the world, sum of the forces along the tools' normals, centre of pressure in
the world, largest indentation, largest pressure, area in contact, number of contact points, sweeps of the solver and
the largest change in the last; with the ledger, energy held at the end, and lost to dampers and friction during it."""


@dataclass(frozen=True, kw_only=True)
class Cells:
    """Sums since the state was last reset, (C,) each."""

    press_ns: Array
    """normal force times time"""
    shear_ns: Array
    """size of the friction force times time"""
    slip_m3: Array
    """slipped distance times area"""
    touch_m2s: Array
    """area in contact times time"""


class Readings:
    """Of one region in one compiled model."""

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
        """(N, 3, 3) by rows: inward, and two tangents"""
        self.areas = vertices[:, 12].copy()
        first, size = int(model.plugin_stateadr[self.instance]), int(model.plugin_statenum[self.instance])
        n, cells = len(vertices), int(triangles[:, 4].max(initial=-1)) + 1
        at = np.cumsum([first + HEAD, 3 * n, 3 * n, HELD_SIZE * POINTS_EACH * len(triangles), CELL_SIZE * cells])
        self._first = first
        self._u, self._rate = slice(at[0], at[1]), slice(at[1], at[2])
        self._cells, self._ring = slice(at[3], at[4]), slice(at[4], first + size)
        if size != at[4] - first + RING_ROWS * ROW.itemsize // 8:
            raise SceneError(f"the state of {name} has {size} numbers, which is not what its mesh needs")

    def last(self, data: mujoco.MjData, count: int) -> npt.NDArray[np.void]:
        """(count,) rows of the last physics steps, oldest first, with the fields of ROW.

        Raises SceneError for more steps than the ring holds or than were made.
        """
        state = data.plugin_state
        made = int(state[self._first])
        if not 0 < count <= min(RING_ROWS, made):
            raise SceneError(f"count {count}: expected 1 to {min(RING_ROWS, made)}, the steps that {self.name} keeps")
        ring = state[self._ring].view(ROW)
        return ring[(made - count + np.arange(count)) % RING_ROWS]

    def now(self, data: mujoco.MjData) -> npt.NDArray[np.void]:
        """() row of the last forward pass, as of ``last``."""
        out = np.zeros(1, ROW)
        library.load().carecontact_tissue_row(
            ctypes.c_void_p(data._address), ctypes.c_int(self.instance), ctypes.c_void_p(out.ctypes.data)
        )
        return out[0]

    def displacement(self, data: mujoco.MjData) -> Array:
        """(N, 3) of the vertices, along the rows of their frames: inward, and two tangents [m]."""
        return data.plugin_state[self._u].reshape(-1, 3)

    def rate(self, data: mujoco.MjData) -> Array:
        """(N, 3) of the displacement [m/s]."""
        return data.plugin_state[self._rate].reshape(-1, 3)

    def vertices(self, data: mujoco.MjData) -> Array:
        """(N, 3) where the vertices are, in the bone's frame [m]."""
        return self.places + np.einsum("ij,ijk->ik", self.displacement(data), self.frames)

    def cells(self, data: mujoco.MjData) -> Cells:
        sums = data.plugin_state[self._cells].reshape(-1, CELL_SIZE).T.copy()
        return Cells(press_ns=sums[0], shear_ns=sums[1], slip_m3=sums[2], touch_m2s=sums[3])

    def generalised_force(self, model: mujoco.MjModel, data: mujoco.MjData) -> Array:
        """(nv,) what the region added to qfrc_passive in the last forward pass."""
        out = np.zeros(model.nv)
        library.load().carecontact_tissue_force(
            ctypes.c_void_p(data._address), ctypes.c_int(self.instance), ctypes.c_void_p(out.ctypes.data)
        )
        return out
