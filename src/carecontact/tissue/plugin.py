"""The tissue's plugin in MuJoCo: loads the binary once after checking it, declares a soft region in a model, and reads
what the plugin measured."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass, fields
from functools import cache, cached_property
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.errors import DependencyError, SceneError
from carecontact.protocol.person import Tissue
from carecontact.tissue import binary_lookup

PLUGIN = "carecontact.tissue"
"""Name of the tissue's plugin in a MuJoCo model."""
LIFE_PLUGIN = "carecontact.life"
"""Name of the plugin that moves a person who breathes or moves the arm."""

_loading = threading.Lock()


def load_plugins() -> ctypes.CDLL:
    """Register the plugins with MuJoCo, so that models that name them can be compiled, and return the library, which is
    loaded once.

    Raises DependencyError as ``binary_file`` does, if the binary does not load, and if another library has registered a
    plugin with one of these names.
    """
    with _loading:
        return _load()


@cache
def _load() -> ctypes.CDLL:
    file = str(binary_lookup.binary_file())
    try:
        mujoco.mj_loadPluginLibrary(file)
        library = ctypes.CDLL(file)
    except (mujoco.FatalError, OSError) as error:
        raise DependencyError(f"the compiled tissue does not load: {' '.join(str(error).split())}") from None
    library.carecontact_kernel_version.restype = ctypes.c_char_p
    if not library.carecontact_kernel_registered():
        raise DependencyError(
            f"another library has registered a MuJoCo plugin named {PLUGIN} or {LIFE_PLUGIN} in this process; start "
            f"Python again and load only {file}"
        )
    return library


@cache
def loaded_sha256() -> str:
    """Return the sha256 (hex) of the binary that this process has loaded: it is one and the same from then on."""
    load_plugins()
    return binary_lookup.binary_sha256()


# A soft region is an instance of the plugin on the bone. It reads the custom numerics ``<name>/vertices``, ``/edges``,
# ``/triangles``, ``/law``, ``/options`` and ``/contact``, whose columns are those of ``c/region.h``.

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

REACH_M, REACH_LENGTHS = 0.025, 5.0
"""Vertices stay at rest if they are farther from every tool than this distance and than this number of coupling
lengths. The depth of a dimple falls by a factor of e in each coupling length, so the part that is cut off bears about a
hundredth of the load."""
TOLERANCE_M = 1e-6
"""The solver stops when no vertex moves farther than this in a sweep. With a tenth of it, measured peaks changed by
less than 0.1 %."""
LAYER_M = 0.0015
"""Depth in the contact layer at which its pressure is twice that of a linear layer, [m]. At 0, the layer is linear."""
ENTRY_M = 0.006
"""Way of a tool over which skin that it has not pressed comes to bear, by a factor of e, [m]. At 0, such skin bears
nothing beside an upright wall, and once the wall is no longer upright to it, all at once. Chosen for a cap that scrubs
the abdomen with 15 N: with 2 to 3 mm its force rattles, and with 8 mm its mean is 10 to 15 % off the one asked for."""
LOCK_FROM, LOCK = 0.6, 16.0
"""Tissue of a limb that is pressed to more than this share of its thickness locks: at w over that depth, the rest of
the thickness being h, its pressure is higher by LOCK a h (w / h)^3 (docs/evidence/tissue.md). Kept in step with
``c/region.h``."""
FIRM_FROM, FIRMS_OVER, THINNEST = 0.5, 0.1, 0.2
"""Tissue that does not lock grows firmer across where it is pressed to more than the first share of its thickness, over
the next FIRMS_OVER of it, and at least THINNEST of it counts as left (docs/evidence/tissue.md). Kept in step with
``c/region.h``."""
SWEEPS = 60
"""Largest number of sweeps of the solver in a step. In scrubs, half of the steps take one or two, 95 % at most four,
and the most was 13 (measured)."""


