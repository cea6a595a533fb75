"""A soft region in the model: the shell over a bone that the compiled tissue moves, and the bone's core beneath it.

The shell is no part of MuJoCo's degrees of freedom. Each of its vertices has three displacements: along its inward
normal, which the anchor law of the paper's Eq. 3 resists, f_c = K_c phi + D_c dphi/dt, and along two tangents. The
force between neighbours (f_int of Eq. 1) is the discrete Laplacian of the indentation if ``Tissue.coupling_length_m``
is not 0, and that of the tangential displacement if ``Tissue.membrane_n_m`` is not 0. The package
``carecontact.kernel`` solves them in every physics step and pushes bone and tool with equal and opposite forces.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.contract.protocol import Tissue
from carecontact.kernel.region import LOCK, Mesh, add_region
from carecontact.regions import REGIONS, Tube
from carecontact.world.human.body import Array, Body
from carecontact.world.human.plates import BARE_SOLIMP, BARE_SOLREF, SOLIMP, SOLREF
from carecontact.world.human.shell import Shell
from carecontact.world.human.skeleton import HIDDEN_GROUP, ROBOT_ONLY, body_name

CORE_MIN_RADIUS_M = 0.006
CORE_PIECE_M, CORE_SECTOR_RAD = 0.030, np.pi / 3
CELL_M = 0.0075
"""Side of a declared cell, for which pressure, shear and slip are recorded: half the width of the tool's tip. A round
tip that passes over part of a cell wipes more of it than it touches at any moment. By geometry, a disc of 9 mm radius
loses a tenth of its strip on cells of 15 mm, and a thirtieth on these."""


@dataclass(frozen=True, kw_only=True)
class SoftRegion:
    """A region's shell in the model."""

    name: str
    shell: Shell
    tissue: Tissue
    cells: DeclaredCells


@dataclass(frozen=True, kw_only=True)
class DeclaredCells:
    """Patches of the fine part of a shell, of about CELL_M along the region and across it."""

    of_triangle: npt.NDArray[np.int64]
    """(M,) number of the cell of each of the shell's triangles; -1 outside the fine part"""
    centres: Array
    """(C, 3) mesh frame"""
    areas: Array
    """(C,) [m^2]"""

    @classmethod
    def of(cls, shell: Shell, *, limb: bool) -> DeclaredCells:
        middle = shell.grid[shell.triangles].mean(1) - [shell.length_m / 2, 0.0]
        if limb:
            middle = middle * [1.0, shell.radius_m]
        fine = shell.fine[shell.triangles].all(1)
        key = np.floor(middle / CELL_M + 0.5).astype(np.int64)
        _, number = np.unique(key[fine], axis=0, return_inverse=True)
        of_triangle = np.full(len(shell.triangles), -1, np.int64)
        of_triangle[fine] = number.ravel()
        corners = shell.vertices[shell.triangles[fine]]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
        areas = np.bincount(number.ravel(), area).astype(np.float64)
        centres = np.stack([np.bincount(number.ravel(), area * x) for x in corners.mean(1).T], 1) / areas[:, None]
        return cls(of_triangle=of_triangle, centres=centres, areas=areas)


def add_tissue(
    spec: mujoco.MjSpec, body: Body, region: str, shell: Shell, tissue: Tissue, *, tools: str,
    tip: str = "", ledger: bool = False, on: str | None = None, floor: str | None = None,
) -> SoftRegion:  # fmt: skip
    """Add shell and bone core of one region. Call it after the skeleton.

    Args:
        tools: name of the body whose geoms, and those of the bodies under it, touch the shell.
        tip: name of the geom among them that is meant to touch; empty: all are.
        ledger: whether the energy of every step is kept.
        on: name of the body that carries the shell, whose origin is that of the segment's body; by default the
            segment's body.
        floor: name of the plate that carries the core, at the same place; by default the segment's body carries it.
    """
    origin = body.joint_centre[REGIONS[region].segment]
    limb = isinstance(REGIONS[region].shape, Tube)
    cells = DeclaredCells.of(shell, limb=limb)
    mesh = Mesh(
        places=shell.vertices - origin, inward=-shell.normals, along=shell.frame[:, 0], triangles=shell.triangles,
        areas=shell.area, cells=cells.of_triangle,
    )  # fmt: skip
    bone = spec.body(on or body_name(REGIONS[region].segment))
    add_region(spec, name=region, bone=bone, mesh=mesh, tissue=tissue, tools=tools, tip=tip, ledger=ledger,
               lock=LOCK if limb else 0.0)  # fmt: skip
    _add_core(spec, region, shell, tissue, origin, floor=floor)
    return SoftRegion(name=region, shell=shell, tissue=tissue, cells=cells)


def inner_surface(shell: Shell, thickness_m: float) -> Array:
    """Return the shell's vertices (N, 3), moved inward along their normals by the tissue's thickness, but never beyond
    the region's axis.
    """
    room = np.einsum("ij,ij->i", shell.vertices - shell.axis_points, shell.normals) - CORE_MIN_RADIUS_M
    return shell.vertices - np.clip(thickness_m, 0.0, np.maximum(room, 0.0))[:, None] * shell.normals


def _add_core(
    spec: mujoco.MjSpec, region: str, shell: Shell, tissue: Tissue, origin: Array, *, floor: str | None
) -> None:
    """Add the rigid core that the tool meets under fully compressed tissue: convex wedges under the inner surface.

    One hull over the whole region would fill its hollows and be far too near to the skin. A wedge covers only
    CORE_PIECE_M along the region and a sector across it, down to the region's axis.
    """
    inner = inner_surface(shell, tissue.thickness_m) - origin
    axis = shell.axis_points - origin
    limb = isinstance(REGIONS[region].shape, Tube)
    middle = shell.grid[shell.triangles].mean(1)
    width = CORE_SECTOR_RAD if limb else CORE_PIECE_M
    key = np.floor(middle / [CORE_PIECE_M, width] + [0.0, 0.5]).astype(np.int64)
    bone = spec.body(floor or body_name(REGIONS[region].segment))
    solref, solimp = (BARE_SOLREF, BARE_SOLIMP) if floor is None else (SOLREF, SOLIMP)
    for number, piece in enumerate(np.unique(key, axis=0)):
        corners = np.unique(shell.triangles[(key == piece).all(1)])
        points = np.concatenate([inner[corners], axis[corners]])
        name = f"human_core_{region}_{number}"
        spec.add_mesh(name=name, uservert=points.ravel(), maxhullvert=40)
        bone.add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, mass=0, group=HIDDEN_GROUP, condim=3,
            friction=[tissue.friction, 0.005, 0.0001], solref=list(solref), solimp=list(solimp), priority=1,
            **ROBOT_ONLY,
        )  # fmt: skip
