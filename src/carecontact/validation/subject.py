"""The person under test: builds and settles each scene once and gives simulations at rest or with the tool above."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Protocol as Interface

from carecontact.contract.protocol import Protocol, Tissue
from carecontact.errors import SceneError
from carecontact.sim.simulation import Simulation
from carecontact.validation.moves import move_to, surface_point
from carecontact.validation.result import Array
from carecontact.world.scene import Scene, build_scene

COMFORT_ARM_DEG = 52.5
"""Angle of the comfort arm: the middle of the protocol's range."""
HOVER_M = 0.020
"""Height of the tool's tip over the skin from which the scripted contacts begin."""


class MakeScene(Interface):
    """``build_scene``, or a function that a test puts in its place to plant a defect."""

    def __call__(self, protocol: Protocol, *, target: str | None, skin: bool) -> Scene: ...


class Subject:
    """The person under test. Every simulation that it returns has a model of its own, which a check may change."""

    def __init__(self, protocol: Protocol, *, make_scene: MakeScene = build_scene) -> None:
        self.protocol, self.make_scene = protocol, make_scene
        self._scenes: dict[str, Scene] = {}
        self._rest: dict[str, Array] = {}
        self._hover: dict[str, Array] = {}

    def scene(self, region: str) -> Scene:
        """Return the compiled world in which ``region`` is the target; callers must not change it."""
        if region not in self._scenes:
            self._scenes[region] = self.make_scene(self.protocol, target=region, skin=False)
        return self._scenes[region]

    def at_rest(self, region: str) -> Simulation:
        """Return a simulation of the settled person with the robot parked, at t = 0.

        Raises SettleError if the person does not come to rest.
        """
        if region not in self._rest:
            simulation = Simulation(_own_model(self.scene(region)))
            simulation.settle(COMFORT_ARM_DEG)
            self._rest[region] = simulation.integration_state()
        return self._restored(region, self._rest[region])

    def hovering(self, region: str) -> Simulation:
        """Return a simulation of the settled person at t = 0, with the tool at rest HOVER_M over the region's middle
        and pointing down.

        Raises SceneError if MuJoCo warned on the way there.
        """
        if region not in self._hover:
            simulation = self.at_rest(region)
            top = surface_point(simulation, region)
            move_to(simulation, top + [0, 0, 0.10], seconds=3.0)
            move_to(simulation, top + [0, 0, HOVER_M], seconds=0.8)
            move_to(simulation, top + [0, 0, HOVER_M], seconds=0.6)
            if warnings := simulation.solver_warnings():
                raise SceneError(f"MuJoCo warned while the tool moved over the {region}: {', '.join(warnings)}")
            self._hover[region] = simulation.integration_state()
        return self._restored(region, self._hover[region])

    def regions(self, *, quick: bool = False) -> tuple[str, ...]:
        """Return the soft regions, the only ones that can be pressed and compared; with ``quick``, only the first."""
        return self.protocol.soft_regions[: 1 if quick else None]

    def tissue(self, region: str) -> Tissue:
        """Return the tissue of this body: the protocol's row, adjusted on a body of another build."""
        return self.scene(region).regions[region].tissue

    def with_dt(self, dt_s: float) -> Subject:
        """Return the same person at another time step [s]."""
        return self.variant(physics=self.protocol.physics.model_copy(update={"dt_s": dt_s}))

    def with_tissue(self, region: str, tissue: Tissue) -> Subject:
        person = self.protocol.person
        return self.variant(person=person.model_copy(update={"tissue": {**person.tissue, region: tissue}}))

    def variant(self, **update: object) -> Subject:
        """Return the person of a changed protocol, built by the same function."""
        return Subject(self.protocol.model_copy(update=update), make_scene=self.make_scene)

    def _restored(self, region: str, state: Array) -> Simulation:
        simulation = Simulation(_own_model(self.scene(region)))
        simulation.restore(state, comfort_arm_deg=COMFORT_ARM_DEG)
        return simulation


def _own_model(scene: Scene) -> Scene:
    return replace(scene, model=copy.copy(scene.model))
