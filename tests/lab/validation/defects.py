"""Persons with one thing wrong: factories for ``validate(make_scene=...)``, and changes to a sound person's scene."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
import numpy.typing as npt

from carecontact.human.hulls import ARM, SOLIMP, SOLREF, plate_body
from carecontact.human.skeleton import stop_name
from carecontact.lab.validation.subject import Subject
from carecontact.protocol.protocol import Protocol
from carecontact.sim.simulation import Simulation
from carecontact.tissue.plugin import Readings, Rings, set_law
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


def _with_laws(scene: Scene, **factors: float) -> Scene:
    """Fields of every region's law in the compiled model, multiplied."""
    for name, region in scene.regions.items():
        scaled = {field: factor * getattr(region.tissue, field) for field, factor in factors.items()}
        set_law(scene.model, name, region.tissue.model_copy(update=scaled))
    return scene


def undamped(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
    scene = build_scene(protocol, target=target, skin=skin)
    scene.model.dof_damping[_human_dofs(scene.model)] = 0.0
    return _with_laws(scene, damping_ns_m3=0.0, damping_growth_ns_m4=0.0)


def overdamped(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
    """Tissue alone: three times the declared damping."""
    return _with_laws(build_scene(protocol, target=target, skin=skin), damping_ns_m3=3.0, damping_growth_ns_m4=3.0)


def soft_contact(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
    return _with_laws(build_scene(protocol, target=target, skin=skin), contact_n_m3=0.1)


def soft_upper_arm(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
    scene = build_scene(protocol, target=target, skin=skin)
    tissue = scene.regions["upper_arm"].tissue
    set_law(scene.model, "upper_arm", tissue.model_copy(update={"a_n_m3": 0.7 * tissue.a_n_m3}))
    return scene


def slippery(scene: Scene) -> None:
    _with_laws(scene, friction=0.9)


def half_damped(scene: Scene) -> None:
    _with_laws(scene, damping_ns_m3=0.5, damping_growth_ns_m4=0.5)


def nearly_massless(scene: Scene) -> None:
    """A tenth of the skin's inertia."""
    _with_laws(scene, areal_mass_kg_m2=0.1)


def driven(scene: Scene) -> None:
    """The tissue's dampers add what they should take."""
    _with_laws(scene, damping_ns_m3=-0.1, damping_growth_ns_m4=-0.1)


def frictionless(scene: Scene) -> None:
    _with_laws(scene, friction=0.0)


def half_stiff(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
    """The coupling too: it is declared through the anchors' stiffness, G = a l^2."""
    return _with_laws(build_scene(protocol, target=target, skin=skin), a_n_m3=0.5, b_n_m4=0.5, c_n_m5=0.5)


def uncoupled(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
    return _with_laws(build_scene(protocol, target=target, skin=skin), coupling_length_m=0.0, membrane_n_m=0.0)


class PushedTheWrongWay(Rings):
    """Reads the force on the bone with its sign turned round, as a kernel would give it that pushed bone and tool the
    wrong way."""

    def last(self, data: mujoco.MjData, count: int) -> npt.NDArray[np.void]:
        rows = super().last(data, count)
        rows["force_n"] *= -1
        return rows


class PushedAtItsOrigin(Readings):
    """Reads the generalised forces of a kernel that pushes the bone with the right force and no moment."""

    def generalised_force(self, model: mujoco.MjModel, data: mujoco.MjData) -> npt.NDArray[np.float64]:
        both, on_bone = super().generalised_force(model, data), np.zeros(model.nv)
        force, at = self.now(data)["force_n"], data.xpos[self.bone]
        mujoco.mj_applyFT(model, data, force, np.zeros(3), at, self.bone, on_bone)
        return np.where(np.isin(np.arange(model.nv), _human_dofs(model)), on_bone, both)


class ReadsWrong(Subject):
    """A sound person whose simulations read the tissue wrongly."""

    def __init__(self, protocol: Protocol, *, readings: type[Readings] = Readings, rings: type[Rings] = Rings) -> None:
        super().__init__(protocol)
        self._readings, self._rings = readings, rings

    def hovering(self, region: str) -> Simulation:
        simulation = super().hovering(region)
        simulation.tissue.update({name: self._readings(simulation.model, name) for name in simulation.tissue})
        simulation._rings = self._rings(list(simulation.tissue.values()))
        return simulation


def limp_wrist(scene: Scene) -> None:
    """The wrist of releases whose stiffness was a guess: a hand that hangs over the board's edge folds there."""
    scene.model.jnt_stiffness[scene.model.joint("human_right_hand_flexion").id] = 0.3


def unlimited(scene: Scene) -> None:
    for hinge in scene.hinges:
        scene.model.tendon_stiffnesspoly[scene.model.tendon(stop_name(hinge.name)).id] = 0.0


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


def old_bone(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
    """The arm's bone stands on its segment, with the contact that it once had."""
    scene = build_scene(protocol, target=target, skin=skin)
    spec = scene.spec.copy()
    for part in ARM:
        plate = spec.body(plate_body(f"right_{part}"))
        for joint in plate.joints:
            spec.delete(joint)
        for geom in plate.geoms:
            geom.solref = [0.01, 1.0]
    return replace(scene, spec=spec, model=spec.compile())


def hard_plates(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
    """Plates meet every tool with full impedance at their surface, as they once met a rigid one."""
    scene = build_scene(protocol, target=target, skin=skin)
    spec = scene.spec.copy()
    for geom in spec.geoms:
        if geom.priority == 1 and geom.solref[0] == SOLREF[0]:
            geom.solimp = SOLIMP
    return replace(scene, spec=spec, model=spec.compile())


def light_arm(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
    """Half of a forearm's bone is in the pelvis: the person weighs what it should."""
    scene = build_scene(protocol, target=target, skin=skin)
    arm, pelvis = (scene.model.body(f"human_{name}").id for name in ("right_forearm", "pelvis"))
    scene.model.body_mass[pelvis] += 0.5 * scene.model.body_mass[arm]
    scene.model.body_mass[arm] *= 0.5
    return scene


def lopsided_arm(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
    scene = build_scene(protocol, target=target, skin=skin)
    scene.model.body_ipos[scene.model.body("human_right_forearm").id] += [0.0, 0.0, 0.003]
    return scene


def stiff_joints(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
    scene = build_scene(protocol, target=target, skin=skin)
    for hinge in scene.hinges:
        joint = scene.model.joint(f"human_{hinge.name}").id
        scene.model.jnt_stiffness[joint] *= 2.0
        scene.model.dof_damping[scene.model.jnt_dofadr[joint]] *= 2.0
    return scene


def _human_dofs(model: mujoco.MjModel) -> np.ndarray:
    return np.flatnonzero(np.isin(model.dof_bodyid, np.flatnonzero(model.body_rootid == model.body("human_pelvis").id)))
