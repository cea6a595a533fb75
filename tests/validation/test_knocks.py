"""Blows on trunk and legs: what the springs predict, and how a person without plates is caught."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from carecontact.protocols import load_protocol
from carecontact.sim.simulation import Simulation
from carecontact.validation import knocks
from carecontact.validation.knocks import Site, sites, strike_all
from carecontact.validation.subject import COMFORT_ARM_DEG, Subject
from carecontact.world.scene import Scene, build_scene

PROTOCOL = load_protocol()
BLOW = {"masses": (5.0,), "speeds": (0.2,)}


def changed(stiffness: float, *, body: str = "human_plate_"):
    """A factory of persons whose plates have so many times the stiffness."""

    def make(protocol, *, target: str | None, skin: bool) -> Scene:
        scene = build_scene(protocol, target=target, skin=skin)
        spec = scene.spec.copy()
        for joint in spec.joints:
            if joint.name.startswith(body):
                joint.stiffness = np.array(joint.stiffness) * stiffness
        return replace(scene, spec=spec, model=spec.compile())

    return make


def test_the_prediction_is_the_force_at_which_the_spring_holds_the_energy() -> None:
    depth = np.linspace(0.0, 0.02, 401)
    site = Site(name="spring", plate=None, towards=(0, 0, -1), ball_m=0.03, depth_m=depth, force_n=5e4 * depth)
    assert site.predicted_n(5.0 * 0.2**2 / 2) == pytest.approx(0.2 * np.sqrt(5.0 * 5e4), rel=1e-3)
    assert np.isnan(site.predicted_n(20.0)), "beyond the published curve there is no prediction"


def test_a_blow_of_5_kg_meets_the_springs_and_not_the_trunks_mass() -> None:
    blows = {blow.site: blow for blow in strike_all(Subject(PROTOCOL), **BLOW)}
    assert set(blows) == {site.name for site in sites()}
    for blow in blows.values():
        assert blow.momentum < knocks.MOMENTUM, blow.name
        if blow.on_one_spring and np.isfinite(blow.predicted_n):
            assert abs(blow.off_percent) < knocks.TOLERANCE_PERCENT, blow
    # A hull on the bone answers the same blow with 194 N.
    assert 70 < blows["thigh"].peak_n < 130
    assert blows["chest"].on_one_spring
    assert blows["thigh"].on_one_spring


class GivesWay(Simulation):
    """The belly's skin holds nothing from 50 ms on."""

    def advance(self, steps: int):
        if self.time_s > 0.05:
            self.model.numeric("abdomen/law").data[:] = 0.0
        return super().advance(steps)


def test_a_ball_that_goes_through_the_skin_is_a_miss_although_bone_stops_it() -> None:
    belly = next(site for site in sites() if site.name == "belly")
    scene = knocks.with_striker(Subject(PROTOCOL).scene("forearm"), 3.0, belly.ball_m)
    blows = {}
    for kind in (Simulation, GivesWay):
        simulation = kind(scene)
        simulation.settle(COMFORT_ARM_DEG)
        simulation.restore(simulation.integration_state(), comfort_arm_deg=COMFORT_ARM_DEG)
        blows[kind] = knocks.strike(simulation, belly, 3.0, 0.5)
    held, lost = blows[Simulation], blows[GivesWay]
    assert held.held == held.momentum > knocks.STOPPED
    assert lost.momentum > knocks.STOPPED > lost.held
    missed = [measure.name for measure in knocks._measures(lost) if measure.met is False]
    assert missed == [f"{lost.name}: impulse over momentum before it goes through"]


def test_plates_of_another_stiffness_are_caught() -> None:
    blows = {blow.site: blow for blow in strike_all(Subject(PROTOCOL, make_scene=changed(4.0)), **BLOW)}
    for site in ("chest", "thigh", "shank"):
        assert blows[site].off_percent > knocks.TOLERANCE_PERCENT, blows[site]