@dataclass(frozen=True, kw_only=True)
class Mesh:
    """A region's surface in the frame of its bone."""

    places: Array
    """(N, 3) vertices [m]"""
    inward: Array
    """(N, 3) inward unit normal of each vertex"""
    along: Array
    """(3,) the direction from which every vertex takes its first tangent"""
    triangles: Indices
    """(M, 3) indices of the vertices of each triangle"""
    areas: Array
    """(N,) area of the surface that belongs to each vertex [m^2]"""
    cells: Indices
    """(M,) index of the declared cell in which each triangle's centre lies, or -1 if it lies in none"""

    @cached_property
    def frames(self) -> Array:
        """(N, 3, 3) frame of each vertex; its rows are the inward normal and two tangents."""
        first = self.along - (self.inward @ self.along)[:, None] * self.inward
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        return np.stack([self.inward, first, np.cross(self.inward, first)], 1).astype(np.float64)

    @cached_property
    def edges(self) -> tuple[Indices, Array]:
        """The edges as pairs of vertices (E, 2), and their cotangent weights (E,).

        The sum over edges of weight times squared difference is the linear finite element form of the integral of
        |grad w|^2 over the surface (Pinkall and Polthier 1993), so that it does not depend on the mesh.
        """
        corners = np.concatenate([np.roll(self.triangles, -k, axis=1) for k in range(3)])
        u, v = (self.places[corners[:, k]] - self.places[corners[:, 2]] for k in (0, 1))
        cotangent = (u * v).sum(1) / np.linalg.norm(np.cross(u, v), axis=1)
        edges, owner = np.unique(np.sort(corners[:, :2], axis=1), axis=0, return_inverse=True)
        weights = np.zeros(len(edges))
        np.add.at(weights, owner.ravel(), cotangent / 2)
        # A weight below zero (obtuse pairs) would let a spring push neighbours apart.
        return edges[weights > 0].astype(np.int64), weights[weights > 0]

    @cached_property
    def rows(self) -> Array:
        """(M, 5) one row for each triangle: three vertices, area [m^2], declared cell."""
        a, b, c = (self.places[self.triangles[:, k]] for k in range(3))
        return np.c_[self.triangles, np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2, self.cells]


@dataclass(frozen=True, kw_only=True)
class Law:
    """The constants of the tissue as the numeric ``/law`` holds them, in the order of ``c/region.h``.

    Stiffness, damping and mass are per area of the surface, as their units say.
    """

    a_n_m3: float
    b_n_m4: float
    c_n_m5: float
    damping_ns_m3: float
    damping_growth_ns_m4: float
    mass_kg_m2: float
    coupling_n_m: float
    membrane_n_m: float
    friction: float
    contact_n_m3: float
    thickness_m: float

    def normal_pa(self, inward_m: Array, *, lock: float = LOCK) -> Array:
        """Return the pressure (N,) of the anchors along the normal at indentations (N,), without their dampers and
        without displacements along the tangents.

        ``lock``: as in ``add_region``.
        """
        size, rest = np.abs(inward_m), (1 - LOCK_FROM) * self.thickness_m
        over = np.maximum(inward_m - LOCK_FROM * self.thickness_m, 0.0)
        polynomial = (self.a_n_m3 + self.b_n_m4 * size + self.c_n_m5 * size**2) * inward_m
        return polynomial + lock * self.a_n_m3 * over**3 / rest**2

    def anchors_pa(self, moved_m: Array, *, lock: float = LOCK) -> Array:
        """Return the force per area (N, 3) of the anchors at displacements (N, 3), without their dampers.

        It is the gradient of their energy per area: that of ``normal_pa``, plus half of the stiffness across times the
        square of the displacement across. The stiffness across grows where that along does (docs/evidence/tissue.md).
        ``lock``: as in ``add_region``.
        """
        soft, start = FIRMS_OVER * self.thickness_m, np.array(FIRM_FROM * self.thickness_m)

        def across(inward_m: Array) -> Array:
            deep = np.maximum(inward_m, start)
            more = self.normal_pa(deep, lock=lock) / deep - self.normal_pa(start, lock=lock) / start
            share = (deep - start) / (deep - start + soft) if lock == 0 else 0.0
            return self.a_n_m3 + more * share / np.maximum(THINNEST, 1 - deep / self.thickness_m)

        inward, beside, tiny = moved_m[:, 0], moved_m[:, 1:], 1e-7
        grows = (across(inward + tiny) - across(inward - tiny)) / (2 * tiny)
        normal = self.normal_pa(inward, lock=lock) + grows * (beside**2).sum(1) / 2
        return np.c_[normal, across(inward)[:, None] * beside]

    @classmethod
    def of(cls, tissue: Tissue) -> Law:
        """Return the constants of a row of tissue."""
        mass, coupling = tissue.areal_mass_kg_m2, tissue.a_n_m3 * tissue.coupling_length_m**2
        same = tissue.model_dump(include={field.name for field in fields(cls)})
        return cls(**same, mass_kg_m2=mass, coupling_n_m=coupling)


