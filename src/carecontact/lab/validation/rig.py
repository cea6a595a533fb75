"""Benches on which a region is pressed, independent paths of measuring a force, and published human curves."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.human.shell import Shell
from carecontact.human.skeleton import body_name
from carecontact.human.soft_region import add_tissue
from carecontact.interface.regions import REGIONS
from carecontact.interface.robot import EMBODIMENTS, Tip
from carecontact.lab.validation.result import Array
from carecontact.lab.validation.subject import Subject
from carecontact.sim.bench import Bench, Indenter
from carecontact.sim.simulation import Simulation
from carecontact.tissue.plugin import Law, Readings
from carecontact.world.scene import set_physics

SPEED_M_S = 0.005


@dataclass(frozen=True, kw_only=True)
class Reference:
    """A published human force-indentation curve that the person is compared with. All are of loading, none is of a
    manikin.

    Limbs: derived from the MULTIS in-vivo ultrasound indentation study (Neumann et al. 2018, Sci Data 5:180193; 2019, J
    Biomech 95:109307), 91 to 95 adults a site, flat ultrasound probe, here a disc of the same area. The secant
    stiffness and its P5-P95 are measured; the curvature of F = a d + b d^2 is inferred from two R-squared values. The
    band scales the median curve by the secant's percentiles.

    Abdomen: Remus et al. 2024, Front Bioeng Biotechnol 12:1384062, supplement S1 (CC BY 4.0): hemisphere of 10 mm
    radius at 5 mm/s, relaxed, ten men, mean of sites R1 to R5 and of the participants.
    """

    name: str
    region: str
    """Region whose shell is pressed for the comparison."""
    indenter: Indenter
    depth_m: Array
    """(n,) from 0 to the largest depth measured (limbs: the median subject's)."""
    force_n: Array
    """(n,) median (limbs) or mean (abdomen) force"""
    low_n: Array
    """(n,) P5"""
    high_n: Array
    """(n,) P95"""


def _limb(name: str, area_mm2: float, a: float, b: float, secant: tuple[float, float, float], end: float) -> Reference:
    """Make a limb's reference. ``a`` [N/mm], ``b`` [N/mm^2] and the last depth ``end`` [mm] belong to the median curve;
    ``secant`` is its stiffness at P5, median and P95 [N/mm]."""
    depth = np.linspace(0.0, end, 19)
    force, (low, middle, high) = a * depth + b * depth**2, secant
    return Reference(
        name=name,
        region=name.partition(",")[0].replace(" ", "_"),
        indenter=Indenter(shape="flat", size_m=float(np.sqrt(area_mm2 / np.pi)) / 1000),
        depth_m=depth / 1000,
        force_n=force,
        low_n=force * low / middle,
        high_n=force * high / middle,
    )


FOREARM = _limb("forearm, anterior (MULTIS LA_A)", 360.0, 0.8615, 0.07327, (0.7445, 1.1903, 2.1519), 4.487)
FOREARM_POSTERIOR = _limb("forearm, posterior (MULTIS LA_P)", 360.0, 1.0018, 0.11113, (0.8053, 1.4693, 2.7353), 4.207)
UPPER_ARM_ANTERIOR = _limb("upper arm, anterior (MULTIS UA_A)", 360.0, 0.3893, 0.03126, (0.4341, 0.6445, 1.4601), 8.163)
UPPER_ARM_POSTERIOR = _limb(
    "upper arm, posterior (MULTIS UA_P)", 675.0, 0.5414, 0.03211, (0.3890, 0.7968, 1.3969), 7.951
)
_ABDOMEN = np.array([
    [0.0, 0.0, 0.0, 0.0], [2.0, 0.4109, 0.3622, 0.4742], [4.0, 0.8700, 0.7574, 1.0022], [6.0, 1.3780, 1.1852, 1.5921],
    [8.0, 1.9381, 1.6594, 2.2478], [10.0, 2.5557, 2.1901, 2.9739], [12.0, 3.2381, 2.7861, 3.7770],
    [14.0, 3.9940, 3.4453, 4.6778], [16.0, 4.8334, 4.1537, 5.6714], [18.0, 5.7668, 4.8728, 6.7677],
    [20.0, 6.8057, 5.6465, 7.9827], [22.0, 7.9611, 6.4795, 9.3256],
])  # fmt: skip
"""Depth [mm], force, P5, P95 [N]."""
ABDOMEN = Reference(
    name="abdomen, R1-R5 (Remus 2024)",
    region="abdomen",
    indenter=Indenter(shape="hemisphere", size_m=0.010),
    depth_m=_ABDOMEN[:, 0] / 1000,
    force_n=_ABDOMEN[:, 1],
    low_n=_ABDOMEN[:, 2],
    high_n=_ABDOMEN[:, 3],
)
FITTED: dict[str, tuple[Reference, ...]] = {
    "paper-mapping": (FOREARM, ABDOMEN),
    "human-published": (FOREARM, UPPER_ARM_ANTERIOR, ABDOMEN),
}
"""Tissue set -> the curves to whose middles its laws were fitted; they are compared at places that no fit used."""
REFERENCES = (FOREARM, FOREARM_POSTERIOR, UPPER_ARM_ANTERIOR, UPPER_ARM_POSTERIOR, ABDOMEN)
"""All references; those to which a set was not fitted are shown beside it. The free side of the shell is pressed,
whichever side of the limb was measured."""


def person_bench(subject: Subject, region: str, indenter: Indenter, *, glides: bool = False) -> Bench:
    """Return a bench with the law and the contact of the compiled person, whatever the protocol says."""
    bench = declared_bench(subject, region, indenter, glides=glides)
    for kind in ("law", "options"):
        bench.model.numeric(f"{region}/{kind}").data[:] = subject.scene(region).model.numeric(f"{region}/{kind}").data
    return bench


def declared_bench(subject: Subject, region: str, indenter: Indenter, *, glides: bool = False) -> Bench:
    """Return a bench with the law that the protocol declares, on the person's own mesh."""
    scene, dt_s = subject.scene(region), subject.protocol.physics.dt_s
    tissue, shell = subject.tissue(region), scene.regions[region].shell
    return Bench(
        body=scene.body, region=region, tissue=tissue, indenter=indenter, dt_s=dt_s, shell=shell, glides=glides
    )


def tool(subject: Subject) -> Indenter:
    """Return the tool of the protocol's robot, lying across the region."""
    return Indenter(shape="cap", tip=subject.protocol.scene.robot.tip)


HEAVY_KG = 1e6
"""A tool of this mass moves as prescribed, whatever force acts on it."""
WIDE_M = 0.03
"""Half the width of the skin that a tool covers; of a wider tool of the robot, its own."""
UPWARD = 0.3
"""Least cosine between the region's outward direction and the normals of skin on which a tool may be set."""


@dataclass(frozen=True, kw_only=True)
class Tool:
    """A convex geom; x lies along the region, y across it, z points away from the skin."""

    name: str
    kind: mujoco.mjtGeom
    size_m: tuple[float, ...]
    height_m: float
    """Height of its centre over its lowest point."""
    give_m3_n: float = 0.0
    """Compliance of its surface [m/Pa]."""
    turned: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
    """quat_wxyz"""


def of_tip(name: str, tip: Tip) -> Tool:
    kind = mujoco.mjtGeom.mjGEOM_ELLIPSOID
    return Tool(name=name, kind=kind, size_m=tip.half_m, height_m=tip.half_m[2], give_m3_n=tip.give_m3_n)


CAP = of_tip("cap", EMBODIMENTS["caps"].tip)
PAD = Tool(name="pad", kind=mujoco.mjtGeom.mjGEOM_BOX, size_m=(0.015, 0.020, 0.006), height_m=0.006)
"""30 x 40 x 12 mm, with the rounded edges that the compiled tissue gives a box."""
_ACROSS = (float(np.sqrt(0.5)), float(np.sqrt(0.5)), 0.0, 0.0)
FLANK = Tool(
    name="flank", kind=mujoco.mjtGeom.mjGEOM_CAPSULE, size_m=(0.030, 0.050, 0.0), height_m=0.030, turned=_ACROSS
)
"""About the size of the side of the robot's hand, across the region."""


def robot_tool(subject: Subject) -> Tool:
    """Return the tool of the protocol's robot, which is the cap or the wash mitt."""
    name = subject.protocol.scene.tool
    return CAP if name == "caps" else of_tip(name, subject.protocol.scene.robot.tip)


class Rig:
    """A region of the person on a held bone, without gravity, and a rigid tool over its middle that is free or driven.

    Unlike the bench's indenter, the tool has a mass, may slide along the skin and may have any shape, and the compiled
    tissue keeps its ledger of energy. ``reset`` puts the world back to its beginning.

    Args:
        joints: "free", or "slides": first along the region, then away from the skin.
        mass_kg: mass of the tool [kg].
        at: where the tool's lowest point begins and how the tool lies there, as ``middle`` returns them; None: on the
            region's middle.
    """

    def __init__(
        self, subject: Subject, region: str, tool: Tool, *, joints: Literal["free", "slides"], mass_kg: float = 1.0,
        dt_s: float | None = None, at: tuple[Array, Array] | None = None,
    ) -> None:  # fmt: skip
        scene, segment = subject.scene(region), REGIONS[region].segment
        self.shell = scene.regions[region].shell
        spec = mujoco.MjSpec()
        set_physics(spec, dt_s=dt_s or subject.protocol.physics.dt_s)
        spec.option.gravity = [0, 0, 0]
        spec.worldbody.add_body(name=body_name(segment))
        add_tissue(spec, scene.body, region, self.shell, subject.tissue(region), tools="tool", ledger=True)
        point, axes = at or middle(self.shell)
        self._skin = (self.shell.vertices - point) @ axes
        self._wide_m = max(WIDE_M, *tool.size_m[:2]) if tool.kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID else WIDE_M
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, axes.ravel())
        position = point - scene.body.joint_centre[segment] + tool.height_m * axes[:, 2]
        body = spec.worldbody.add_body(name="tool", pos=position, quat=quat)
        if joints == "free":
            body.add_freejoint()
        else:
            for axis in ([1, 0, 0], [0, 0, 1]):
                body.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
        size = [*tool.size_m, 0, 0][:3]
        geom = body.add_geom(type=tool.kind, size=size, quat=tool.turned, mass=mass_kg, contype=1, conaffinity=0)
        if tool.give_m3_n:
            spec.nuser_geom, geom.userdata = 1, [tool.give_m3_n]
        self.model = spec.compile()
        law = f"{region}/law"
        self.model.numeric(law).data[:] = scene.model.numeric(law).data
        self.data = mujoco.MjData(self.model)
        self.felt = Readings(self.model, region)
        self.reset()

    def reset(self, *, position: npt.ArrayLike = (), velocity: npt.ArrayLike = ()) -> None:
        """Put the tool, at rest or moving, on the first of its coordinates."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[: np.size(position)] = position
        self.data.qvel[: np.size(velocity)] = velocity
        mujoco.mj_forward(self.model, self.data)

    def clear_of_m(self, along_m: float) -> float:
        """Return how far [m] the tool must move away from the skin to touch none of it, at a place along the region."""
        under = (np.abs(self._skin[:, :2] - [along_m, 0.0]) < self._wide_m).all(1)
        return float(self._skin[under, 2].max())

    def kinetic_j(self) -> float:
        momentum = np.zeros(self.model.nv)
        mujoco.mj_mulM(self.model, self.data, momentum, self.data.qvel)
        return 0.5 * float(self.data.qvel @ momentum)


def middle(shell: Shell) -> tuple[Array, Array]:
    """Return the vertex (3,) nearest to the region's middle, and directions (3, 3) there as columns: along the region,
    across it and outward, in the mesh frame."""
    local = (shell.vertices - shell.frame_origin) @ shell.frame
    upward = np.flatnonzero(shell.normals @ shell.frame[:, 2] > UPWARD)
    at = upward[np.hypot(local[upward, 0], local[upward, 1]).argmin()]
    outward = shell.normals[at]
    along = shell.frame[:, 0] - (shell.frame[:, 0] @ outward) * outward
    along /= np.linalg.norm(along)
    return shell.vertices[at], np.stack([along, np.cross(outward, along), outward], 1)


class AnchorForce:
    """Force [N] in the world that a region's springs and dampers exert on the bone: anchors, coupling and membrane.

    It follows from the displacement of every vertex and the law in the compiled model, by the equations of the law and
    not by the compiled tissue, which sums the forces of its contact points. Vertices that the compiled tissue leaves at
    rest, because they are far from the tool, hold their neighbours and have no balance of their own.
    """

    def __init__(self, simulation: Simulation, region: str) -> None:
        self._data, self._felt = simulation.data, simulation.tissue[region]
        law = simulation.model.numeric(f"{region}/law").data.tolist()
        self._law = Law(**{field.name: value for field, value in zip(fields(Law), law, strict=True)})
        self._lock = float(simulation.model.numeric(f"{region}/contact").data[2])
        rows = simulation.model.numeric(f"{region}/edges").data.reshape(-1, 3)
        self._edges, self._weights = rows[:, :2].astype(np.int64), rows[:, 2:]

    def __call__(self) -> Array:
        return self.wrench()[0]

    def wrench(self, *, moving: bool = True) -> Array:
        """Return force [N] and moment about the bone's origin [N m] (2, 3) of the skin that moves, or of the skin
        around it, which holds it. The force of a vertex acts where the vertex is now, as do the parts of a contact
        point's force that the corners of its triangle bear."""
        law, felt = self._law, self._felt
        moved, rate = felt.displacement(self._data), felt.rate(self._data)
        borne = law.anchors_pa(moved, lock=self._lock)
        borne += (law.damping_ns_m3 + law.damping_growth_ns_m4 * np.maximum(moved[:, :1], 0.0)) * rate
        force = felt.areas[:, None] * borne
        first, second = self._edges.T
        stiffness = self._weights * [law.coupling_n_m, law.membrane_n_m, law.membrane_n_m]
        apart = stiffness * (moved[first] - moved[second])
        np.add.at(force, first, apart)
        np.add.at(force, second, -apart)
        chosen = (moved != 0).any(1) == moving
        in_bone = np.einsum("ij,ijk->ik", force[chosen], felt.frames[chosen])
        moment = np.cross(felt.vertices(self._data)[chosen], in_bone)
        return np.stack([in_bone.sum(0), moment.sum(0)]) @ self._data.xmat[felt.bone].reshape(3, 3).T


