"""The same force measured along independent paths: contact solver, anchors, bed, robot joints. All in the world [N]."""

from __future__ import annotations

import mujoco
import numpy as np

from carecontact.contract.embodiment import PANDA
from carecontact.sim.simulation import Simulation
from carecontact.validation.result import Array
from carecontact.world.human.skeleton import tissue_body_name
from carecontact.world.human.tissue import anchor_directions


class AnchorForce:
    """Force that a region's anchors (springs and dampers) exert on the bone."""

    def __init__(self, simulation: Simulation, region: str) -> None:
        self._data, model = simulation.data, simulation.model
        joints, self._directions = anchor_directions(model, region)
        self._dofs = model.jnt_dofadr[joints]
        self._bone = model.body(tissue_body_name(region)).id

    def __call__(self) -> Array:
        """(3,)"""
        in_bone = -self._data.qfrc_passive[self._dofs] @ self._directions
        return self._data.xmat[self._bone].reshape(3, 3) @ in_bone


def bed_reaction(simulation: Simulation) -> Array:
    """(3,) on the person from bed and board, summed by hand over the contacts."""
    model, data = simulation.model, simulation.data
    total, wrench = np.zeros(3), np.zeros(6)
    for i in range(data.ncon):
        contact = data.contact[i]
        names = [model.geom(g).name if g >= 0 else "" for g in contact.geom]
        if any(n.startswith("bed_") for n in names) and any(n.startswith("human_") for n in names):
            mujoco.mj_contactForce(model, data, i, wrench)
            on_second = contact.frame.reshape(3, 3).T @ wrench[:3]
            total += on_second if names[1].startswith("human_") else -on_second
    return total


def tip_force(simulation: Simulation) -> Array:
    """(3,) that the robot exerts at its tip, from joint torques alone; right where the tip does not accelerate.

    The dynamically consistent inverse (Khatib 1987) lets torques that only move the elbow drop out.
    """
    model, data = simulation.model, simulation.data
    jacobian = np.zeros((6, model.nv))
    mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], model.site(PANDA.tcp_site).id)
    mobility = np.zeros_like(jacobian)
    mujoco.mj_solveM(model, data, mobility, jacobian)
    dofs = [model.joint(name).dofadr[0] for name in PANDA.joints]
    torque = (data.qfrc_actuator + data.qfrc_passive + data.qfrc_applied - data.qfrc_bias)[dofs]
    return np.linalg.solve(jacobian[:, dofs] @ mobility[:, dofs].T, mobility[:, dofs] @ torque)[:3]


def touches_hard_parts(simulation: Simulation, region: str) -> bool:
    """Whether the robot now touches any part of the person other than free vertices of the region's shell."""
    model, data = simulation.model, simulation.data
    flex = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_FLEX, region)
    bone = model.body(tissue_body_name(region)).id
    corners = model.flex_elem[model.flex_elemdataadr[flex] :]
    holders = model.flex_vertbodyid[model.flex_vertadr[flex] :]
    for i in range(data.ncon):
        contact = data.contact[i]
        geoms = [model.body(model.geom_bodyid[g]).name for g in contact.geom if g >= 0]
        if not any(name.startswith("robot_") for name in geoms):
            continue
        if flex not in contact.flex:
            return True
        side = int(np.flatnonzero(np.asarray(contact.flex) == flex)[0])
        vertex, element = int(contact.vert[side]), int(contact.elem[side])
        vertices = [vertex] if vertex >= 0 else corners[3 * element : 3 * element + 3]
        if bone in holders[vertices]:
            return True
    return False
