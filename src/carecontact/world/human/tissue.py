"""A soft region in the model: free shell vertices on slides whose springs and dampers are the tissue.

Each free vertex is a small body with one slide along the inward normal of its cell; the cell is a body under the bone
with two tangential slides, so that neighbouring vertices glide over the bone together. The slides' polynomial stiffness
and damping are the anchor law of the paper's Eq. 3, f_c = K_c phi + D_c dphi/dt; the reaction on the skeleton comes out
of the kinematic tree. The flex over the vertices gives collision. Interaction between neighbours (f_int of Eq. 1) is
made of fixed tendons: a discrete Laplacian of the vertices' indentation, where ``Tissue.coupling_length_m`` is not 0,
and one of the cells' gliding, where ``Tissue.membrane_n_m`` is not 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.contract.protocol import Tissue
from carecontact.errors import ConfigError
from carecontact.regions import REGIONS, Tube
from carecontact.world.human.body import Array, Body
from carecontact.world.human.shell import Shell
from carecontact.world.human.skeleton import HIDDEN_GROUP, ROBOT_ONLY, body_name, tissue_body_name

FLEX_RADIUS_M = 0.002
FLEX_GROUP = 4
CORE_MIN_RADIUS_M = 0.006
CORE_PIECE_M, CORE_SECTOR_RAD = 0.030, np.pi / 3
CELL_MASS_KG = 1e-9
"""Of the cell itself: its vertices carry the tissue's mass."""
SOLREF = (0.01, 1.0)
SOLIMP = (0.94, 0.985, 0.003, 0.5, 2.0)
"""Soft at first touch: with 0.98 to 0.995 a tool sliding at 0.1 m/s and 15 N rattled by 0.46 N rms above 20 Hz, with
this by 0.07."""


@dataclass(frozen=True, kw_only=True)
class SoftRegion:
    """A region's shell in the model."""

    name: str
    shell: Shell
    tissue: Tissue
    vertex_index: npt.NDArray[np.int64]
    """(n,) shell vertices that are free, in the order of their bodies"""


def shell_points(shell: Shell, tissue: Tissue) -> tuple[Array, Array]:
    """Masses (n,) [kg] and places (n, 3) of the free vertices in the mesh frame."""
    free = ~shell.pinned
    return tissue.areal_mass_kg_m2 * shell.area[free], shell.vertices[free] - shell.normals[free] * FLEX_RADIUS_M


def add_tissue(spec: mujoco.MjSpec, body: Body, region: str, shell: Shell, tissue: Tissue) -> SoftRegion:
    """Add cells, vertices, flex and bone core of one region. Call after the skeleton."""
    origin = body.joint_centre[REGIONS[region].segment]
    carrier = spec.body(tissue_body_name(region))
    local = shell.vertices - origin - shell.normals * FLEX_RADIUS_M
    slide = mujoco.mjtJoint.mjJNT_SLIDE
    cells: list[mujoco.MjsBody] = []
    for c, frame in enumerate(shell.cell_frames):
        cell = carrier.add_body(name=f"{region}_cell{c}", mass=CELL_MASS_KG, explicitinertial=True)
        cell.inertia = np.full(3, CELL_MASS_KG * 1e-5)
        stiffness = tissue.a_n_m3 * float(shell.area[shell.cell == c].sum())
        for kind, axis in zip("tb", frame.T[:2], strict=True):
            cell.add_joint(name=f"{region}_cell{c}_{kind}", type=slide, axis=axis, stiffness=[stiffness, 0, 0])
        cells.append(cell)
    names: list[str] = []
    positions = np.zeros_like(local)
    for k in range(len(local)):
        if shell.pinned[k]:
            names.append(tissue_body_name(region))
            positions[k] = local[k]
            continue
        name = f"{region}_v{k}"
        names.append(name)
        area = float(shell.area[k])
        vertex = cells[shell.cell[k]].add_body(
            name=name, pos=local[k], mass=tissue.areal_mass_kg_m2 * area, explicitinertial=True
        )
        # Left unset, the compiler would put the mass at twice the body's offset from the bone.
        vertex.ipos = [0, 0, 0]
        vertex.inertia = np.full(3, vertex.mass * 1e-5)
        law = [tissue.a_n_m3 * area, tissue.b_n_m4 * area, tissue.c_n_m5 * area]
        vertex.add_joint(name=f"{name}_n", type=slide, axis=shell.inward[k], stiffness=law)
    spec.add_flex(
        name=region, dim=2, radius=FLEX_RADIUS_M, vertbody=names, vert=positions.ravel(),
        elem=shell.triangles.ravel().astype(np.int32), contype=0, conaffinity=1, condim=3,
        friction=[tissue.friction, 0.005, 0.0001], solref=SOLREF, solimp=SOLIMP, priority=1,
        selfcollide=mujoco.mjtFlexSelf.mjFLEXSELF_NONE, group=FLEX_GROUP, rgba=[0.87, 0.67, 0.56, 1],
    )  # fmt: skip
    if tissue.coupling_length_m > 0:
        _add_coupling(spec, region, shell, tissue.a_n_m3 * tissue.coupling_length_m**2)
    if tissue.membrane_n_m > 0:
        _add_membrane(spec, region, shell, tissue.membrane_n_m)
    _add_core(spec, region, shell, tissue, origin)
    return SoftRegion(name=region, shell=shell, tissue=tissue, vertex_index=np.flatnonzero(~shell.pinned))


