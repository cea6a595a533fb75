"""The check of a person who moves by itself finds what is planted in it."""

from __future__ import annotations

from carecontact.contract.protocol import Protocol
from carecontact.kernel.life import JOINTS
from carecontact.validation.alive import alive, arm, seen
from carecontact.validation.result import Measure
from carecontact.validation.subject import Subject
from carecontact.world.human.breathing import breath_body
from carecontact.world.scene import Scene, build_scene


def still_skin(protocol: Protocol, *, target: str | None, skin: bool) -> Scene:
    """The visible skin over the belly does not breathe."""
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


def test_skin_that_does_not_breathe_is_seen_by_every_camera(subject: Subject) -> None:
    measures = seen(alive(Subject(subject.protocol, make_scene=still_skin)))
    assert len(missed(measures)) == len(measures) == 2


def test_an_arm_that_does_not_arrive_is_found(subject: Subject) -> None:
    measures = arm(alive(Subject(subject.protocol, make_scene=weak)))
    assert len(missed(measures)) == len(measures) == 2
