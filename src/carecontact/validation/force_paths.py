"""The same force measured along independent paths: contact points, anchors, bed, robot joints. All forces are in the
world [N]."""

from __future__ import annotations

from dataclasses import fields

import mujoco
import numpy as np

from carecontact.kernel.region import Law
from carecontact.sim.simulation import Simulation
from carecontact.validation.result import Array


class AnchorForce:
    """Force that a region's springs and dampers exert on the bone: anchors, coupling and membrane.

    It follows from the displacement of every vertex and the law in the compiled model, by the equations of the law and
    not by the compiled tissue, which sums the forces of its contact points. Vertices that the compiled tissue leaves at
    rest, because they are far from the tool, hold their neighbours and have no balance of their own: see ``held``.
    """

    def __init__(self, simulation: Simulation, region: str) -> None:
        self._data, self._felt = simulation.data, simulation.tissue[region]
        law = simulation.model.numeric(f"{region}/law").data.tolist()
        self._law = Law(**{field.name: value for field, value in zip(fields(Law), law, strict=True)})
        self._lock = float(simulation.model.numeric(f"{region}/contact").data[2])
        rows = simulation.model.numeric(f"{region}/edges").data.reshape(-1, 3)
        self._edges, self._weights = rows[:, :2].astype(np.int64), rows[:, 2:]

    def __call__(self) -> Array:
        """Return the force (3,)."""
        return self._wrench(moving=True)[0]

    def moment(self) -> Array:
        """Return the moment (3,) of the same about the bone's origin [N m]. The force of a vertex acts where the vertex
        is now, as do the parts of a contact point's force that the corners of its triangle bear."""
        return self._wrench(moving=True)[1]

    def held(self) -> Array:
        """(3,) force that holds the skin around the part that moves."""
        return self._wrench(moving=False)[0]

    def _wrench(self, *, moving: bool) -> Array:
        """Return force and moment (2, 3)."""
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
    """Return the force (3,) of bed and board on the person, summed here over the contacts."""
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
    """Return the force (3,) that the robot exerts at its tip, from joint torques alone; it is exact if the tip does not
    accelerate.

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
    torque = (data.qfrc_actuator + data.qfrc_passive - tissue + data.qfrc_applied - data.qfrc_bias)[dofs]
    return np.linalg.solve(jacobian[:, dofs] @ mobility[:, dofs].T, mobility[:, dofs] @ torque)[:3]


def touches_hard_parts(simulation: Simulation) -> bool:
    """Whether the robot now touches a rigid part of the person; contacts with tissue are not among MuJoCo's
    contacts.
    """
    model, data = simulation.model, simulation.data
    robot = model.body(simulation.robot.base_body).id
    for i in range(data.ncon):
        bodies = [model.body(model.geom_bodyid[g]) for g in data.contact[i].geom]
        if any(b.rootid[0] == robot for b in bodies) and any(b.name.startswith("human_") for b in bodies):
            return True
    return False