def coupling_weights(shell: Shell) -> tuple[npt.NDArray[np.int64], Array]:
    """Edges (E, 2) with a free end, and their cotangent weights (E,).

    The sum over edges of weight times squared difference is the linear finite element form of the integral of
    |grad w|^2 over the surface (Pinkall and Polthier 1993), so it does not depend on the mesh.
    """
    corners = np.concatenate([np.roll(shell.triangles, -k, axis=1) for k in range(3)])
    u, v = (shell.vertices[corners[:, k]] - shell.vertices[corners[:, 2]] for k in (0, 1))
    cotangent = (u * v).sum(1) / np.linalg.norm(np.cross(u, v), axis=1)
    edges, owner = np.unique(np.sort(corners[:, :2], axis=1), axis=0, return_inverse=True)
    weights = np.zeros(len(edges))
    np.add.at(weights, owner.ravel(), cotangent / 2)
    # A weight below zero (obtuse pairs) would let a spring push neighbours apart.
    kept = (weights > 0) & ~shell.pinned[edges].all(1)
    return edges[kept].astype(np.int64), weights[kept]


def membrane_weights(shell: Shell) -> tuple[npt.NDArray[np.int64], Array]:
    """Pairs (P, 2) of neighbouring cells, and for each the length of their common border over their distance (P,).

    Finite volumes: the sum over pairs of weight times squared difference of the cells' displacement approximates the
    integral of its squared gradient. A mesh edge with one end in each cell crosses a border of weight times its length,
    with the weight of ``coupling_weights``.
    """
    edges, weights = coupling_weights(shell)
    pair = np.sort(shell.cell[edges], axis=1)
    across = (pair[:, 0] >= 0) & (pair[:, 0] != pair[:, 1])
    ends = shell.vertices[edges[across]]
    border = weights[across] * np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    pairs, owner = np.unique(pair[across], axis=0, return_inverse=True)
    length = np.bincount(owner.ravel(), border, minlength=len(pairs))
    middle = np.array([shell.vertices[shell.cell == c].mean(0) for c in range(len(shell.cell_frames))])
    return pairs, length / np.linalg.norm(middle[pairs[:, 0]] - middle[pairs[:, 1]], axis=1)


