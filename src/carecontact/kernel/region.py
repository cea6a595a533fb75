"""Adds a soft region to a MuJoCo model: an instance of the plugin on the bone, and the numbers that it reads.

The arrays travel as custom numerics ``<name>/vertices``, ``/edges``, ``/triangles``, ``/law``, ``/options`` and
``/contact``; their columns are those of ``c/region.h``.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from functools import cached_property

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.contract.protocol import Tissue
from carecontact.kernel import library

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
the thickness being h, its pressure is higher by LOCK a h (w / h)^3 (docs/tissue.md). Kept in step with
``c/region.h``."""
FIRM_FROM, FIRMS_OVER, THINNEST = 0.5, 0.1, 0.2
"""Tissue that does not lock grows firmer across where it is pressed to more than the first share of its thickness, over
the next FIRMS_OVER of it, and at least THINNEST of it counts as left (docs/tissue.md). Kept in step with
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

    @property
    def cell_count(self) -> int:
        return int(self.cells.max(initial=-1)) + 1


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
        square of the displacement across. The stiffness across grows where that along does (docs/tissue.md).
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
        return cls(
            a_n_m3=tissue.a_n_m3, b_n_m4=tissue.b_n_m4, c_n_m5=tissue.c_n_m5, damping_ns_m3=tissue.damping_ns_m3,
            damping_growth_ns_m4=tissue.damping_growth_ns_m4, mass_kg_m2=tissue.areal_mass_kg_m2,
            coupling_n_m=tissue.a_n_m3 * tissue.coupling_length_m**2, membrane_n_m=tissue.membrane_n_m,
            friction=tissue.friction, contact_n_m3=tissue.contact_n_m3, thickness_m=tissue.thickness_m,
        )  # fmt: skip


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
        mesh: the region's surface.
        tissue: the constants of the tissue.
        tools: name of a body. The region can be touched by the geoms of this body and of the bodies below it whose
            contype has bit 1.
        tip: name of the geom among them that is meant to touch. Of the force of any other, a row says whether it
            belongs to the same body or to another; empty: all are meant to touch.
        ledger: whether to keep the energy of every step (``Readings``), which takes a tenth of the solver's time.
        layer_m: see LAYER_M.
        entry_m: see ENTRY_M.
        lock: see LOCK; at 0, the tissue does not lock.

    Raises DependencyError if the compiled tissue is missing.
    """
    library.load()
    spec.activate_plugin(library.PLUGIN)
    edges, weights = mesh.edges
    reach = max(REACH_M, REACH_LENGTHS * tissue.coupling_length_m)
    numbers = {
        "vertices": np.c_[mesh.places, mesh.frames.reshape(-1, 9), mesh.areas], "edges": np.c_[edges, weights],
        "triangles": mesh.rows, "law": np.array(astuple(Law.of(tissue))),
        "options": np.array([reach, TOLERANCE_M, SWEEPS, ledger], np.float64),
        "contact": np.array([layer_m, entry_m, lock]),
    }  # fmt: skip
    for kind, values in numbers.items():
        spec.add_numeric(name=f"{name}/{kind}", data=values.ravel().tolist(), size=values.size)
    made = spec.add_plugin(name=name, plugin_name=library.PLUGIN, active=True)
    # The plugin is asked for the size of its state before the model has its numerics.
    counts = {kind: len(numbers[kind]) for kind in ("vertices", "edges", "triangles")} | {"cells": mesh.cell_count}
    made.config = {"key": name, "tools": tools, "tip": tip, **{kind: str(count) for kind, count in counts.items()}}
    bone.plugin.active, bone.plugin.name, bone.plugin.plugin_name, bone.plugin.id = True, name, library.PLUGIN, made


def set_law(model: mujoco.MjModel, name: str, tissue: Tissue) -> None:
    """Change the constants of a region's tissue in a compiled model. They hold from the next step."""
    model.numeric(f"{name}/law").data[:] = astuple(Law.of(tissue))