def moment_on_bone(simulation: Simulation, region: str) -> Array:
    """Return the moment (3,) of a region's compiled tissue on its bone about the bone's origin [N m], from the
    generalised forces that it adds to the free joint of the person."""
    model, data, felt = simulation.model, simulation.data, simulation.tissue[region]
    root = int(model.body_rootid[felt.bone])
    first = int(model.body_dofadr[root])
    wrench = felt.generalised_force(model, data)[first : first + 6]
    about_root = data.xmat[root].reshape(3, 3) @ wrench[3:]
    return about_root + np.cross(data.xpos[root] - data.xpos[felt.bone], wrench[:3])


def bed_reaction(simulation: Simulation) -> Array:
    """Return the force (3,) [N] of bed and board on the person, summed here over the contacts."""
    model, data = simulation.model, simulation.data
    total, wrench = np.zeros(3), np.zeros(6)
    for i in range(data.ncon):
        contact = data.contact[i]
        names = [model.geom(g).name for g in contact.geom]
        if any(n.startswith("bed_") for n in names) and any(n.startswith("human_") for n in names):
            mujoco.mj_contactForce(model, data, i, wrench)
            on_second = contact.frame.reshape(3, 3).T @ wrench[:3]
            total += on_second if names[1].startswith("human_") else -on_second
    return total


