"""Versions of the person: the first stays what it was, and the newest lies as the first does."""

from __future__ import annotations

import numpy as np
import pytest

from carecontact.contract.protocol import Alive, Breathing, Protocol
from carecontact.protocols import load_protocol, overridden
from carecontact.sim.simulation import Simulation
from carecontact.world.human.versions import BUILDS, Build
from carecontact.world.scene import Scene, build_scene

FIRST = {
    "man-adult": (51, 30484.51256, 697910322, 38.15136659, 332.7161236, 167.9632564, 1068956.93),
    "man-old-heavy": (51, 30686.98096, 688182515.4, 54.14845156, 349.3806275, 206.5787889, 1068963.419),
    "woman-old-light": (51, 30513.67178, 690108085.4, 21.70263203, 306.9652407, 138.5864205, 1068951.15),
}  # fmt: skip
"""Body -> sums over the world of a person-v1 that breathes, as ``sums`` gives them. The locks of the frozen protocols
hold the same of persons who lie still, and nothing of the visible skin's weights."""


def person(protocol: str, body: str, *, breathes: bool) -> Protocol:
    rules = overridden(load_protocol(protocol), {"person.body": body})
    alive = Alive(breathing=Breathing()) if breathes else Alive()
    return rules.model_copy(update={"person": rules.person.model_copy(update={"alive": alive})})


def sums(scene: Scene) -> tuple[float, ...]:
    """Number of degrees of freedom, and sums weighted by place of the skin's weights and bones, of the hulls, of the
    bodies' masses and of the slides' springs."""
    model = scene.model
    fields = (
        model.skin_bonevertweight, model.skin_bonevertid, model.mesh_vert, model.geom_solref, model.body_mass,
        model.jnt_stiffness,
    )  # fmt: skip
    rows = [np.asarray(field, np.float64).ravel() for field in fields]
    return (float(model.nv), *(float(row @ np.linspace(1.0, 2.0, len(row))) for row in rows))


@pytest.mark.parametrize("body", FIRST)
def test_the_first_person_stays_what_it_was(body: str) -> None:
    scene = build_scene(person("bathing-v2", body, breathes=True), target="abdomen")
    assert sums(scene) == pytest.approx(FIRST[body], rel=1e-6)


def test_the_first_person_has_none_of_the_later_choices() -> None:
    assert BUILDS["person-v1"] == Build()
    assert load_protocol("bathing-v2").person.version == "person-v1"
    assert load_protocol("bathing-v3-draft").person.version == "person-v2"


@pytest.mark.parametrize("body", ["woman-old-light", "man-adult-heavy"])
def test_the_newest_person_lies_as_the_first_does(body: str) -> None:
    angles = []
    for protocol in ("bathing-v2", "bathing-v3-draft"):
        simulation = Simulation(build_scene(person(protocol, body, breathes=False), target=None, skin=False))
        angles.append(np.degrees(simulation.settle(52.5).joint_position))
    np.testing.assert_allclose(angles[1], angles[0], atol=0.1)
