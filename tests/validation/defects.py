"""Persons with one thing wrong: factories for ``validate(make_scene=...)``, and changes to a sound person's scene."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np

from carecontact.contract.protocol import Protocol
from carecontact.regions import STANDARD_REGIONS
from carecontact.sim.simulation import Simulation
from carecontact.validation.subject import Subject
from carecontact.world.human.tissue import anchor_joints
from carecontact.world.scene import Scene, build_scene


class ActsInContactOnly(Subject):
    """A sound person whose model is changed once it lies at rest or under the tool.

    For defects that neither settling nor the tool's way there can notice: the states of the sound person are taken.
    """

    def __init__(self, sound: Subject, change: Callable[[Scene], object]) -> None:
        super().__init__(sound.protocol, make_scene=sound.make_scene)
        self._sound, self._change = sound, change

    def scene(self, region: str) -> Scene:
        if region not in self._scenes:
            sound = self._sound.scene(region)
            self._scenes[region] = replace(sound, model=copy.copy(sound.model))
            self._change(self._scenes[region])
        return self._scenes[region]

    def at_rest(self, region: str) -> Simulation:
        return self._changed(self._sound.at_rest(region))

    def hovering(self, region: str) -> Simulation:
        return self._changed(self._sound.hovering(region))

    def _changed(self, simulation: Simulation) -> Simulation:
        self._change(simulation.scene)
        return simulation


def undamped(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
    scene = build_scene(protocol, target=target, skin=skin)
    scene.model.dof_damping[_human_dofs(scene.model)] = 0.0
    return scene


def overdamped(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
    """Tissue alone: three times the declared damping."""
    scene = build_scene(protocol, target=target, skin=skin)
    for region in STANDARD_REGIONS:
        scene.model.dof_damping[scene.model.jnt_dofadr[anchor_joints(scene.model, region)]] *= 3.0
    return scene


def soft_contact(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
    scene = build_scene(protocol, target=target, skin=skin)
    scene.model.flex_solimp[:, :3] = [0.5, 0.9, 0.01]
    return scene


def soft_upper_arm(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
    scene = build_scene(protocol, target=target, skin=skin)
    scene.model.jnt_stiffness[anchor_joints(scene.model, "upper_arm")] *= 0.7
    return scene


def slippery(scene: Scene) -> None:
    scene.model.flex_friction[:, 0] *= 0.9


def half_stiff(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
    scene = build_scene(protocol, target=target, skin=skin)
    for region in STANDARD_REGIONS:
        joints = anchor_joints(scene.model, region)
        scene.model.jnt_stiffness[joints] *= 0.5
        scene.model.jnt_stiffnesspoly[joints] *= 0.5
    # Coupling is declared through the anchors' stiffness: G = a l^2.
    scene.model.tendon_stiffness[:] *= 0.5
    return scene


def uncoupled(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
    scene = build_scene(protocol, target=target, skin=skin)
    scene.model.tendon_stiffness[:] = 0.0
    return scene


def unlimited(scene: Scene) -> None:
    for j in range(scene.model.njnt):
        if scene.model.joint(j).name.startswith("human_"):
            scene.model.jnt_limited[j] = 0


def without_joint_limits(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
    scene = build_scene(protocol, target=target, skin=skin)
    unlimited(scene)
    return scene


def without_cores(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
    scene = build_scene(protocol, target=target, skin=skin)
    for g in range(scene.model.ngeom):
        if scene.model.geom(g).name.startswith("human_core_"):
            scene.model.geom_contype[g] = scene.model.geom_conaffinity[g] = 0
    return scene


def light_arm(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
    """Half of a forearm's bone is in the pelvis: the person weighs what it should."""
    scene = build_scene(protocol, target=target, skin=skin)
    arm, pelvis = (scene.model.body(f"human_{name}").id for name in ("right_forearm", "pelvis"))
    scene.model.body_mass[pelvis] += 0.5 * scene.model.body_mass[arm]
    scene.model.body_mass[arm] *= 0.5
    return scene


def stiff_joints(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
    scene = build_scene(protocol, target=target, skin=skin)
    for hinge in scene.hinges:
        joint = scene.model.joint(f"human_{hinge.name}").id
        scene.model.jnt_stiffness[joint] *= 2.0
        scene.model.dof_damping[scene.model.jnt_dofadr[joint]] *= 2.0
    return scene


def at_ten_milliseconds(protocol: Protocol) -> Protocol:
    return protocol.model_copy(update={"physics": protocol.physics.model_copy(update={"dt_s": 0.010})})


def _human_dofs(model: mujoco.MjModel) -> np.ndarray:
    return np.flatnonzero(np.isin(model.dof_bodyid, np.flatnonzero(model.body_rootid == model.body("human_pelvis").id)))
