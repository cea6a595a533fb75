"""The check of a person who moves by itself finds what is planted in it."""

from __future__ import annotations

import pytest

from carecontact.contract.protocol import Protocol
from carecontact.kernel.life import JOINTS
from carecontact.protocols import load_protocol, overridden
from carecontact.validation import breath_seen
from carecontact.validation.alive import BREATHES, alive, arm
from carecontact.validation.result import Measure
from carecontact.validation.subject import MakeScene, Subject
from carecontact.world.human.breathing import breath_body
from carecontact.world.scene import Scene, build_scene


def still_skin(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
    """The visible skin over the abdomen does not breathe."""
    scene = build_scene(protocol, target=target, skin=skin)
    model = scene.model
    # Each vertex keeps its weights, on a body that stays.
    breathes = model.skin_bonebodyid == model.body(breath_body("abdomen")).id
    assert breathes.any() == skin
    model.skin_bonebodyid[breathes] = model.body("human_abdomen").id
    return scene


def weak(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
    """The muscles of the shoulder hold with a twentieth of their stiffness."""
    scene = build_scene(protocol, target=target, skin=skin)
    scene.model.actuator(f"holds_{JOINTS[0]}").gainprm[1] /= 20
    return scene


def missed(measures: list[Measure]) -> list[str]:
    return [measure.name for measure in measures if measure.met is False]


def paralysed(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
    """Nothing drives the breath: the abdomen's servo has no force. Posed slides would move the skin all the same."""
    scene = build_scene(protocol, target=target, skin=skin)
    servo = scene.model.actuator("breathes_abdomen")
    servo.gainprm[:], servo.biasprm[:] = 0.0, 0.0
    return scene


@pytest.mark.parametrize("plant", [still_skin, paralysed])
def test_a_belly_that_does_not_breathe_is_seen_by_every_camera(subject: Subject, plant: MakeScene) -> None:
    measures = list(breath_seen.measures(alive(Subject(subject.protocol, make_scene=plant)), BREATHES))
    found = {name.partition(" mm: ")[2]: name for name in missed(measures) if name.startswith("abdomen")}
    assert set(found) == {
        "visible skin of the inner area against the declared size",
        "visible skin of the whole area against the declared size",
        "depth image, median place against the declared size",
    }


def test_an_arm_that_does_not_arrive_is_found(subject: Subject) -> None:
    measures = arm(alive(Subject(subject.protocol, make_scene=weak)))
    assert len(missed(measures)) == len(measures) == 2


@pytest.mark.parametrize("body", ["man-adult", "man-old-heavy"])
def test_the_skin_moves_as_declared_wherever_a_tool_feels_it(body: str) -> None:
    protocol = overridden(load_protocol(), {"person.body": body})
    measures = list(breath_seen.measures(alive(Subject(protocol)), BREATHES))
    sizes = [m for m in measures if m.limit is not None and m.decides]
    assert len(sizes) == 7
    assert all(m.met for m in sizes), missed(sizes)
    assert max(m.value for m in sizes if "visible skin" in m.name) < 0.5