def check_step(region: str, shell: Shell, tissue: Tissue, dt_s: float) -> None:
    """Raise ConfigError where the springs are too stiff for the time step.

    The integrator takes springs explicitly and dampers implicitly: a mode of frequency w and damping rate g = D_c / m
    grows where (w dt)^2 > 4 + 2 g dt.
    """
    free = ~shell.pinned
    area = shell.area[free]
    row = np.full(len(shell.vertices), -1)
    row[free] = np.arange(len(area))
    edges, weights = coupling_weights(shell)
    cell_area = np.bincount(shell.cell[free], area).astype(np.float64)
    normal = _springs(tissue.a_n_m3 * area, row[edges], tissue.a_n_m3 * tissue.coupling_length_m**2 * weights)
    pairs, shares = membrane_weights(shell)
    tangential = _springs(tissue.a_n_m3 * cell_area, pairs, tissue.membrane_n_m * shares)
    limit = 4 + 2 * dt_s * tissue.damping_ns_m3 / tissue.areal_mass_kg_m2
    for matrix, areas, field in (
        (normal, area, f"coupling_length_m {tissue.coupling_length_m:g}"),
        (tangential, cell_area, f"membrane_n_m {tissue.membrane_n_m:g}"),
    ):
        largest = dt_s**2 * _fastest(matrix, tissue.areal_mass_kg_m2 * areas, limit / dt_s**2)
        if largest >= limit:
            raise ConfigError(
                f"tissue of the {region}: a_n_m3 {tissue.a_n_m3:g} with {field} on a mesh of "
                f"{1000 * tissue.spacing_m:g} mm is unstable at time steps of {1000 * dt_s:g} ms "
                f"((w dt)^2 = {largest:.1f}, limit {limit:.1f}): take a shorter step, less of either or more damping"
            )


def _springs(own: Array, pairs: npt.NDArray[np.int64], between: Array) -> Array:
    """Stiffness matrix of springs to the ground and between pairs; a member of -1 is the ground."""
    matrix = np.diag(own)
    for a, b in (pairs.T, pairs.T[::-1]):
        here, both = a >= 0, (a >= 0) & (b >= 0)
        np.add.at(matrix, (a[here], a[here]), between[here])
        np.add.at(matrix, (a[both], b[both]), -between[both])
    return matrix


def _fastest(matrix: Array, mass: Array, enough: float) -> float:
    """Largest squared frequency [rad^2/s^2], or a bound on it that is below ``enough``."""
    # Gershgorin's bound first: it is cheap and nearly always enough.
    bound = float((np.abs(matrix).sum(1) / mass).max())
    if bound < enough:
        return bound
    root = np.sqrt(mass)
    return float(np.linalg.eigvalsh(matrix / root / root[:, None])[-1])


def coupling_tendons(model: mujoco.MjModel, region: str) -> list[int]:
    """The model's tendons that spread a region's indentation; those of the membrane are not among them."""
    return [t for t in range(model.ntendon) if model.tendon(t).name.startswith(f"{region}_e")]


def _add_coupling(spec: mujoco.MjSpec, region: str, shell: Shell, coupling_n_m: float) -> None:
    """Springs on the difference of neighbours' indentation; a pinned neighbour counts as zero."""
    for (i, j), weight in zip(*coupling_weights(shell), strict=True):
        tendon = spec.add_tendon(
            name=f"{region}_e{i}_{j}", stiffness=[coupling_n_m * weight, 0, 0], springlength=[0, 0]
        )
        for k, sign in zip((i, j), (1.0, -1.0), strict=True):
            if not shell.pinned[k]:
                tendon.wrap_joint(f"{region}_v{k}_n", sign)


def _add_membrane(spec: mujoco.MjSpec, region: str, shell: Shell, membrane_n_m: float) -> None:
    """Springs on the difference of neighbouring cells' gliding, along the region and across it alike.

    Without them a dragged cell folds the skin at its border, and the tool hooks on the fold. Cells at the shell's
    border are not held by the skin beyond it.
    """
    for (a, b), weight in zip(*membrane_weights(shell), strict=True):
        for kind in "tb":
            tendon = spec.add_tendon(
                name=f"{region}_m{a}_{b}_{kind}", stiffness=[membrane_n_m * weight, 0, 0], springlength=[0, 0]
            )
            for cell, sign in ((a, 1.0), (b, -1.0)):
                tendon.wrap_joint(f"{region}_cell{cell}_{kind}", sign)