def tip_force(simulation: Simulation) -> Array:
    """Return the force (3,) [N] that the robot exerts at its tip, from joint torques alone; it is exact if the tip does
    not accelerate.

    The dynamically consistent inverse (Khatib 1987) removes torques that only move the elbow. The tissue's force on the
    robot is one of MuJoCo's passive forces and is subtracted from them.
    """
    model, data = simulation.model, simulation.data
    jacobian = np.zeros((6, model.nv))
    mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], model.site(simulation.robot.tcp_site).id)
    mobility = np.zeros_like(jacobian)
    mujoco.mj_solveM(model, data, mobility, jacobian)
    dofs = [model.joint(name).dofadr[0] for name in simulation.robot.joints]
    tissue = sum(felt.generalised_force(model, data) for felt in simulation.tissue.values())
    # The dry friction of a joint is one of MuJoCo's constraints.
    dry = np.zeros(model.nv)
    rows = data.efc_type == mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF.value
    dry[data.efc_id[rows]] = data.efc_force[rows]
    torque = (data.qfrc_actuator + data.qfrc_passive - tissue + data.qfrc_applied - data.qfrc_bias + dry)[dofs]
    return np.linalg.solve(jacobian[:, dofs] @ mobility[:, dofs].T, mobility[:, dofs] @ torque)[:3]


def touches_hard_parts(simulation: Simulation) -> bool:
    """Whether the robot touches a rigid part of the person; MuJoCo's contacts have none with tissue."""
    model, data = simulation.model, simulation.data
    robot = model.body(simulation.robot.base_body).id
    for i in range(data.ncon):
        bodies = [model.body(model.geom_bodyid[g]) for g in data.contact[i].geom]
        if any(b.rootid[0] == robot for b in bodies) and any(b.name.startswith("human_") for b in bodies):
            return True
    return False
