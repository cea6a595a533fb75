"""The person under test on the indentation bench: its own anchors, taken from the compiled scene."""

from __future__ import annotations

import mujoco

from carecontact.sim.bench import Bench, Indenter
from carecontact.validation.subject import Subject
from carecontact.world.human.tissue import anchor_joints


def person_bench(
    subject: Subject, region: str, indenter: Indenter, *, dt_s: float | None = None, glides: bool = False
) -> Bench:
    """A bench with the stiffness, damping, mass and contact of the compiled person, whatever the protocol says."""
    bench = declared_bench(subject, region, indenter, dt_s=dt_s, glides=glides)
    there, here = subject.scene(region).model, bench.model
    for j in anchor_joints(there, region):
        joint = here.joint(there.joint(j).name)
        here.jnt_stiffness[joint.id] = there.jnt_stiffness[j]
        here.jnt_stiffnesspoly[joint.id] = there.jnt_stiffnesspoly[j]
        here.dof_damping[joint.dofadr[0]] = there.dof_damping[there.jnt_dofadr[j]]
    for k in range(here.ntendon):
        here.tendon_stiffness[k] = there.tendon_stiffness[there.tendon(here.tendon(k).name).id]
    flex = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_FLEX, region) for model in (here, there)]
    for name in ("flex_friction", "flex_solref", "flex_solimp"):
        getattr(here, name)[flex[0]] = getattr(there, name)[flex[1]]
    for k in range(here.nbody):
        # Only cells and vertices: the bone does not move on the bench.
        if (name := here.body(k).name).startswith(f"{region}_"):
            twin = there.body(name).id
            here.body_mass[k], here.body_inertia[k] = there.body_mass[twin], there.body_inertia[twin]
    return bench


def declared_bench(
    subject: Subject, region: str, indenter: Indenter, *, dt_s: float | None = None, glides: bool = False
) -> Bench:
    """A bench with the law that the protocol declares, on the person's own mesh."""
    scene = subject.scene(region)
    return Bench(
        body=scene.body, region=region, tissue=subject.tissue(region), indenter=indenter,
        dt_s=dt_s or subject.protocol.physics.dt_s, shell=scene.regions[region].shell, glides=glides,
    )  # fmt: skip


def tool() -> Indenter:
    """The shipped tool, lying across the region."""
    return Indenter(shape="cap")