def anchor_joints(model: mujoco.MjModel, region: str) -> npt.NDArray[np.int64]:
    """(n,) every slide of a region's tissue, by number."""
    return np.array([j for j in range(model.njnt) if model.joint(j).name.startswith(f"{region}_")])


def anchor_directions(model: mujoco.MjModel, region: str) -> tuple[npt.NDArray[np.int64], Array]:
    """Numbers (n,) of the region's slides and the force (n, 3) on the bone, in its frame, for a unit of each one's.

    What a vertex's slide bears along its cell's tangents goes on through the cell's own slides and counts there: where
    the vertex leans from the cell's normal, only its share along the normal is left.
    """
    joints = anchor_joints(model, region)
    directions = model.jnt_axis[joints].copy()
    parent = model.body_parentid[model.jnt_bodyid[joints]]
    first = model.body_jntadr[parent]
    on_cell = (model.body_jntnum[parent] == 2) & np.isin(first, joints)
    for slide in (first[on_cell], first[on_cell] + 1):
        tangent = model.jnt_axis[slide]
        directions[on_cell] -= (directions[on_cell] * tangent).sum(1, keepdims=True) * tangent
    return joints, directions


def inner_surface(shell: Shell, thickness_m: float) -> Array:
    """(N, 3) the shell moved inward by the tissue's thickness along its normals, but never past the region's axis."""
    room = np.einsum("ij,ij->i", shell.vertices - shell.axis_points, shell.normals) - CORE_MIN_RADIUS_M
    return shell.vertices - np.clip(thickness_m, 0.0, np.maximum(room, 0.0))[:, None] * shell.normals


def _add_core(spec: mujoco.MjSpec, region: str, shell: Shell, tissue: Tissue, origin: Array) -> None:
    """The rigid core that the tool meets when the tissue is used up: convex wedges under the inner surface.

    One hull over the whole region would bridge its hollows and lie far too shallow; a wedge spans only CORE_PIECE_M
    along the region and a sector across, down to the region's axis.
    """
    inner = inner_surface(shell, tissue.thickness_m) - origin
    axis = shell.axis_points - origin
    limb = isinstance(REGIONS[region].shape, Tube)
    middle = shell.grid[shell.triangles].mean(1)
    width = CORE_SECTOR_RAD if limb else CORE_PIECE_M
    key = np.floor(middle / [CORE_PIECE_M, width] + [0.0, 0.5]).astype(np.int64)
    bone = spec.body(body_name(REGIONS[region].segment))
    for number, piece in enumerate(np.unique(key, axis=0)):
        corners = np.unique(shell.triangles[(key == piece).all(1)])
        points = np.concatenate([inner[corners], axis[corners]])
        name = f"human_core_{region}_{number}"
        spec.add_mesh(name=name, uservert=points.ravel(), maxhullvert=40)
        bone.add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, mass=0, group=HIDDEN_GROUP, condim=3,
            friction=[tissue.friction, 0.005, 0.0001], solref=list(SOLREF), solimp=list(SOLIMP), priority=1,
            **ROBOT_ONLY,
        )  # fmt: skip


def set_damping(model: mujoco.MjModel, regions: dict[str, SoftRegion], *, scale: float = 1.0) -> None:
    """Write D_c into the compiled model: the compiler rejects joint damping on bodies that a flex uses."""
    for region in regions.values():
        shell, per_area = region.shell, scale * region.tissue.damping_ns_m3
        for k in region.vertex_index:
            model.dof_damping[model.joint(f"{region.name}_v{k}_n").dofadr[0]] = per_area * shell.area[k]
        for c in range(len(shell.cell_frames)):
            damping = per_area * shell.area[shell.cell == c].sum()
            for kind in "tb":
                model.dof_damping[model.joint(f"{region.name}_cell{c}_{kind}").dofadr[0]] = damping
