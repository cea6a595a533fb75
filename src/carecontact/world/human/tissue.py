"""A soft region in the model: every free shell vertex is a small body on three slides under the bone.

The slides' polynomial stiffness and damping are the anchor law of the paper's Eq. 3, f_c = K_c phi + D_c dphi/dt; the
reaction on the skeleton comes out of the kinematic tree. The flex over the vertices gives collision only.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.contract.protocol import Tissue
from carecontact.world.human.body import Array, Body
from carecontact.world.human.shell import Shell
from carecontact.world.human.skeleton import HIDDEN_GROUP, ROBOT_ONLY, SOFT_SEGMENTS, body_name, tissue_body_name

FLEX_RADIUS_M = 0.002
FLEX_GROUP = 4
CORE_MIN_RADIUS_M = 0.006
SOLREF = (0.01, 1.0)
SOLIMP = (0.95, 0.99, 0.001, 0.5, 2.0)


@dataclass(frozen=True, kw_only=True)
class Region:
    name: str
    shell: Shell
    tissue: Tissue
    vertex_index: npt.NDArray[np.int64]
    """(n,) shell vertices that are free, in the order of their bodies"""


def shell_points(shell: Shell, tissue: Tissue) -> tuple[Array, Array]:
    """Masses (n,) [kg] and places (n, 3) of the free vertices in the mesh frame."""
    free = ~shell.pinned
    return tissue.areal_mass_kg_m2 * shell.area[free], shell.vertices[free] - shell.normals[free] * FLEX_RADIUS_M


def add_tissue(spec: mujoco.MjSpec, body: Body, region: str, shell: Shell, tissue: Tissue) -> Region:
    """Add vertices, flex and bone core of one region. Call after the skeleton."""
    segment = SOFT_SEGMENTS[region]
    origin = body.joint_centre[segment]
    carrier = spec.body(tissue_body_name(region))
    local = shell.vertices - origin - shell.normals * FLEX_RADIUS_M
    names: list[str] = []
    positions = np.zeros_like(local)
    free: list[int] = []
    slide = mujoco.mjtJoint.mjJNT_SLIDE
    for k in range(len(local)):
        if shell.pinned[k]:
            names.append(tissue_body_name(region))
            positions[k] = local[k]
            continue
        free.append(k)
        name = f"{region}_v{k}"
        names.append(name)
        area, n, t = float(shell.area[k]), shell.normals[k], shell.tangents[k]
        vertex = carrier.add_body(name=name, pos=local[k], mass=tissue.areal_mass_kg_m2 * area, explicitinertial=True)
        # Left unset, the compiler would put the mass at twice the body's offset from the bone.
        vertex.ipos = [0, 0, 0]
        vertex.inertia = np.full(3, vertex.mass * 1e-5)
        law = [tissue.a_n_m3 * area, tissue.b_n_m4 * area, tissue.c_n_m5 * area]
        vertex.add_joint(name=f"{name}_n", type=slide, axis=-n, stiffness=law)
        vertex.add_joint(name=f"{name}_t", type=slide, axis=t, stiffness=[law[0], 0, 0])
        vertex.add_joint(name=f"{name}_b", type=slide, axis=np.cross(n, t), stiffness=[law[0], 0, 0])
    spec.add_flex(
        name=region, dim=2, radius=FLEX_RADIUS_M, vertbody=names, vert=positions.ravel(),
        elem=shell.triangles.ravel().astype(np.int32), contype=0, conaffinity=1, condim=3,
        friction=[tissue.friction, 0.005, 0.0001], solref=SOLREF, solimp=SOLIMP, priority=1,
        selfcollide=mujoco.mjtFlexSelf.mjFLEXSELF_NONE, group=FLEX_GROUP, rgba=[0.87, 0.67, 0.56, 1],
    )  # fmt: skip
    _add_core(spec, region, shell, tissue, origin)
    return Region(name=region, shell=shell, tissue=tissue, vertex_index=np.array(free))


def _add_core(spec: mujoco.MjSpec, region: str, shell: Shell, tissue: Tissue, origin: Array) -> None:
    """The rigid core that the tool meets when the tissue is used up.

    The convex hull of the shell moved inward by the tissue's thickness along its normals, but never past the region's
    axis. Where the region is not convex the hull bridges it and lies shallower than the thickness: along the normals
    of man-adult the median depth is 14 of 18 mm (forearm), 26 of 32 mm (upper arm) and 28 of 50 mm (abdomen).
    """
    toward = shell.vertices - shell.axis_points
    room = np.einsum("ij,ij->i", toward, shell.normals) - CORE_MIN_RADIUS_M
    inner = shell.vertices - np.clip(tissue.thickness_m, 0.0, np.maximum(room, 0.0))[:, None] * shell.normals
    name = f"human_core_{region}"
    points = np.concatenate([inner, shell.axis_points]) - origin
    spec.add_mesh(name=name, uservert=points.ravel(), maxhullvert=60)
    spec.body(body_name(SOFT_SEGMENTS[region])).add_geom(
        name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, mass=0, group=HIDDEN_GROUP, condim=3,
        friction=[tissue.friction, 0.005, 0.0001], solref=list(SOLREF), solimp=list(SOLIMP), priority=1, **ROBOT_ONLY,
    )  # fmt: skip


def set_damping(model: mujoco.MjModel, regions: dict[str, Region], *, scale: float = 1.0) -> None:
    """Write D_c into the compiled model: the compiler rejects joint damping on bodies that a flex uses."""
    for region in regions.values():
        for k in region.vertex_index:
            damping = scale * region.tissue.damping_ns_m3 * region.shell.area[k]
            for kind in "ntb":
                model.dof_damping[model.jnt_dofadr[model.joint(f"{region.name}_v{k}_{kind}").id]] = damping