def add_region(
    spec: mujoco.MjSpec,
    *,
    name: str,
    bone: mujoco.MjsBody,
    mesh: Mesh,
    tissue: Tissue,
    tools: str,
    tip: str = "",
    ledger: bool = False,
    layer_m: float = LAYER_M,
    entry_m: float = ENTRY_M,
    lock: float = LOCK,
) -> None:
    """Add a soft region to a bone of an uncompiled model.

    Args:
        name: name of the plugin's instance, and prefix of the names of its custom numerics.
        bone: the body that carries the region.
        tools: name of a body. The region can be touched by the geoms of this body and of the bodies below it whose
            contype has bit 1.
        tip: name of the geom among them that is meant to touch. Of the force of any other, a row says whether it
            belongs to the same body or to another; empty: all are meant to touch.
        ledger: whether to keep the energy of every step (``Readings``), which takes a tenth of the solver's time.
        layer_m, entry_m, lock: see LAYER_M, ENTRY_M and LOCK; at a lock of 0, the tissue does not lock.

    Raises DependencyError if the compiled tissue is missing.
    """
    load_plugins()
    spec.activate_plugin(PLUGIN)
    edges, weights = mesh.edges
    reach = max(REACH_M, REACH_LENGTHS * tissue.coupling_length_m)
    numbers = {
        "vertices": np.c_[mesh.places, mesh.frames.reshape(-1, 9), mesh.areas],
        "edges": np.c_[edges, weights],
        "triangles": mesh.rows,
        "law": np.array(astuple(Law.of(tissue))),
        "options": np.array([reach, TOLERANCE_M, SWEEPS, ledger], np.float64),
        "contact": np.array([layer_m, entry_m, lock]),
    }
    for kind, values in numbers.items():
        spec.add_numeric(name=f"{name}/{kind}", data=values.ravel().tolist(), size=values.size)
    made = spec.add_plugin(name=name, plugin_name=PLUGIN, active=True)
    # MuJoCo asks the plugin for the size of its state before the model has its numerics.
    counts = {kind: str(len(numbers[kind])) for kind in ("vertices", "edges", "triangles")}
    made.config = {"key": name, "tools": tools, "tip": tip, **counts, "cells": str(mesh.cells.max(initial=-1) + 1)}
    bone.plugin.active, bone.plugin.name, bone.plugin.plugin_name, bone.plugin.id = True, name, PLUGIN, made


def set_law(model: mujoco.MjModel, name: str, tissue: Tissue) -> None:
    """Change the constants of a region's tissue in a compiled model. They hold from the next step."""
    model.numeric(f"{name}/law").data[:] = astuple(Law.of(tissue))


# The layout of a region's state in ``MjData.plugin_state``, as in ``c/region.h``.
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
(``add_region``)."""
_ROW_SIZE = ROW.itemsize // 8


@dataclass(frozen=True)
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
        return self._filled(load_plugins().carecontact_tissue_row, data, np.zeros(1, ROW))[0]

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
        return Cells(*data.plugin_state[self._cells].reshape(-1, CELL_SIZE).T.copy())

    def generalised_force(self, model: mujoco.MjModel, data: mujoco.MjData) -> Array:
        """Return (nv,) the force that the region added to ``qfrc_passive`` in the last forward pass [N or N m]."""
        return self._filled(load_plugins().carecontact_tissue_force, data, np.zeros(model.nv))

    def _filled(self, fill: Callable[..., object], data: mujoco.MjData, out: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Let a function of the plugin write into ``out`` what it knows of this region, and return ``out``."""
        fill(ctypes.c_void_p(data._address), ctypes.c_int(self.instance), ctypes.c_void_p(out.ctypes.data))
        return out


class Rings:
    """Reads the last steps of several regions of one model at once."""

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
        kept = min(RING_ROWS, made)
        if not 0 < count <= kept:
            raise SceneError(f"count {count}: expected 1 to {kept}, the steps that {self._names} keep")
        steps = np.arange(made - count, made) % RING_ROWS
        return state.take(self._rows.take(steps, 0)).view(ROW)[..., 0]
